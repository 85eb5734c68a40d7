# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Fingerprint of a study: settings, scenarios and code, which decide the results of its runs."""

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from functools import cache
from pathlib import Path
from typing import Any

from sphere_nmpc.settings import STRATEGIES
from sphere_sim.scenario.scenarios import Scenario
from sphere_sim.study.conditions import StudyConditions
from sphere_sim.study.imported_modules import imported_modules

_RUN_MODULE = "sphere_sim.study.single_run"
WORKER_MODULES = (_RUN_MODULE, "sphere_sim.study.best_known")
"""Modules whose functions workers call."""
_C_SOURCES = ("*.c", "*.h", "codegen.py")
"""What the compiled solver is built from, in the folder of a package."""


def fingerprint(conditions: StudyConditions, scenarios: Sequence[Scenario]) -> dict[str, Any]:
    """Return all that decides the results of a study's runs, as JSON content."""
    content = {
        "conditions": asdict(conditions),
        "runs": len(scenarios),
        "scenarios": _digest(_scenario_bytes(scenarios)),
        "code": run_code_digest(conditions.controller.strategy),
    }
    # Through JSON and back, so that it equals what is read from a file.
    plain: dict[str, Any] = json.loads(json.dumps(content))
    return plain


@cache
def run_code_digest(strategy: str) -> str:
    """Return a digest of the sources that a run with a strategy executes, and of no others.

    A version number would not change with each edit of a source.
    """
    return _digest(_source_bytes(run_modules(strategy)))


def run_modules(strategy: str) -> dict[str, Path]:
    """Return the source files that a run with a strategy executes, by module."""
    modules = {name: entry.path.partition(":")[0] for name, entry in STRATEGIES.items()}
    return imported_modules(_RUN_MODULE, modules[strategy], not_by_name=modules.values())


@cache
def worker_code_digest() -> str:
    """Return a digest of all sources that a worker may execute."""
    return _digest(_source_bytes(imported_modules(*WORKER_MODULES)))


def differences(recorded: Any, given: Any, name: str = "") -> Iterator[str]:
    """Yield a description of each difference between two fingerprints."""
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
        about = [scenario.seed, scenario.extra, scenario.given, scenario.optional]
        yield json.dumps(about).encode()


def _source_bytes(modules: Mapping[str, Path]) -> Iterator[bytes]:
    for name, path in sorted(modules.items()):
        yield name.encode()
        yield path.read_bytes()
        if path.name == "__init__.py":
            for source in sorted(p for kind in _C_SOURCES for p in path.parent.glob(kind)):
                yield source.name.encode()
                yield source.read_bytes()
