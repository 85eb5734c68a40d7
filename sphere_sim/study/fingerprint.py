# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""What tells whether two sets of runs can be mixed: settings, scenarios and code."""

import hashlib
import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from functools import cache
from pathlib import Path
from typing import Any

import sphere_nmpc
import sphere_sim
from sphere_sim.scenario.scenarios import Scenario
from sphere_sim.study.conditions import StudyConditions

_SOURCES = {".py", ".c", ".h"}
_NOT_IN_A_RUN = {"ros", "cli", "viewer", "recording"}


def fingerprint(conditions: StudyConditions, scenarios: Sequence[Scenario]) -> dict[str, Any]:
    """Return all that decides the outcome of a study, as plain JSON content."""
    content = {
        "conditions": asdict(conditions),
        "runs": len(scenarios),
        "scenarios": _digest(_scenario_bytes(scenarios)),
        "code": code_digest(),
    }
    # Through JSON and back, so that it equals what is read from a file.
    plain: dict[str, Any] = json.loads(json.dumps(content))
    return plain


@cache
def code_digest() -> str:
    """Return a digest of the sources a run depends on, which versions alone do not tell."""
    return _digest(_source_bytes())


def differences(recorded: Any, given: Any, name: str = "") -> Iterator[str]:
    """Yield in words where two fingerprints differ."""
    if isinstance(recorded, dict) and isinstance(given, dict):
        for key in sorted(recorded.keys() | given.keys()):
            place = f"{name}.{key}".removeprefix(".conditions").removeprefix(".")
            yield from differences(recorded.get(key), given.get(key), place)
    elif recorded != given:
        if name in ("scenarios", "code"):
            yield f"another state of the {name}" if name == "code" else "other scenarios"
        else:
            yield f"{name}: given {given}, recorded {recorded}"


def _digest(parts: Iterator[bytes]) -> str:
    digest = hashlib.sha256()
    for part in parts:
        digest.update(len(part).to_bytes(8, "little"))
        digest.update(part)
    return digest.hexdigest()


def _scenario_bytes(scenarios: Sequence[Scenario]) -> Iterator[bytes]:
    for scenario in scenarios:
        yield scenario.start.tobytes() + scenario.goal.tobytes()
        yield json.dumps([scenario.seed, scenario.extra, scenario.given]).encode()


def _source_bytes() -> Iterator[bytes]:
    for package in (sphere_nmpc, sphere_sim):
        root = Path(str(package.__file__)).parent
        for path in sorted(root.rglob("*")):
            parts = path.relative_to(root).parts
            if path.suffix in _SOURCES and not _NOT_IN_A_RUN & set(parts):
                yield "/".join(parts).encode()
                yield path.read_bytes()
