# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The fingerprint changes with what a run executes and with nothing else."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from sphere_nmpc.settings import STRATEGIES
from sphere_sim.study import fingerprint as fingerprint_module
from sphere_sim.study.imported_modules import imported_modules

ROOT = Path(__file__).parents[3]

DIGEST = """
from sphere_sim.study.conditions import StudyConditions
from sphere_sim.study.fingerprint import fingerprint
conditions = StudyConditions().with_settings([("controller.strategy", "paper")])
print(fingerprint(conditions, [])["code"])
"""

MODULES_OF_A_RUN = """
import json, sys
from sphere_sim.scenario.scenarios import draw_scenarios
from sphere_sim.study.conditions import StudyConditions
from sphere_sim.study.single_run import run_scenario
settings = [
    ("controller.strategy", sys.argv[1]), ("simulator.plant", sys.argv[2]),
    ("controller.planning_effort", "3000"),
]
conditions = StudyConditions(duration=0.5).with_settings(settings)
record = run_scenario(conditions, draw_scenarios(1, 0)[0])
assert "crash" not in record.results, record.results
ours = [name for name in sys.modules if name.partition(".")[0] in ("sphere_nmpc", "sphere_sim")]
print(json.dumps(ours))
"""


def output(program: str, *arguments: str, sources: Path = ROOT, **environment: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", program, *arguments], text=True, capture_output=True, check=False,
        cwd=sources, env={**os.environ, "PYTHONPATH": str(sources), **environment},
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def loaded_in_a_run(*arguments: str, **environment: str) -> set[str]:
    return set(json.loads(output(MODULES_OF_A_RUN, *arguments, **environment)))


def covered(strategy: str) -> set[str]:
    return set(fingerprint_module.run_modules(strategy))


@pytest.fixture(scope="module")
def copy(tmp_path_factory) -> Path:
    """Return a copy of the sources, which a test may edit."""
    folder = tmp_path_factory.mktemp("sources")
    for name in ("sphere_nmpc", "sphere_sim"):
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    return folder


@pytest.fixture(scope="module")
def digest(copy) -> str:
    return output(DIGEST, sources=copy)


@pytest.mark.parametrize(
    ("file", "counts"),
    [
        ("sphere_sim/study/figure.py", False),
        ("sphere_sim/report/figures/style.py", False),
        ("sphere_sim/benchmark/report.py", False),
        ("sphere_sim/study/best_known.py", False),
        ("sphere_sim/study/tables.py", False),
        ("sphere_nmpc/strategy/plan_keeping.py", False),
        ("sphere_nmpc/strategy/paper.py", True),
        ("sphere_nmpc/solver/native/solver.c", True),
        ("sphere_nmpc/solver/native/__init__.py", True),
        ("sphere_sim/world/plant/rolling_plant.py", True),
        ("sphere_sim/scenario/perturbation.py", True),
    ],
)
def test_edited_file_counts_if_a_run_executes_it(copy, digest, file, counts) -> None:
    path = copy / file
    before = path.read_bytes()
    try:
        path.write_bytes(before + (b"/* more */\n" if path.suffix == ".c" else b"# more\n"))
        assert (output(DIGEST, sources=copy) != digest) is counts
    finally:
        path.write_bytes(before)


@pytest.mark.parametrize("plant", ["rolling", "rigid_body"])
@pytest.mark.parametrize("strategy", STRATEGIES)
def test_all_modules_that_a_run_loads_are_covered(strategy, plant) -> None:
    assert loaded_in_a_run(strategy, plant) <= covered(strategy)


def test_no_modules_are_covered_but_those_that_a_run_loads() -> None:
    assert covered("time_optimal") == loaded_in_a_run("time_optimal", "rolling")


def test_workers_are_compared_by_all_that_they_may_execute() -> None:
    modules = imported_modules(*fingerprint_module.WORKER_MODULES)
    for strategy in STRATEGIES:
        assert covered(strategy) <= modules.keys()
    assert "sphere_sim.study.best_known" in modules
