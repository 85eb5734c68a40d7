# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Anytime search for an early arrival: many starts, both signs of the quaternion, then shrinking.

A start that arrives is shortened until it no longer does. Once a few have arrived, most further
starts are the best arrival shaken, asked to be three per cent earlier. Starts that look worse than
most after a dozen iterations are given up.
"""

import time

import numpy as np

from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import POSITION, Vector, flipped_sign, state_error
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.time_optimal.arrival import Arrival, ArrivalSolver, Effort
from sphere_nmpc.strategy.time_optimal.starts import cruise_speed, random_guess, shaken

ARRIVED = 1e-3
"""Miss below which a coarse arrival counts; the strategy solves it again finely."""
_NEARER = 0.02
"""... and its share of the error at the start, which may itself be small."""

_LEAST_MISS = 2e-4
"""Miss that the coarse solves can still reach."""
_COARSE_STEP = 0.25
_PATIENCE = 6
"""Starts that may fail before more time is granted."""
_FAMILIES = 3
"""Arrivals from fresh starts before the best is shaken."""
_EARLIER = 0.97
_FRESH = 0.4
"""Share of fresh starts among the later ones."""
_GATE = 0.35
"""Share of starts that are worth more than a look."""


class ArrivalSearch:
    """Search from one situation; each call to `improve` goes on where the last one stopped.

    Parameters
    ----------
    robot : RobotParameters
        Limits of the drives.
    period : float
        Spacing of the knots [s].
    situation : Situation
        Where the robot is; its goal is aimed at with both signs of the quaternion.
    to_first_knot : float
        Time to the first knot [s].
    seed : int
        Seed of the starts.
    strict : bool, optional
        Whether only the least miss counts as an arrival: near the goal a coarse one may be so
        short that no stretch of it arrives.
    """

    def __init__(
        self,
        robot: RobotParameters,
        period: float,
        situation: Situation,
        to_first_knot: float,
        seed: int,
        strict: bool = False,
    ) -> None:
        self._situation = situation
        self._to_first_knot = to_first_knot
        self._max_speed = robot.max_rotor_speed
        self._rng = np.random.default_rng(seed)
        self._look = ArrivalSolver(robot, period, Effort(12, _COARSE_STEP, 1e-4))
        self._push = ArrivalSolver(robot, period, Effort(40, _COARSE_STEP, 1e-4))
        self._shrink = ArrivalSolver(robot, period, Effort(25, _COARSE_STEP, 1e-4))
        way = situation.goal[POSITION] - situation.state[POSITION]
        self._distance = float(np.linalg.norm(way))
        self._speed = cruise_speed(situation.constants, self._max_speed)
        self._duration = 2.0 + self._distance / self._speed
        error = state_error(situation.state, situation.goal)
        self._arrived = min(ARRIVED, max(_LEAST_MISS, 0.0 if strict else _NEARER * error))
        self._misses: list[float] = []
        self._families = 0
        self._starts = 0
        self._deadline = np.inf
        self.best: Arrival | None = None
        """The earliest arrival found so far."""
        self.work = 0
        """Solver iterations times intervals spent."""

    def adopt(self, arrival: Arrival) -> None:
        """Take a known arrival as the one to beat."""
        if self.best is None or arrival.duration < self.best.duration:
            self.best = arrival
            self._families = _FAMILIES

    def improve(self, work: int, deadline: float = np.inf) -> Arrival | None:
        """Search on.

        Parameters
        ----------
        work : int
            How much to spend: solver iterations times intervals, about a microsecond each.
        deadline : float, optional
            Steady clock reading at which to stop [s]; makes the result depend on the machine.

        Returns
        -------
        Arrival or None
            The earliest arrival so far.
        """
        end = self.work + work
        self._deadline = deadline
        while self.work < end and time.perf_counter() < deadline:
            self._starts += 1
            best = self.best
            if best is None or self._families < _FAMILIES or self._rng.random() < _FRESH:
                arrival = self._from_fresh_start()
            else:
                arrival = self._from(best)
            if arrival is not None:
                self._families += 1
                self._keep(self._shortened(arrival))
            elif self.best is None and self._starts % _PATIENCE == 0:
                self._duration *= 1.1
        return self.best

    def _from_fresh_start(self) -> Arrival | None:
        duration = self._duration
        if self.best is not None:
            # The first few may be a little later than the best: their valley may be deeper.
            share = 1.1 if self._families < _FAMILIES else _EARLIER
            duration = min(duration, share * self.best.duration)
        goal = self._situation.goal
        sign = goal if self._starts % 2 else flipped_sign(goal)
        guess = random_guess(
            self._rng, duration, self._distance, self._speed, self._max_speed
        )
        return self._attempt(sign, duration, guess)

    def _from(self, best: Arrival) -> Arrival | None:
        guess = shaken(self._rng, best.hold, 0.5 * self._rng.random(), self._max_speed)
        return self._attempt(best.goal, _EARLIER * best.duration, guess)

    def _attempt(self, goal: Vector, duration: float, guess: FirstOrderHold) -> Arrival | None:
        first = self._solve(self._look, goal, duration, guess)
        if first.miss <= self._arrived:
            return first
        recent = sorted(self._misses[-40:])
        hopeless = len(recent) >= 8 and first.miss > recent[int(_GATE * len(recent))]
        self._misses.append(first.miss)
        if hopeless:
            return None
        second = self._solve(self._push, goal, duration, first.hold)
        return second if second.miss <= self._arrived else None

    def _shortened(self, arrival: Arrival) -> Arrival:
        """Shorten an arrival until it no longer is one."""
        share = 0.1
        while share > 0.01 and time.perf_counter() < self._deadline:
            duration = (1.0 - share) * arrival.duration
            earlier = self._solve(self._shrink, arrival.goal, duration, arrival.hold)
            if earlier.miss <= self._arrived:
                arrival = earlier
            else:
                share *= 0.5
        return arrival

    def _solve(
        self, solver: ArrivalSolver, goal: Vector, duration: float, guess: FirstOrderHold
    ) -> Arrival:
        arrival = solver.solve(self._situation, goal, duration, guess, self._to_first_knot)
        self.work += arrival.work
        return arrival

    def _keep(self, arrival: Arrival) -> None:
        if self.best is None or arrival.duration < self.best.duration:
            self.best = arrival
