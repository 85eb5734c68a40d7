# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Recipes of other package managers ask for the versions that setup.py asks for."""

import re
from importlib import metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

tomllib = pytest.importorskip("tomllib", reason="is a part of Python from 3.11 on")

ROOT = Path(__file__).parents[2]
WITH = ("record", "sim", "rigid", "viewer", "study", "report")
"""Extras of what the recipes install."""


def ranges() -> dict[str, set[str]]:
    """Return the ranges of the package and of the extras above by the name of a dependency."""
    found: dict[str, set[str]] = {}
    for requirement in map(Requirement, metadata.requires("sphere_nmpc")):
        marker = requirement.marker
        if marker is None or any(marker.evaluate({"extra": extra}) for extra in WITH):
            found.setdefault(canonicalize_name(requirement.name), set()).add(
                str(requirement.specifier)
            )
    return found


def test_pixi_has_the_dependencies_of_setup_py() -> None:
    recipe = tomllib.loads((ROOT / "pixi.toml").read_text(encoding="utf-8"))
    given = recipe["pypi-dependencies"] | {"numpy": recipe["dependencies"]["numpy"]}
    pinned = {
        canonicalize_name(name): {str(Requirement(f"x{one}").specifier)}
        for name, one in given.items()
    }
    assert pinned == ranges()


def test_image_has_the_same_extras() -> None:
    text = (ROOT / "Dockerfile").read_text(encoding="utf-8")
    (extras,) = re.findall(r'"sphere_nmpc\[(.+)\]"', text)
    assert tuple(extras.split(",")) == WITH
