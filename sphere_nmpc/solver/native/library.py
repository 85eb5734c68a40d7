# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The compiled solver, which ``setup.py`` builds at the installation, and memory shared with it.

Problems are written to the C structure ``problem`` through NumPy views: writing to a slice that is
kept costs a tenth of a microsecond, several times less than assigning to the members of a
`ctypes.Structure`.
"""

import ctypes
import logging
import os
from functools import cache
from pathlib import Path

import numpy as np

from sphere_nmpc.model.state import Vector
from sphere_nmpc.solver.native.layout import SIZE, STATUSES, check_sum, index, span
from sphere_nmpc.solver.problem import HoldProblem, HoldSolution, SolverSettings

FOLDER = Path(__file__).parent
VARIABLE = "SPHERE_NMPC_SOLVER"
"""Environment variable; with the value ``plain`` the compiled solver is not used."""

_SETTINGS = span("gradient_tolerance", "initial_damping")
_TIME_BUDGET, _MAX_ITERATIONS = index("time_budget"), index("max_iterations")
_COST, _KKT_RESIDUAL, _SOLVE_TIME = index("cost"), index("kkt_residual"), index("solve_time")
_STATUS, _ITERATIONS = index("status"), index("iterations")
_STEADY_INTERVAL, _STRETCH = index("steady_interval"), index("stretch")

_log = logging.getLogger("sphere_nmpc")


@cache
def library() -> ctypes.CDLL | None:
    """Return the compiled solver; None, with one warning a process, where it cannot be used.

    `sphere_nmpc.solver.plain` then takes its place.
    """
    try:
        return _loaded()
    except OSError as cause:
        _log.warning(
            "sphere_nmpc: the compiled solver is not used (%s); a plain one takes its place, with "
            "the same results in about 300 times the time. To cure this, install the "
            "package again with a C compiler and CasADi (in a checkout: make venv)", cause,
        )
        return None


def _loaded() -> ctypes.CDLL:
    if os.environ.get(VARIABLE) == "plain":
        raise OSError(f"{VARIABLE}=plain")
    solver = ctypes.CDLL(str(FOLDER / "solver.so"))
    solver.hold_level.restype = ctypes.c_char_p
    # The same for the instruction set of this processor.
    fitting = FOLDER / f"solver{solver.hold_level().decode()}.so"
    if fitting.exists():
        solver = ctypes.CDLL(str(fitting))
    if ctypes.c_int64.in_dll(solver, "hold_layout").value != check_sum():
        raise OSError(f"{fitting} is of another version of the package")
    address, count, number = ctypes.c_void_p, ctypes.c_int64, ctypes.c_double
    for name, result, arguments in (
        ("hold_solve", None, [address]),
        ("hold_expand_error", None, [address] * 4),
        ("hold_roll_out", None, [count, number, *[address] * 5]),
        ("hold_propagate", None, [count, number, *[address] * 6]),
        ("hold_expand", None, [address] * 4),
        ("hold_half_motions", None, [count, count, *[number] * 3, *[address] * 6]),
        ("hold_workspace", count, [count]),
        ("hold_meet", count, [*[count] * 4, *[number] * 4, *[address] * 10]),
        ("hold_way", None, [*[count] * 3, *[address] * 5]),
        (
            "hold_clearance", number,
            [count, *[address] * 6, count, count, address, *[number] * 4, address, count],
        ),
    ):
        function = getattr(solver, name)
        function.argtypes, function.restype = arguments, result
    return solver


class Slot:
    """One problem with its arrays and the workspace of its solve; for one thread at a time.

    Parameters
    ----------
    solver : ctypes.CDLL
        The compiled solver.
    intervals : int
        N.

    Attributes
    ----------
    address : int
        Address of the C structure.
    """

    def __init__(self, solver: ctypes.CDLL, intervals: int) -> None:
        n = intervals
        self._words: Vector = np.zeros(SIZE)
        self._integers = self._words.view(np.int64)
        self._durations = np.zeros(n)
        self._lower, self._upper, self._start = np.zeros((3, n, 2))
        self._inputs, self._states = np.zeros((n + 1, 2)), np.zeros((n + 1, 9))
        self._workspace = np.zeros(int(solver.hold_workspace(n)))
        self._integers[index("intervals")] = n
        arrays = (
            self._durations, self._lower, self._upper, self._start, self._inputs, self._states,
            self._workspace,
        )
        pointers = [array.ctypes.data for array in arrays]
        self._integers[span("durations", "workspace")] = pointers
        self.address = self._words.ctypes.data
        self._vectors = self._words[span("state", "goal_velocity")]
        self._scalars = self._words[span("input_scale", "error_weight")]

    def write_settings(self, settings: SolverSettings) -> None:
        """Write when to stop."""
        self._words[_SETTINGS] = (
            settings.gradient_tolerance, settings.decrease_tolerance, settings.time_budget,
            settings.target_cost, settings.decrease_floor, settings.initial_damping,
        )
        self._integers[_MAX_ITERATIONS] = settings.max_iterations

    def write(self, problem: HoldProblem, start: Vector, time_budget: float) -> None:
        """Write a problem, the initial guess (N, 2) [rad/s] and the wall time of the solve [s]."""
        vectors = (
            problem.state, problem.goal, problem.input_in_force, problem.constants,
            problem.disturbance.slope, problem.disturbance.imbalance, problem.input_reference,
            problem.momentum_row, problem.steady_axis, problem.turn_weights,
            problem.goal_velocity,
        )
        np.concatenate(vectors, out=self._vectors)
        self._scalars[:] = (
            problem.input_scale, problem.terminal_weight, problem.stage_weight,
            problem.input_weight, problem.slew_weight, problem.max_acceleration,
            problem.max_step, problem.position_scale, problem.whole_turns,
            problem.error_weight,
        )
        self._integers[_STEADY_INTERVAL] = problem.steady_interval
        self._durations[:] = problem.durations
        self._lower[:] = problem.lower
        self._upper[:] = problem.upper
        self._start[:] = start
        self._words[_TIME_BUDGET] = time_budget

    def read(self) -> HoldSolution:
        """Return the solution, in arrays of its own."""
        words, integers = self._words, self._integers
        return HoldSolution(
            self._inputs.copy(), self._states.copy(), words.item(_COST),
            STATUSES[integers.item(_STATUS)], integers.item(_ITERATIONS),
            words.item(_KKT_RESIDUAL), words.item(_SOLVE_TIME),
            words.item(_STRETCH),
        )
