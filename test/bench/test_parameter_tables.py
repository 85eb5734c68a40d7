# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Parameter table and default YAML against the settings in the code."""

from typing import Any

import pytest
import yaml
from parameter_tables import NODES, PARTS, outputs, parameters_yaml

from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.quantity import quantities


def values(settings: Any) -> dict[str, Any]:
    return {name: getattr(settings, name) for name in quantities(settings)}


@pytest.mark.parametrize("path", outputs(), ids=lambda path: path.name)
def test_file_is_up_to_date(path) -> None:
    assert path.read_text(encoding="utf-8") == outputs()[path], (
        "run python bench/documents/parameter_tables.py"
    )


@pytest.mark.parametrize("node", NODES)
def test_yaml_gives_the_defaults_back(node) -> None:
    given = yaml.safe_load(parameters_yaml())[f"/**/{node}"]["ros__parameters"]
    robot = given.pop("robot")
    given.pop("use_sim_time", None)
    expected = values(NODES[node])
    for prefix, _, settings in PARTS[node]:
        if prefix:
            assert given.pop(prefix) == values(settings)
        else:
            expected |= values(settings)
    assert {key: tuple(v) if isinstance(v, list) else v for key, v in given.items()} == expected
    assert robot == values(RobotParameters())
    for key, value in given.items():
        # YAML 1.1 reads some numbers as text.
        assert isinstance(value, list) or type(value) is type(expected[key])
