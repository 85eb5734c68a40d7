# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Searches and precise solutions on a common grid of knots."""

from collections.abc import Iterator

from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.time_optimal.arrival import Accuracy, Arrival, ArrivalSolver
from sphere_nmpc.strategy.time_optimal.grid import KnotGrid
from sphere_nmpc.strategy.time_optimal.search import ArrivalSearch
from sphere_nmpc.strategy.time_optimal.settings import TimeOptimalSettings


class ArrivalPlanner:
    """Searches and precise solutions for one set of drive limits.

    Parameters
    ----------
    robot : RobotParameters
        Limits of the drives.
    period : float
        Sample period: spacing of the knots [s].
    grid : KnotGrid
        Times of the knots.
    seeds : iterator of int
        Seeds of the searches, shared with other planners.
    tuning : TimeOptimalSettings
        Tuning of searches and solves.
    """

    def __init__(
        self,
        robot: RobotParameters,
        period: float,
        grid: KnotGrid,
        seeds: Iterator[int],
        tuning: TimeOptimalSettings,
    ) -> None:
        given, tuning = tuning, tuning.of(robot)
        self.tuning = tuning
        """Tuning of searches and solves for this robot."""
        self.general_tuning = given
        """The same for any robot."""
        self.max_speed = robot.max_rotor_speed
        """Limit of the rotor speeds [rad/s]."""
        self.robot = robot
        """Limits of the drives."""
        self.period = period
        """Sample period [s]."""
        self.grid = grid
        """Times of the knots."""
        self._seeds = seeds
        accuracy = Accuracy(
            tuning.precise_iterations, tuning.precise_step, tuning.precise_error,
            tuning.precise_rest_speed,
        )
        self._solver = ArrivalSolver(robot, period, accuracy, tuning)

    def search(
        self, situation: Situation, new_plan: bool, strict: bool = False
    ) -> ArrivalSearch:
        """Return a new search from `situation`; parameters as for `solve` and `ArrivalSearch`."""
        first = self.grid.to_first_knot(situation.time, new_plan)
        return ArrivalSearch(
            self.robot, self.period, situation, first, self.next_seed(), self.tuning, strict
        )

    def next_seed(self) -> int:
        """Return the seed of the next search."""
        return next(self._seeds)

    def solve(
        self,
        situation: Situation,
        goal: Vector,
        duration: float,
        guess: FirstOrderHold,
        new_plan: bool,
    ) -> Arrival:
        """Solve precisely for rotor speeds that end at `goal` after `duration`.

        Parameters
        ----------
        situation : Situation
            State of the robot and speeds of its rotors at the start.
        goal : ndarray, shape (6,)
            Goal with the quaternion sign that is aimed at.
        duration : float
            Time to the arrival [s].
        guess : FirstOrderHold
            Initial guess, from time 0 (now) on.
        new_plan : bool
            False if `guess` is the rest of the plan that is being followed.
        """
        first = self.grid.to_first_knot(situation.time, new_plan)
        return self._solver.solve(situation, goal, duration, guess, first)
