# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Memory shared with the compiled solver: the C structure ``hold`` of ``hold.h`` as numpy views.

A whole problem is one row of doubles in which the integer and pointer fields are read through an
integer view of the same bytes. Filling a slice costs a tenth of a microsecond, and a batch is
simply a matrix of such rows.
"""

import ctypes
from functools import cache

import numpy as np

from sphere_nmpc.model.state import Vector
from sphere_nmpc.solver.native.library import load_library
from sphere_nmpc.solver.problem import (
    HoldProblem,
    HoldSolution,
    SolverSettings,
    SolveStatus,
)

STATE, GOAL = slice(0, 6), slice(6, 12)
INPUT_IN_FORCE, CONSTANTS = slice(12, 14), slice(14, 18)
SCALARS, SETTINGS = slice(18, 25), slice(25, 31)
TIME_BUDGET = 27
COST, KKT_RESIDUAL, SOLVE_TIME = 31, 32, 33
INTERVALS, MAX_ITERATIONS, STATUS, ITERATIONS = 34, 35, 36, 37
POINTERS = slice(38, 44)
"""durations, lower, upper, start, inputs, states."""
WORKSPACE = 44
HEAD_SIZE = 45

STATUSES = (
    SolveStatus.CONVERGED,
    SolveStatus.CAPPED,
    SolveStatus.BUDGET,
    SolveStatus.NOT_FINITE,
    SolveStatus.ABANDONED,
)


@cache
def library() -> ctypes.CDLL:
    """Return the compiled solver with its signatures declared.

    Raises
    ------
    CompilerError
        If it cannot be built.
    """
    solver = load_library()
    address, count = ctypes.c_void_p, ctypes.c_int64
    for name, arguments in {
        "hold_solve": [address],
        "hold_roll_out": [count, ctypes.c_double, *[address] * 5],
        "hold_expand": [address] * 4,
        "hold_solve_many": [address, count, address, count, ctypes.c_double, address],
    }.items():
        function = getattr(solver, name)
        function.argtypes, function.restype = arguments, None
    solver.hold_workspace.argtypes, solver.hold_workspace.restype = [count], count
    solver.hold_clock.argtypes, solver.hold_clock.restype = [], ctypes.c_double
    return solver


def body_size(intervals: int) -> int:
    """Return how many doubles the arrays of a problem take, from durations to states."""
    return intervals * 7 + (intervals + 1) * 8


def new_workspace(intervals: int) -> Vector:
    """Return scratch memory for one thread."""
    return np.zeros(int(library().hold_workspace(intervals)))


class Slot:
    """One problem in shared memory.

    Parameters
    ----------
    intervals : int
        N.
    head : ndarray, shape (HEAD_SIZE,), optional
        The structure, for instance a row of a batch; new if not given.
    body : ndarray, shape (body_size(N),), optional
        Where its arrays live; new if not given.
    """

    def __init__(
        self, intervals: int, head: Vector | None = None, body: Vector | None = None
    ) -> None:
        n = intervals
        self.head: Vector = np.zeros(HEAD_SIZE) if head is None else head
        self.numbers = self.head.view(np.int64)
        self._body: Vector = np.zeros(body_size(n)) if body is None else body
        ends = np.cumsum([n, 2 * n, 2 * n, 2 * n, 2 * n + 2, 6 * n + 6])
        parts = np.split(self._body, ends[:-1])
        self.durations = parts[0]
        self.lower, self.upper, self.start = (part.reshape(n, 2) for part in parts[1:4])
        self.inputs, self.states = parts[4].reshape(n + 1, 2), parts[5].reshape(n + 1, 6)
        starts = np.concatenate(([0], ends[:-1]))
        self.numbers[INTERVALS] = n
        self.numbers[POINTERS] = self._body.ctypes.data + 8 * starts
        self.address = self.head.ctypes.data
        self._state, self._goal = self.head[STATE], self.head[GOAL]
        self._input_in_force = self.head[INPUT_IN_FORCE]
        self._constants, self._scalars = self.head[CONSTANTS], self.head[SCALARS]
        self._workspace: Vector | None = None

    def own_workspace(self) -> "Slot":
        """Give the slot scratch memory of its own and return it."""
        self._workspace = new_workspace(self.durations.size)
        self.numbers[WORKSPACE] = self._workspace.ctypes.data
        return self

    def write_settings(self, settings: SolverSettings) -> None:
        """Fill in when to stop."""
        self.head[SETTINGS] = (
            settings.gradient_tolerance,
            settings.decrease_tolerance,
            settings.time_budget,
            settings.target_cost,
            settings.decrease_floor,
            settings.initial_damping,
        )
        self.numbers[MAX_ITERATIONS] = settings.max_iterations

    def write(self, problem: HoldProblem) -> None:
        """Fill in what to solve."""
        self._state[:] = problem.state
        self._goal[:] = problem.goal
        self._input_in_force[:] = problem.input_in_force
        self._constants[:] = problem.constants
        self._scalars[:] = (
            problem.input_scale,
            problem.terminal_weight,
            problem.stage_weight,
            problem.input_weight,
            problem.slew_weight,
            problem.max_acceleration,
            problem.max_step,
        )
        self.durations[:] = problem.durations
        self.lower[:] = problem.lower
        self.upper[:] = problem.upper

    def read(self) -> HoldSolution:
        """Return the answer as arrays of its own."""
        head, numbers = self.head, self.numbers
        return HoldSolution(
            self.inputs.copy(),
            self.states.copy(),
            head.item(COST),
            STATUSES[numbers.item(STATUS)],
            numbers.item(ITERATIONS),
            head.item(KKT_RESIDUAL),
            head.item(SOLVE_TIME),
        )
