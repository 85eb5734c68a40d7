# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Multi-start search for the earliest arrival that can be stopped at any time and continued.

In each round a few dozen guesses are tried by least squares, which reaches motions far from a
guess with little work. Those that promise the earliest arrivals are polished as minimum-time
problems, and the best of these is solved to the end on finer knots.

Whole turns of steady rolling lead from a near goal to a distant one, at the same orientation. So
the search aims at the near goal, whatever the distance; what it finds is extended by the turns and
solved again, as the direction to the near goal is slightly another one.
"""

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import islice

import numpy as np

from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.goal import Goal
from sphere_nmpc.model.state import POSITION, Vector, flipped_sign, state_error
from sphere_nmpc.solver.half_motions import Drives
from sphere_nmpc.strategy.clearance import Margin, is_clear
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.plan import Plan
from sphere_nmpc.strategy.time_optimal.arrival import ArrivalSolver, Trial
from sphere_nmpc.strategy.time_optimal.initial_guesses import (
    Guess,
    meeting_guesses,
    random_guess,
)
from sphere_nmpc.strategy.time_optimal.steady_rolling import (
    SteadyRolling,
    with_turns,
    without_turns,
)

_COMPARED: Vector = np.arange(1, 16) / 16.0
"""Times at which two motions are compared [of their durations]."""
_MAX_DIFFERENCE = 0.2
"""Mean difference of the speeds of two motions [of the largest] up to which they are alike."""
_FIRST_TURNS, _TURNS_GROWTH = 8, 2
"""Whole turns that are added to a near arrival first, and factor by which they grow then."""
_FIRST_SHARE = 0.75
"""Share of half motions and guesses that are tried in a round before the first arrival."""
_DELAY_GROWTH = 2.5
"""Factor on the delay of the shortest guess after each round without an arrival."""
_TIME_OF_ERROR = 2.5
"""Time by which a trial is longer than the one before, for its error [1 / (c1 u_max)]."""
_MAX_MERIT = 1.1
"""Sum of duration and delay [of the best arrival] up to which a trial is polished."""
_MAX_ROUNDS = 4
"""Rounds at most in which an earlier arrival is searched for, while guesses collide."""
_REACHED_ERROR, _REACHED_SHARE = 0.05, 0.1
"""Terminal error [-], and share of that at the start, below which a polished arrival is solved to
the end."""


class ArrivalSearch:
    """Search from one situation, at time 0; `improve` begins with what the last call found.

    Parameters
    ----------
    solver : ArrivalSolver
        Solver with the limits of the drives.
    situation : Situation
        State at the start, and the goal.
    seed : int
        Seed of the initial guesses.
    known : Plan, optional
        An arrival from this situation, before which another is searched for.
    detour : float or None, optional
        Length by which the way to the goal is longer than the straight line [m]; None where the
        line is free, so that whole turns may be left out of it.
    """

    def __init__(
        self, solver: ArrivalSolver, situation: Situation, seed: int,
        known: Plan | None = None, detour: float | None = None,
    ) -> None:
        settings, grid, robot = solver.settings, solver.grid, solver.robot
        self._solver, self._settings, self._grid = solver, settings, grid
        self._situation = situation
        self._rolling = SteadyRolling.of(situation.constants, robot.max_rotor_speed)
        self._drives = Drives(grid.spacing, robot.ramp_time, robot.max_rotor_speed)
        self._rng = np.random.default_rng(seed)
        self._turns = 0
        self._turn: Vector = np.zeros(2)
        """Displacement of a turn [m]."""
        self._near = situation
        has_turns = known is not None and known.made.turns > 0
        if situation.has_small_momentum and (has_turns or detour is None):
            self._aim_near(known)
        self._least = self._rolling_time(self._near) + (detour or 0.0) / self._rolling.speed
        end_speeds = situation.course.legs[situation.leg].speeds
        self._least += robot.ramp_time * (1.0 - max(map(abs, end_speeds)) / self._drives.limit)
        self._reached = _REACHED_ERROR
        if situation.has_small_momentum:  # otherwise the sphere leaves the goal by itself
            error = state_error(situation.state, situation.goal.pose)
            self._reached = min(_REACHED_ERROR, _REACHED_SHARE * error)
        self._window, self._later = settings.window * grid.unit, 0.0
        self.best: Plan | None = known
        """The earliest arrival found so far."""
        self.work = 0
        """Work so far, in microseconds or so."""
        self._deadline = np.inf
        self._collided = False
        """Whether a trial of the last round did not keep clear of what is on the floor."""

    def improve(self, work: int, deadline: float = np.inf) -> Plan | None:
        """Search for an earlier arrival.

        Parameters
        ----------
        work : int
            Work to use, in microseconds or so.
        deadline : float, optional
            Steady clock reading at which to stop [s]; makes the result depend on the machine.

        Returns
        -------
        Plan or None
            The earliest arrival so far.
        """
        end, self._deadline = self.work + work, deadline
        # Not kept, as they refer to the search, which would be freed as garbage only.
        steps = self._rounds()
        while self.work < end and time.perf_counter() < deadline:
            next(steps)
        return self.best

    def improve_once(self, deadline: float = np.inf) -> Plan | None:
        """Search for one round, or until the deadline; see `improve`.

        Where guesses collide it is a few rounds, or until one finds something.
        """
        self._deadline = deadline
        if self.best is not None:
            for _ in self._finished(self.best, added=self._turns):
                pass
        known = self.best
        for _ in range(_MAX_ROUNDS):
            for _ in self._round(1.0):
                if time.perf_counter() > deadline:
                    return self.best
            if self.best is not known or not self._collided:
                break
        return self.best

    def _rounds(self) -> Iterator[None]:
        """Search without end; each step is one solve or one draw of guesses."""
        while True:  # the first arrival takes little work
            yield from self._round(_FIRST_SHARE if self.best is None else 1.0)

    def _round(self, share: float) -> Iterator[None]:
        settings = self._settings
        guesses = self._guesses(share)
        yield
        trials = self._trials(guesses)
        yield
        clear = [trial for trial in trials if self._is_trial_clear(trial)]
        self._collided = len(clear) < len(trials)
        survivors = islice(_different(clear, self._merit), settings.polished)
        longest, polished = np.inf, list[Plan]()
        if self.best is not None:
            longest = self.best.duration - self._turns * self._rolling.turn_time
        for trial in survivors:
            if self._merit(trial) > _MAX_MERIT * longest:
                break
            if trial.error > self._reached:
                trial = self._with_more_time(trial)
            times, speeds, goal = trial.found
            hold = FirstOrderHold(times, speeds)
            polished.append(self._polished(self._near, self._near.aim(goal), hold))
            yield
        reached = [arrival for arrival in polished if arrival.error < self._reached]
        best = self.best
        for arrival in sorted(reached, key=self._merit):
            if self.best is best and arrival.duration < longest:
                yield from self._finished(arrival)
        # The shortest guesses may all be too short.
        short = (bool(polished) and not reached) or self.best is None
        self._later = _DELAY_GROWTH * self._later + self._grid.spacing if short else 0.0

    def _trials(self, guesses: list[Guess], aware: bool = False) -> list[Trial]:
        budget = self._deadline - time.perf_counter()
        trials = self._solver.trials(self._near, guesses, budget, aware)
        self.work += sum(trial.work for trial in trials)
        return trials

    def _merit(self, arrival: Plan | Trial) -> float:
        """Return the duration with what its error is worth [s]."""
        return arrival.duration + self._settings.error_weight * self._grid.unit * arrival.error

    def _with_more_time(self, trial: Trial) -> Trial:
        """Return a trial from another one, in the time that the error of that takes longer."""
        times, speeds, goal = trial.found
        factor = 1.0 + _TIME_OF_ERROR * self._grid.unit * trial.error / trial.duration
        slower = Guess(factor * times, speeds / factor, goal)
        return self._trials([slower], aware=True)[0]

    def _polished(self, situation: Situation, goal: Goal, guess: FirstOrderHold) -> Plan:
        return self._counted(self._solver.solve(
            situation, goal, guess, budget=self._deadline - time.perf_counter(), coarse=True
        ))

    def _finished(self, arrival: Plan, added: int = 0) -> Iterator[None]:
        """Solve a polished arrival to the end, at the goal, and keep it.

        `added` are the whole turns that it has; near the goal none.
        """
        for turns, more in self._steps_to_goal(added):
            longer = more * self._rolling.turn_time
            if arrival.made.turns:
                guess = self._lengthened(arrival, longer)
            else:
                guess = with_turns(arrival.hold, longer, self._drives.limit)
            near = arrival.leg.goal.at(self._situation.time)
            goal = self._situation.aim(self._goal_after(near, turns))
            arrival = self._polished(self._situation, goal, guess)
            yield
        arrival = replace(arrival, hold=self._grid.refined(arrival.hold))
        for found in self._solver.solves(self._situation, arrival, self._deadline):
            earlier = self.best is None or found.duration < self.best.duration
            is_there = self._counted(found).error <= self._settings.arrival_error
            if is_there and earlier and self._is_clear(found):
                self.best = found
            yield

    def _is_clear(self, arrival: Plan) -> bool:
        """Return whether a motion to the goal keeps clear of what is on the floor."""
        return is_clear(self._situation, arrival.hold, Margin.FOUND)

    def _is_trial_clear(self, trial: Trial) -> bool:
        """Return whether a motion to the near goal keeps clear with the turns that it lacks."""
        if self._situation.floor.is_empty:  # in no time
            return True
        hold = FirstOrderHold(trial.found.times, trial.found.speeds)
        if self._turns:
            longer = self._turns * self._rolling.turn_time
            hold = with_turns(hold, longer, self._drives.limit)
        return is_clear(self._situation, hold, Margin.FOUND)

    def _counted(self, arrival: Plan) -> Plan:
        self.work += arrival.made.work
        return arrival

    def _guesses(self, share: float) -> list[Guess]:
        settings, best = self._settings, self.best
        longest = self._least + self._later + self._window
        if best is not None:
            longest = min(longest, best.duration - self._turns * self._rolling.turn_time)
        if self._least + self._later > longest - self._grid.spacing:
            self._later = 0.0
        shortest = self._least + self._later
        found, work = meeting_guesses(
            self._rng, self._near, self._drives, (shortest, longest), share, settings,
            self._turns * self._turn,
        )
        self.work += work
        if not found and best is None:
            self._window *= 2.0
        for k in range(round(share * settings.polished)):
            duration = shortest + self._window * self._rng.random()
            goal = self._near.goal.pose
            goal = goal if k % 2 else flipped_sign(goal)
            found.append(
                random_guess(self._rng, duration, self._grid, self._drives.limit, goal)
            )
        return found

    def _lengthened(self, arrival: Plan, longer: float) -> FirstOrderHold:
        """Return the hold of an arrival with whole turns, rolling steadily for longer [s]."""
        interval = int(np.argmax(arrival.hold.durations))
        return without_turns(arrival.hold, interval, -longer)

    def _aim_near(self, known: Plan | None) -> None:
        """Leave whole turns of a distant goal out of the search."""
        situation, rolling = self._situation, self._rolling
        there = situation.goal.at(situation.time + self._rolling_time(situation))
        way = there[POSITION] - situation.state[POSITION]
        if known is None:
            beyond = float(np.linalg.norm(way)) - self._settings.near_distance(self._solver.robot)
            self._turns = max(0, int(beyond / rolling.turn_length))
        else:
            self._turns = known.made.turns
            interval = int(np.argmax(known.hold.durations))
            way = known.states[interval + 1, POSITION] - known.states[interval, POSITION]
        if self._turns:
            self._turn = rolling.turn_length / float(np.linalg.norm(way)) * way
            self._near = situation.aimed_at(
                situation.aim(self._goal_after(situation.goal.pose, 0))
            )

    def _rolling_time(self, situation: Situation) -> float:
        """Return the time of steady rolling to where the goal then is [s]."""
        way = situation.goal.pose[POSITION] - situation.state[POSITION]
        velocity, speed = situation.goal.rate[POSITION], self._rolling.speed
        distance, along = float(np.linalg.norm(way)), float(way @ velocity)
        excess = speed**2 - float(velocity @ velocity)
        if excess <= 0.0:  # it is met where it is now, if at all
            return distance / speed
        return (along + math.sqrt(along**2 + excess * distance**2)) / excess

    def _steps_to_goal(self, added: int) -> Iterator[tuple[int, int]]:
        """Yield the whole turns that have been added after each step, and how many in it.

        Continuation: the nearer the goal, the more its direction differs from that of the distant
        one.
        """
        while added < self._turns:
            more = min(self._turns, max(_FIRST_TURNS, _TURNS_GROWTH * added)) - added
            added += more
            yield added, more

    def _goal_after(self, near: Vector, turns: int) -> Vector:
        """Return the goal that is `turns` whole turns beyond the near one."""
        goal, missing = near.copy(), self._turns - turns
        # Without these turns it is met earlier.
        aimed = self._situation.goal
        moved = self._rolling.turn_time * aimed.rate[POSITION]
        goal[POSITION] = aimed.pose[POSITION] + missing * (moved - self._turn)
        return goal


def _different(trials: list[Trial], merit: Callable[[Trial], float]) -> Iterator[Trial]:
    """Yield trials in the order of their merit, of motions that are alike the first alone."""
    signatures = list[Vector]()
    for trial in sorted(trials, key=merit):
        signature = trial.found.resampled(trial.duration * _COMPARED)
        largest = float(np.max(np.abs(trial.found.speeds)))
        alike = (float(np.mean(np.abs(signature - one))) for one in signatures)
        if np.isfinite(trial.error) and all(d > _MAX_DIFFERENCE * largest for d in alike):
            signatures.append(signature)
            yield trial
