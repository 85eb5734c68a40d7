# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Optimal control problem of the paper (Eq. 34) and the interface of the solvers that solve it."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from sphere_nmpc.model.integrator import step_function, steps_for
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import INPUT_SIZE, Vector
from sphere_nmpc.model.symbolic_rotation import Expression
from sphere_nmpc.solver.problem import LeastSquaresProblem

HORIZON = 4
SAMPLE_PERIOD = 0.5  # s
INTEGRATION_STEP = SAMPLE_PERIOD / 3.0
"""Longest integration step of all solvers [s]: as accurate as ten classical Runge-Kutta steps a
sample period."""
TERMINAL_WEIGHT = 1e8  # beta [-]
INPUT_WEIGHT = 0.5  # alpha [s^2/rad^2]
ROBOT = RobotParameters()
CONSTANTS = ROBOT.lumped.as_array()
LIMIT = ROBOT.max_rotor_speed


def paper_problem(state: Vector, goal: Vector, input_in_force: Vector) -> LeastSquaresProblem:
    """Return OCP_N of the paper (Eq. 34) with its cost divided by beta.

    Its arguments are the current and the desired pose, (6,), and the rotor speeds, (2,) [rad/s].
    """
    return LeastSquaresProblem.of_paper(
        ROBOT, state, goal, input_in_force, HORIZON, SAMPLE_PERIOD, INPUT_WEIGHT, TERMINAL_WEIGHT,
        max_step=INTEGRATION_STEP,
    )


def predicted(state: Expression, start: Expression, end: Expression) -> Expression:
    """Return the pose, (6,), a sample period later; inputs ramp from `start` to `end` [rad/s]."""
    steps = steps_for(SAMPLE_PERIOD, INTEGRATION_STEP)
    for i in range(steps):
        step_start = start + (end - start) * (i / steps)
        step_end = start + (end - start) * ((i + 1) / steps)
        state = step_function()(state, step_start, step_end, SAMPLE_PERIOD / steps, CONSTANTS)
    return state


def shifted(knots: Vector) -> Vector:
    """Return the warm start, (N, 2), at the next sampling instant from a plan, (N + 1, 2) [rad/s].

    The plan is shifted and zero appended, as in Step 6 of Algorithm 1.
    """
    start = np.zeros((knots.shape[0] - 1, INPUT_SIZE))
    start[:-1] = knots[2:]
    return start


@dataclass(frozen=True, eq=False)
class Answer:
    """Result of a solve at a sampling instant."""

    speeds: Vector
    """Rotor speeds at the next sampling instant [rad/s], shape (2,)."""
    solved: bool
    """Whether the solver itself reports success."""
    took: tuple[float, float] | None = None
    """Wall and processor time [s] where the solve is made and measured in another process."""


class BenchmarkedSolver(Protocol):
    """A solver in a receding horizon, which keeps its own warm start."""

    def start(self, goal: Vector) -> None:
        """Start a run towards `goal`, shape (6,), without a warm start."""
        ...

    def solve(self, state: Vector, input_in_force: Vector) -> Answer:
        """Return the next rotor speeds from `state`, (6,), and the present ones, (2,) [rad/s]."""
        ...


Maker = Callable[[], BenchmarkedSolver]
"""Sets a solver up; raises ModuleNotFoundError where its package is not installed."""
