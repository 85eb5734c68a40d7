# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The fixed-time problem behind the strategy: end at the goal, at rest, after a given time."""

from dataclasses import dataclass

import numpy as np

from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import INPUT_SIZE, Vector
from sphere_nmpc.solver.hold_solver import HoldSolver
from sphere_nmpc.solver.problem import HoldProblem, SolverSettings
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.time_optimal.grid import knot_durations
from sphere_nmpc.strategy.time_optimal.settings import TimeOptimalSettings

_REGULARISATION = 1e-12
"""Input weight that only keeps the normal equations regular."""

_LEAST_DECREASE = 1e-6
"""Decrease of the cost by an iteration [of the cost] below which a solve stops."""

_CALL_WORK = 60
"""Work of a call apart from its iterations."""


@dataclass(frozen=True, eq=False)
class Arrival:
    """Rotor speeds that lead to the goal in a given time, the solution of a fixed-time problem.

    Attributes
    ----------
    hold : FirstOrderHold
        Knots from time 0 (now) to the arrival [s].
    states : ndarray, shape (K, 6)
        Predicted states at the knots.
    goal : ndarray, shape (6,)
        Goal with the quaternion sign that is aimed at.
    error : float
        Predicted terminal error, norm in R^6: square root of the cost, which also contains what
        exceeds the acceleration limit.
    iterations : int
        Solver iterations used.
    kkt_residual : float
        First-order optimality.
    work : int
        Iterations times intervals: cost of the solve, the same on every machine.
    """

    hold: FirstOrderHold
    states: Vector
    goal: Vector
    error: float
    iterations: int
    kkt_residual: float
    work: int

    @property
    def duration(self) -> float:
        """Time to the arrival [s]."""
        return self.hold.end


@dataclass(frozen=True)
class Accuracy:
    """Limits of a single solve.

    Attributes
    ----------
    max_iterations : int
        Cap on solver iterations.
    max_step : float
        Longest integration step [s].
    error : float
        Terminal error [norm in R^6] at which the solve stops.
    """

    max_iterations: int
    max_step: float
    error: float


class ArrivalSolver:
    """Solver of fixed-time problems.

    Parameters
    ----------
    robot : RobotParameters
        Limits of the drives.
    period : float
        Sample period: spacing of the knots [s].
    accuracy : Accuracy
        Limits of each solve.
    settings : TimeOptimalSettings
        Spacing of the knots, share of the acceleration limit, weight of the penalty.
    """

    def __init__(
        self,
        robot: RobotParameters,
        period: float,
        accuracy: Accuracy,
        settings: TimeOptimalSettings,
    ) -> None:
        self._max_speed = robot.max_rotor_speed
        self._acceleration = settings.acceleration_share * robot.max_rotor_acceleration
        self._period = period
        self._max_step = accuracy.max_step
        self._settings = settings
        self._solver = HoldSolver(
            SolverSettings(
                max_iterations=accuracy.max_iterations,
                gradient_tolerance=0.0,
                decrease_tolerance=_LEAST_DECREASE,
                target_cost=accuracy.error**2,
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
            State of the robot and speeds of its rotors at the start.
        goal : ndarray, shape (6,)
            Goal with the quaternion sign that is aimed at.
        duration : float
            Time to the arrival [s].
        guess : FirstOrderHold
            Initial guess; it is stretched in time to end at `duration`.
        to_first_knot : float
            Time to the first knot [s].

        Returns
        -------
        Arrival
            The best found; its `error` shows whether it reaches the goal.
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
        durations = knot_durations(duration, self._period, to_first_knot, self._settings)
        upper = np.full((durations.size, INPUT_SIZE), self._max_speed)
        lower = -upper
        # The acceleration limit of the first and the last ramp is exact, as a bound on the knot
        # whose neighbour is fixed; between other knots it is a penalty.
        in_force = np.clip(situation.input_in_force, -self._max_speed, self._max_speed)
        first, last = self._acceleration * durations[0], self._acceleration * durations[-1]
        upper[0] = np.minimum(upper[0], in_force + first)
        lower[0] = np.maximum(lower[0], in_force - first)
        if durations.size > 1:
            stop_upper = np.minimum(upper[-2], last)
            stop_lower = np.maximum(lower[-2], -last)
            compatible = stop_lower <= stop_upper
            upper[-2] = np.where(compatible, stop_upper, upper[-2])
            lower[-2] = np.where(compatible, stop_lower, lower[-2])
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
            slew_weight=self._settings.slew_weight,
            max_acceleration=self._acceleration,
            max_step=self._max_step,
        )
