# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Multi-start search for an early arrival that can be stopped at any time and continued.

Initial guesses for both signs of the goal's quaternion are solved for a given duration. One that
reaches the goal is shortened until it no longer does. After a few arrivals, most further guesses
are perturbations of the best one, with a duration that is three per cent shorter. After a dozen
iterations about a third of the guesses, those of the least terminal error, are solved further.
"""

import time

import numpy as np

from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import INPUT_SIZE, POSITION, Vector, flipped_sign, state_error
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.time_optimal.arrival import Accuracy, Arrival, ArrivalSolver
from sphere_nmpc.strategy.time_optimal.initial_guesses import (
    cruise_speed,
    perturbed,
    random_guess,
)
from sphere_nmpc.strategy.time_optimal.settings import TimeOptimalSettings


class ArrivalSearch:
    """Search from one situation; each call of `improve` continues where the last one stopped.

    Parameters
    ----------
    robot : RobotParameters
        Limits of the drives.
    period : float
        Sample period: spacing of the knots [s].
    situation : Situation
        State at the start, and the goal, which is aimed at with both signs of the quaternion.
    to_first_knot : float
        Time to the first knot [s].
    seed : int
        Seed of the initial guesses.
    settings : TimeOptimalSettings
        Tuning of the search.
    strict : bool, optional
        Whether only the least terminal error counts as an arrival: near the goal a coarse solution
        may be so short that it reaches the goal with none of the delays that are tried.
    """

    def __init__(
        self,
        robot: RobotParameters,
        period: float,
        situation: Situation,
        to_first_knot: float,
        seed: int,
        settings: TimeOptimalSettings,
        strict: bool = False,
    ) -> None:
        def solver(max_iterations: int) -> ArrivalSolver:
            accuracy = Accuracy(max_iterations, settings.coarse_step, settings.coarse_target)
            return ArrivalSolver(robot, period, accuracy, settings)

        self._settings = settings
        self._situation = situation
        self._to_first_knot = to_first_knot
        self._max_speed = robot.max_rotor_speed
        self._rng = np.random.default_rng(seed)
        self._trial = solver(settings.trial_iterations)
        self._refining = solver(settings.refining_iterations)
        self._shortening = solver(settings.shortening_iterations)
        way = situation.goal[POSITION] - situation.state[POSITION]
        self._distance = float(np.linalg.norm(way))
        self._speed = cruise_speed(situation.constants, self._max_speed)
        self._duration = settings.manoeuvre_allowance + self._distance / self._speed
        self._first_duration = self._duration
        share = 0.0 if strict else settings.coarse_error_share
        error = share * state_error(situation.state, situation.goal)
        self._tolerance = min(settings.coarse_error, max(settings.least_coarse_error, error))
        self._trial_errors: list[float] = []
        self._arrivals = 0
        self._guesses = 0
        self._deadline = np.inf
        self.best: Arrival | None = None
        """The earliest arrival found so far."""
        self.work = 0
        """Solver iterations times intervals used so far."""

    def start_from(self, arrival: Arrival) -> None:
        """Take a known arrival as the best so far, unless a better one is known."""
        if self.best is None or arrival.duration < self.best.duration:
            self.best = arrival
            self._arrivals = self._settings.independent_arrivals

    def improve(self, work: int, deadline: float = np.inf) -> Arrival | None:
        """Continue the search.

        Parameters
        ----------
        work : int
            Work to use: solver iterations times intervals, about a microsecond each.
        deadline : float, optional
            Steady clock reading at which to stop [s]; makes the result depend on the machine.

        Returns
        -------
        Arrival or None
            The earliest arrival so far.
        """
        settings = self._settings
        end = self.work + work
        self._deadline = deadline
        if self._guesses == 0 and not self._situation.drift.is_zero:
            self._try_rest()
        while self.work < end and time.perf_counter() < deadline:
            self._guesses += 1
            best = self.best
            few = self._arrivals < settings.independent_arrivals
            if best is None or few or self._rng.random() < settings.random_share:
                arrival = self._from_random_guess()
            else:
                arrival = self._from_perturbation(best)
            if arrival is not None:
                self._arrivals += 1
                self._keep(self._shortened(arrival))
            elif self.best is None and self._guesses % settings.failures_before_longer == 0:
                self._duration *= settings.longer
                longest = settings.longest_with_momentum * self._first_duration
                if self._duration > longest and not self._situation.drift.is_zero:
                    self._duration = self._first_duration
        return self.best

    def _try_rest(self) -> None:
        """Try guesses at rest: after a push at the goal the sphere has to roll back a little."""
        goal = self._situation.goal
        for duration in self._settings.short_durations:
            rest = FirstOrderHold(np.array([0.0, duration]), np.zeros((2, INPUT_SIZE)))
            arrival = self._attempt(goal, duration, rest, unaware=True)
            if arrival is not None:
                self._arrivals += 1
                self._keep(self._shortened(arrival))
                return

    def _from_random_guess(self) -> Arrival | None:
        settings, duration = self._settings, self._duration
        if self.best is not None:
            few = self._arrivals < settings.independent_arrivals
            share = settings.independent_limit if few else settings.earlier
            duration = min(duration, share * self.best.duration)
        goal = self._situation.goal
        sign = goal if self._guesses % 2 else flipped_sign(goal)
        guess = random_guess(
            self._rng, duration, self._distance, self._speed, self._max_speed, settings
        )
        return self._attempt(sign, duration, guess, unaware=True)

    def _from_perturbation(self, best: Arrival) -> Arrival | None:
        amount = self._settings.largest_perturbation * self._rng.random()
        guess = perturbed(self._rng, best.hold, amount, self._max_speed)
        return self._attempt(best.goal, self._settings.earlier * best.duration, guess)

    def _attempt(
        self, goal: Vector, duration: float, guess: FirstOrderHold, unaware: bool = False
    ) -> Arrival | None:
        """Solve from an initial guess; None if it is given up or does not reach the goal."""
        first = self._solve(self._trial, goal, duration, guess, unaware)
        if first.error <= self._tolerance:
            return first
        given_up = self._is_given_up(first.error)
        self._trial_errors.append(first.error)
        if given_up:
            return None
        second = self._solve(self._refining, goal, duration, first.hold)
        return second if second.error <= self._tolerance else None

    def _is_given_up(self, error: float) -> bool:
        """Return whether the terminal error of a first solve is not among the least ones."""
        settings = self._settings
        recent = sorted(self._trial_errors[-settings.compared_guesses:])
        if len(recent) < settings.least_compared_guesses:
            return False
        return error > recent[int(settings.kept_guesses * len(recent))]

    def _shortened(self, arrival: Arrival) -> Arrival:
        """Shorten an arrival until it no longer reaches the goal."""
        share = self._settings.first_shortening
        while share > self._settings.least_shortening and time.perf_counter() < self._deadline:
            duration = (1.0 - share) * arrival.duration
            earlier = self._solve(self._shortening, arrival.goal, duration, arrival.hold)
            if earlier.error <= self._tolerance:
                arrival = earlier
            else:
                share *= 0.5
        return arrival

    def _solve(
        self,
        solver: ArrivalSolver,
        goal: Vector,
        duration: float,
        guess: FirstOrderHold,
        unaware: bool = False,
    ) -> Arrival:
        arrival = solver.solve(
            self._situation, goal, duration, guess, self._to_first_knot, unaware
        )
        self.work += arrival.work
        return arrival

    def _keep(self, arrival: Arrival) -> None:
        if self.best is None or arrival.duration < self.best.duration:
            self.best = arrival
