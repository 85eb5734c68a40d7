# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The compiled solver as it is loaded, and the memory that Python shares with it."""

import ctypes
import os
import subprocess
import sys

import numpy as np
import pytest
from compiled_solver import compiled

from sphere_nmpc.solver.native import layout, library
from sphere_nmpc.solver.native.layout import FIELDS, SIZE, index

SOLVE = """
import numpy as np
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.solver.hold_solver import HoldSolver
from sphere_nmpc.solver.problem import HoldProblem
problem = HoldProblem(
    np.array([0.3, -0.2, 1.0, 0, 0, 0, 0, 0, 0]), np.array([0, 0, 1.0, 0, 0, 0]), np.zeros(2),
    np.full(4, 0.5), RobotParameters().lumped.as_array(), np.full((4, 2), -100.0),
    np.full((4, 2), 100.0), 100.0, input_weight=5e-5,
)
HoldSolver()
print(f"{HoldSolver().solve(problem, np.zeros((4, 2))).cost:.9e}")
"""


def solve(**environment):
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
    monkeypatch.setattr(layout, "FIELDS", (FIELDS[1], FIELDS[0], *FIELDS[2:]))
    with pytest.raises(OSError, match="another version"):
        library._loaded()


def test_slot_writes_each_value_to_its_own_field(make_problem):
    problem = make_problem("stages and slew", max_step=0.07)
    slot = library.Slot(compiled(), problem.intervals)
    slot.write(problem, np.zeros((problem.intervals, 2)), 0.25)
    words = np.ctypeslib.as_array((ctypes.c_double * SIZE).from_address(slot.address))
    for field in FIELDS:
        if field.c_type == "double" and hasattr(problem, field.name):
            given = np.atleast_1d(getattr(problem, field.name))
            assert np.array_equal(words[layout.span(field.name)], given), field.name
    assert words[index("time_budget")] == 0.25
