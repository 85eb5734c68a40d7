# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The problem behind the strategy: end at the goal, at rest, after a given time."""

from dataclasses import dataclass

import numpy as np

from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import INPUT_SIZE, Vector
from sphere_nmpc.solver.hold_solver import HoldSolver
from sphere_nmpc.solver.problem import HoldProblem, SolverSettings
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.time_optimal.grid import knot_durations

SLEW_WEIGHT = 10.0
"""Weight of accelerations beyond the limit; at an arrival they vanish with the miss."""

_REGULARISATION = 1e-12
"""Input weight that only keeps the normal equations regular."""

_CALL_WORK = 60
"""Work that a call costs whatever it solves."""

_ACCELERATION_SHARE = 0.998
"""Share of the acceleration that is planned with, so that the penalty's slack stays inside."""


@dataclass(frozen=True, eq=False)
class Arrival:
    """Rotor speeds that lead to the goal.

    Attributes
    ----------
    hold : FirstOrderHold
        Knots from time 0 (now) to the arrival [s].
    states : ndarray, shape (K, 6)
        Predicted states at the knots.
    goal : ndarray, shape (6,)
        Goal with the quaternion sign that is aimed at.
    miss : float
        Square root of the cost: predicted distance to the goal, with any slack of the limits.
    iterations : int
        Solver iterations spent.
    kkt_residual : float
        First-order optimality.
    work : int
        Iterations times intervals: what the solve cost, the same on every machine.
    """

    hold: FirstOrderHold
    states: Vector
    goal: Vector
    miss: float
    iterations: int
    kkt_residual: float
    work: int

    @property
    def duration(self) -> float:
        """Time to the arrival [s]."""
        return self.hold.end


@dataclass(frozen=True)
class Effort:
    """How hard a single solve tries.

    Attributes
    ----------
    max_iterations : int
        Cap on solver iterations.
    max_step : float
        Longest integration step [s].
    miss : float
        Miss at which the solve is content.
    """

    max_iterations: int
    max_step: float
    miss: float


class ArrivalSolver:
    """Solve for arrivals from one situation after another.

    Parameters
    ----------
    robot : RobotParameters
        Limits of the drives.
    period : float
        Spacing of the controller's ticks [s].
    effort : Effort
        How hard each solve tries.
    """

    def __init__(self, robot: RobotParameters, period: float, effort: Effort) -> None:
        self._max_speed = robot.max_rotor_speed
        self._acceleration = _ACCELERATION_SHARE * robot.max_rotor_acceleration
        self._period = period
        self._effort = effort
        self._solver = HoldSolver(
            SolverSettings(
                max_iterations=effort.max_iterations,
                gradient_tolerance=0.0,
                decrease_tolerance=1e-6,
                target_cost=effort.miss**2,
            )
        )

    def solve(
        self,
        situation: Situation,
        goal: Vector,
        duration: float,
        guess: FirstOrderHold,
        to_first_knot: float,
    ) -> Arrival:
        """Find rotor speeds that end at `goal` after `duration`.

        Parameters
        ----------
        situation : Situation
            Where the robot is and what its rotors do.
        goal : ndarray, shape (6,)
            Goal with the quaternion sign that is aimed at.
        duration : float
            Time to the arrival [s].
        guess : FirstOrderHold
            First guess; it is stretched in time to end at `duration`.
        to_first_knot : float
            Time to the first knot [s].

        Returns
        -------
        Arrival
            The best found; its `miss` tells whether it gets there.
        """
        problem = self._problem(situation, goal, duration, to_first_knot)
        times = np.concatenate(([0.0], np.cumsum(problem.durations)))
        scaled = times[1:] * (guess.end / duration)
        start = np.column_stack([np.interp(scaled, guess.times, row) for row in guess.speeds.T])
        solution = self._solver.solve(problem, start)
        return Arrival(
            FirstOrderHold(times, solution.inputs), solution.states, goal,
            float(np.sqrt(solution.cost)), solution.iterations, solution.kkt_residual,
            _CALL_WORK + (solution.iterations + 1) * problem.intervals,
        )

    def _problem(
        self, situation: Situation, goal: Vector, duration: float, to_first_knot: float
    ) -> HoldProblem:
        durations = knot_durations(duration, self._period, to_first_knot)
        upper = np.full((durations.size, INPUT_SIZE), self._max_speed)
        lower = -upper
        # What the first and the last ramp can do is exact in the bounds; between other knots the
        # acceleration is a penalty.
        in_force = np.clip(situation.input_in_force, -self._max_speed, self._max_speed)
        first, last = self._acceleration * durations[0], self._acceleration * durations[-1]
        upper[0] = np.minimum(upper[0], in_force + first)
        lower[0] = np.maximum(lower[0], in_force - first)
        if durations.size > 1:
            stop_upper = np.minimum(upper[-2], last)
            stop_lower = np.maximum(lower[-2], -last)
            meets = stop_lower <= stop_upper
            upper[-2] = np.where(meets, stop_upper, upper[-2])
            lower[-2] = np.where(meets, stop_lower, lower[-2])
        upper[-1] = lower[-1] = 0.0
        return HoldProblem(
            state=situation.state,
            goal=goal,
            input_in_force=situation.input_in_force,
            durations=durations,
            constants=situation.constants.as_array(),
            lower=lower,
            upper=upper,
            input_scale=self._max_speed,
            input_weight=_REGULARISATION,
            slew_weight=SLEW_WEIGHT,
            max_acceleration=self._acceleration,
            max_step=self._effort.max_step,
        )
