# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""What takes part in the benchmark, and the optimal control problem all of them are given."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from sphere_nmpc.model.dynamics import Expression
from sphere_nmpc.model.integrator import step_function, steps_for
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import INPUT_SIZE, Vector
from sphere_nmpc.solver.problem import HoldProblem

HORIZON = 4
SAMPLE_PERIOD = 0.5  # s
INTEGRATION_STEP = SAMPLE_PERIOD / 3.0
"""All contenders predict alike [s]: as accurate as ten classical Runge-Kutta steps a sample."""
TERMINAL_WEIGHT = 1e8  # beta
INPUT_WEIGHT = 0.5  # alpha [s^2/rad^2]
ROBOT = RobotParameters()
CONSTANTS = ROBOT.lumped.as_array()
LIMIT = ROBOT.max_rotor_speed


@dataclass(frozen=True, eq=False)
class Answer:
    """What a contender returns at a sample.

    Attributes
    ----------
    speeds : ndarray, shape (2,)
        Rotor speeds to reach at the next sample [rad/s].
    solved : bool
        Whether the contender itself says that it succeeded.
    took : (float, float) or None
        Wall and processor time of the solve [s] as its caller in another process saw it; None
        where that caller is who asked.
    """

    speeds: Vector
    solved: bool
    took: tuple[float, float] | None = None


class Contender(Protocol):
    """A solver in a receding horizon; it keeps its own warm start."""

    def start(self, goal: Vector) -> None:
        """Begin a run towards `goal`, shape (6,), with nothing remembered."""
        ...

    def solve(self, state: Vector, input_in_force: Vector) -> Answer:
        """Return the next rotor speeds from `state`, (6,), and the present ones, (2,) [rad/s]."""
        ...


_BOUND = np.full((HORIZON, INPUT_SIZE), LIMIT)
_MINUS_BOUND = -_BOUND
_DURATIONS = np.full(HORIZON, SAMPLE_PERIOD)

Maker = Callable[[], Contender]
"""Sets a contender up; raises ModuleNotFoundError where its package is not installed."""


def paper_problem(state: Vector, goal: Vector, input_in_force: Vector) -> HoldProblem:
    """Return OCP_N of the paper (Eq. 34), the cost divided by beta."""
    return HoldProblem(
        state=state,
        goal=goal,
        input_in_force=input_in_force,
        durations=_DURATIONS,
        constants=CONSTANTS,
        lower=_MINUS_BOUND,
        upper=_BOUND,
        input_scale=LIMIT,
        terminal_weight=1.0,
        stage_weight=1.0 / TERMINAL_WEIGHT,
        input_weight=INPUT_WEIGHT * LIMIT**2 / TERMINAL_WEIGHT,
        max_step=INTEGRATION_STEP,
    )


def predicted(state: Expression, last: Expression, there: Expression) -> Expression:
    """Return the state, (6,), a sample later; inputs ramp from `last` to `there` [rad/s]."""
    steps = steps_for(SAMPLE_PERIOD, INTEGRATION_STEP)
    for i in range(steps):
        here_u = last + (there - last) * (i / steps)
        there_u = last + (there - last) * ((i + 1) / steps)
        state = step_function()(state, here_u, there_u, SAMPLE_PERIOD / steps, CONSTANTS)
    return state


def shifted(knots: Vector) -> Vector:
    """Return the warm start of the next sample from u_0 ... u_N, (N + 1, 2): step 6, (N, 2)."""
    start = np.zeros((knots.shape[0] - 1, INPUT_SIZE))
    start[:-1] = knots[2:]
    return start
