# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The compiled solver as it is loaded, and the memory that Python shares with it."""

import os
import subprocess
import sys
from dataclasses import fields

import numpy as np
import pytest
from compiled_solver import compiled
from solver_problems import make_problem

from sphere_nmpc.solver.native import layout, library
from sphere_nmpc.solver.native.layout import MEMBERS
from sphere_nmpc.solver.problem import SolverSettings

SOLVE = """
import numpy as np
from solver_problems import make_problem
from sphere_nmpc.solver.problem import SolverSettings
from sphere_nmpc.solver.solve import solve
for _ in range(2):
    solution = solve(make_problem("terminal"), np.zeros((5, 2)), SolverSettings())
print(f"{solution.cost:.9e}")
"""


def solve(**environment):
    environment["PYTHONPATH"] = os.pathsep.join(sys.path)
    done = subprocess.run(
        [sys.executable, "-c", SOLVE], env={**os.environ, **environment}, capture_output=True,
        text=True, check=True,
    )
    return float(done.stdout), done.stderr


def test_plain_solver_takes_the_place_of_the_compiled_one_with_one_warning():
    (cost, errors), (plain_cost, warning) = solve(), solve(**{library.VARIABLE: "plain"})
    assert errors == "" and plain_cost == pytest.approx(cost, rel=1e-6)
    assert len(warning.splitlines()) == 1 and "To cure this" in warning


def test_library_that_is_missing_or_of_another_layout_is_not_used(monkeypatch, tmp_path):
    assert compiled()
    with monkeypatch.context() as change, pytest.raises(OSError, match=f"{tmp_path}/solver.so"):
        change.setattr(library, "FOLDER", tmp_path)
        library._loaded()
    monkeypatch.setattr(layout, "MEMBERS", (MEMBERS[1], MEMBERS[0], *MEMBERS[2:]))
    with pytest.raises(OSError, match="another version"):
        library._loaded()


@pytest.mark.parametrize("kind", ["stages and acceleration", "minimum time"])
def test_slot_writes_each_value_to_its_own_place(kind):
    problem = make_problem(kind, max_step=0.07)
    rng = np.random.default_rng(0)
    start, settings = rng.normal(size=(problem.intervals, 2)), SolverSettings(7, 0.1, 0.2, 0.3)
    slot = library.Slot(compiled(), type(problem), problem.intervals)
    slot.solve(problem, start, settings, 0.25)
    for given in (problem, settings):
        for field in fields(given):
            value = getattr(given, field.name)
            assert np.array_equal(slot.values[field.name], value), field.name
    assert np.array_equal(slot.values["start"], start)
    assert slot.values["time_budget"] == 0.25
