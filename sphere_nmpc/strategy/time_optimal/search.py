# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Multi-start search for an early arrival that can be stopped at any time and continued.

In each round a few dozen initial guesses are solved for a given duration, with few iterations. The
most promising ones are solved further, and from there Newton's method finds the duration at which
the least terminal error becomes zero. A motion in a slightly different time is nearly the same
motion with all speeds scaled, which gives the derivative of the error without another solve.
"""

import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import FARTHEST, POSE, POSITION, flipped_sign, state_error
from sphere_nmpc.solver.half_motions import Drives
from sphere_nmpc.solver.roll_out import roll_out
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.time_optimal.arrival import Accuracy, Arrival, ArrivalSolver
from sphere_nmpc.strategy.time_optimal.initial_guesses import (
    Guess,
    meeting_guesses,
    perturbed,
    random_hold,
)
from sphere_nmpc.strategy.time_optimal.settings import TimeOptimalSettings
from sphere_nmpc.strategy.time_optimal.steady_rolling import SteadyRolling

_SCALING = 1e-6
"""Change of the rotor speeds for the derivative of the terminal error by their scale [-]."""

_SAME_DURATION, _SAME_ERROR = 1e-3, 1e-4
"""Durations [s] and terminal errors [-] up to which two solves have the same result."""


@dataclass(frozen=True, eq=False)
class _Attempt:
    """A solve for a given duration, and the duration at which it would reach the goal [s]."""

    arrival: Arrival
    predicted: float


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
        self, robot: RobotParameters, period: float, situation: Situation, to_first_knot: float,
        seed: int, settings: TimeOptimalSettings, strict: bool = False,
    ) -> None:
        def solver(max_iterations: int) -> ArrivalSolver:
            accuracy = Accuracy(max_iterations, settings.coarse_step, settings.coarse_target)
            return ArrivalSolver(robot, period, accuracy, settings)

        self._settings = settings
        self._situation = situation
        self._to_first_knot = to_first_knot
        acceleration = settings.acceleration_share * robot.max_rotor_acceleration
        limit = robot.max_rotor_speed
        self._drives = Drives(period, limit / acceleration, limit)
        self._max_step = settings.coarse_step
        self._rng = np.random.default_rng(seed)
        self._trial = solver(settings.trial_iterations)
        self._refining = solver(settings.refining_iterations)
        self._shortening = solver(settings.shortening_iterations)
        way = situation.goal[POSITION] - situation.state[POSITION]
        distance = float(np.linalg.norm(way))
        self._window = settings.window
        speed = SteadyRolling.of(situation.constants, limit).speed
        self._least = distance / speed + self._drives.ramp
        share = 0.0 if strict else settings.coarse_error_share
        error = share * state_error(situation.state, situation.goal)
        self._tolerance = min(settings.coarse_error, max(settings.least_coarse_error, error))
        self._later, self._is_given = 0.0, False
        self._delay = settings.delay_of_distance
        self._steps = self._rounds()
        self.best: Arrival | None = None
        """The earliest arrival found so far."""
        self.work = 0
        """Solver iterations times intervals used so far, and as much for the initial guesses."""

    def start_from(self, arrival: Arrival) -> None:
        """Take a known arrival as the best so far, unless a better one is known."""
        self._keep(arrival)
        self._is_given = True

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
        end = self.work + work
        while self.work < end and time.perf_counter() < deadline:
            next(self._steps)
        return self.best

    def _rounds(self) -> Iterator[None]:
        """Search without end; each step is one solve or one draw of guesses."""
        while True:
            yield from self._round()

    def _round(self) -> Iterator[None]:
        settings, trials, delays = self._settings, list[_Attempt](), list[float]()
        guesses = self._guesses()
        yield
        for guess in guesses:
            duration = guess.hold.end
            if self.best is not None:
                duration = min(duration, settings.earlier * self.best.duration)
            trials.append(self._solve(self._trial, guess, duration, unaware=True))
            if guess.missed > 0.0:
                delays.append((trials[-1].predicted - guess.hold.end) / guess.missed)
            yield
        if delays:
            self._delay = max(settings.delay_of_distance, float(np.median(delays)))
        delay = settings.delay_of_error
        trials.sort(key=lambda trial: trial.arrival.duration + delay * trial.arrival.error)
        trials = _different(trials)
        refined = list[_Attempt]()
        for trial in trials[: int(np.ceil(settings.kept_guesses * len(trials)))]:
            refined.append(self._again(self._refining, trial, trial.arrival.duration))
            yield
        for attempt in _different(sorted(refined, key=lambda attempt: attempt.predicted)):
            yield from self._shortened(attempt)
        # The shortest guesses may all be too short.
        self._later = 0.0 if self.best is not None else 1.5 * self._later + settings.later

    def _guesses(self) -> list[Guess]:
        settings, best = self._settings, self.best
        if best is None or self._is_given:
            numbers = settings.first_half_motions, settings.first_tried_guesses
        else:
            numbers = settings.half_motions, settings.tried_guesses
        shortest = self._least + self._later
        longest = shortest + self._window
        if best is not None:
            longest = min(longest, best.duration)
        found, work = meeting_guesses(
            self._rng, self._situation, self._drives, (shortest, longest), numbers,
            self._delay, settings,
        )
        self.work += work
        if not found and best is None:
            self._window = min(2.0 * self._window, settings.longest_window)
        slow = self._drives.ramp > settings.long_ramp
        if slow or self._later > 0.0:
            for k in range(settings.random_guesses):
                duration = shortest + settings.window * self._rng.random()
                hold = random_hold(self._rng, duration, self._drives.limit)
                goal = self._situation.goal
                found.append(Guess(hold, goal if k % 2 else flipped_sign(goal)))
        if best is not None:
            for _ in range(settings.perturbations):
                amount = settings.largest_perturbation * self._rng.random()
                hold = perturbed(self._rng, best.hold, amount, self._drives.limit)
                found.append(Guess(hold, best.goal))
        return found

    def _shortened(self, attempt: _Attempt) -> Iterator[None]:
        """Find the shortest duration by Newton's method on the terminal error."""
        settings, too_short = self._settings, 0.0
        least_step, longest = settings.least_step, settings.stretch * attempt.arrival.duration
        error = np.inf
        for _ in range(settings.attempts):
            arrival = attempt.arrival
            if self._arrives(attempt):
                self._keep(arrival)
                if too_short > settings.bracket * arrival.duration:
                    return
                middle = 0.5 * (too_short + arrival.duration)
                duration = max(settings.probe * arrival.duration, middle)
            else:
                too_short = max(too_short, arrival.duration)
                later = (1.0 + least_step) * arrival.duration
                duration = max(settings.overshoot * attempt.predicted, later)
                least_step *= 2.0
                if duration > longest or arrival.error > settings.progress * error:
                    return
                error = arrival.error
                if self.best and duration >= settings.least_gain * self.best.duration:
                    return
            attempt = self._again(self._shortening, attempt, duration)
            yield

    def _arrives(self, attempt: _Attempt) -> bool:
        return attempt.arrival.error <= self._tolerance

    def _again(self, solver: ArrivalSolver, attempt: _Attempt, duration: float) -> _Attempt:
        arrival = attempt.arrival
        if self._arrives(attempt) and duration == arrival.duration:
            return attempt
        hold = arrival.hold
        if duration > arrival.duration:
            # The same motion in a longer time, which stretched alone would lead too far.
            hold = FirstOrderHold(hold.times, arrival.speeds(arrival.duration / duration))
        return self._solve(solver, Guess(hold, arrival.goal), duration)

    def _solve(
        self, solver: ArrivalSolver, guess: Guess, duration: float, unaware: bool = False
    ) -> _Attempt:
        arrival = solver.solve(
            self._situation, guess.goal, duration, guess.hold, self._to_first_knot, unaware
        )
        self.work += arrival.work
        return _Attempt(arrival, duration + arrival.error / self._rate(arrival))

    def _rate(self, arrival: Arrival) -> float:
        """Return the decrease of the terminal error with the duration [1/s].

        At the least error it changes with the duration alone (envelope theorem), and a longer time
        is as good as higher speeds.
        """
        situation = self._situation
        if not self._tolerance < arrival.error < FARTHEST:
            return self._settings.typical_rate
        # Both ends by the same integration: that of the solver is another one on a long interval.
        end, faster = (
            roll_out(
                situation.state, arrival.speeds(factor), np.diff(arrival.hold.times),
                situation.constants.as_array(), self._max_step, situation.disturbance,
            )[-1]
            for factor in (1.0, 1.0 + _SCALING)
        )
        missing = arrival.goal - arrival.states[-1, POSE]
        along = float(missing @ (faster - end)[POSE]) / (_SCALING * arrival.duration)
        return max(self._settings.least_rate, along / float(np.linalg.norm(missing)))

    def _keep(self, arrival: Arrival) -> None:
        if self.best is None or arrival.duration < self.best.duration:
            self.best = arrival


def _different(attempts: list[_Attempt]) -> list[_Attempt]:
    """Return the first of those that have come to the same motion: to the same terminal error."""
    found: dict[tuple[float, float], _Attempt] = {}
    for attempt in attempts:
        arrival = attempt.arrival
        key = round(arrival.duration / _SAME_DURATION), round(arrival.error / _SAME_ERROR)
        found.setdefault(key, attempt)
    return list(found.values())
