# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Initial guesses of the search: pairs of random half motions that nearly meet.

The fastest motions have both rotors at their limits but for a few switches, most of them near the
ends. Half motions of that kind are drawn from the start and, gone back along, from the goal. Where
two of them come near to each other with the rotors at the same limits, they are a guess for the
whole motion, and their durations nearly that of an arrival.
"""

from typing import NamedTuple

import numpy as np

from sphere_nmpc.model.goal import moved
from sphere_nmpc.model.state import INPUT_SIZE, POSE, Vector, flipped_sign
from sphere_nmpc.solver.half_motions import (
    Drives,
    Floats,
    half_motions,
    knots_of,
    meet,
)
from sphere_nmpc.strategy.clearance import end_before_collisions
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.time_optimal.knots import Grid
from sphere_nmpc.strategy.time_optimal.settings import TimeOptimalSettings
from sphere_nmpc.strategy.time_optimal.steady_rolling import SteadyRolling

_INTERVALS = (4, 8)
"""Range of the number of intervals of random speeds; the end is excluded."""
_NEVER = 1e9
"""Time of a switch that does not take place [s]."""


class Guess(NamedTuple):
    """Initial guess of a solve.

    Attributes
    ----------
    times : ndarray, shape (N + 1,)
        Times of the knots, from 0 on [s].
    speeds : ndarray, shape (N + 1, 2)
        Rotor speeds there [rad/s].
    goal : ndarray, shape (6,)
        Goal at time 0, or member of the set, with the quaternion sign that they lead to.
    """

    times: Vector
    speeds: Vector
    goal: Vector

    def resampled(self, times: Vector) -> Vector:
        """Return the speeds at other times [s], shape (K, 2)."""
        return np.column_stack([np.interp(times, self.times, row) for row in self.speeds.T])


def meeting_guesses(
    rng: np.random.Generator, situation: Situation, drives: Drives,
    durations: tuple[float, float], share: float, settings: TimeOptimalSettings,
    left_out: Vector,
) -> tuple[list[Guess], int]:
    """Draw half motions and return pairs that nearly meet, the most promising first.

    Parameters
    ----------
    rng : Generator
        Source of random numbers.
    situation : Situation
        State and speeds of the rotors at the start, and the goal. Momentum is left out.
    drives : Drives
        Spacing of the knots and limits of the rotors.
    durations : tuple of float
        Shortest and longest duration of a guess [s].
    share : float
        Share of the half motions and guesses of the settings that are drawn.
    settings : TimeOptimalSettings
        Numbers of half motions and of guesses; distribution of the switches; weight of the
        orientation in the distance by which half motions miss each other: the best guesses are
        those of the least sum of duration and time for this distance.
    left_out : ndarray, shape (2,)
        Displacement by steady rolling that is left out of the motions [m].

    Returns
    -------
    guesses : list of Guess
        At most one for each half motion from the start.
    work : int
        Effort of finding them, in microseconds or so.
    """
    start, period = situation.state[POSE], drives.period
    radius = situation.constants.shell_radius
    unit = 1.0 / (situation.constants.input_gain * drives.limit)
    speed = SteadyRolling.of(situation.constants, drives.limit).speed
    first, last = max(2, int(durations[0] / period)), int(durations[1] / period)
    levels = (last + 1) // 2
    count = 16 * round(share * settings.half_motions / 16)
    wanted = round(share * settings.tried_guesses)
    signals = _signals(rng, count, unit * settings.mean_switch)
    constants = situation.constants.as_array()
    in_force = np.clip(situation.speeds, -drives.limit, drives.limit)
    forth = half_motions(start, in_force, signals, levels, drives, constants)
    # A goal that moves counts as where it is after a guess of the mean duration.
    mean, goal = 0.5 * sum(durations), situation.goal
    ends = goal.orientation.draw(rng, goal.at(situation.time + mean), count)
    at_end: Vector = -np.array(situation.course.legs[situation.leg].speeds)
    back = half_motions(ends, at_end, signals, levels, drives, constants)
    end_before_collisions(situation, forth, np.zeros(2))
    end_before_collisions(situation, back, left_out)
    found = meet(
        forth, back, range(first, last + 1), wanted, period, speed,
        settings.turn_weight * radius**2,
    )
    best = np.flatnonzero(np.isfinite(found.scores))
    best = best[np.argsort(found.scores[best], kind="stable")[:wanted]]
    partners = found.partners[best]
    begin = np.repeat((in_force, at_end), best.size, axis=0).T
    both = knots_of(signals[:, np.concatenate((best, partners))], levels, begin, drives)
    from_start, from_goal = both[:, :, : best.size], -both[:, :, best.size :]
    guesses = []
    for k, (i, j) in enumerate(zip(best, partners, strict=True)):
        periods = int(found.periods[i])
        before, after = (periods + 1) // 2, periods // 2
        speeds: Vector = np.vstack((from_start[: before + 1, :, k], from_goal[:after, :, k][::-1]))
        same_sign = forth.states[before, 2:, i] @ back.states[after, 2:, j] > 0.0
        times: Vector = period * np.arange(periods + 1, dtype=np.float64)
        member = moved(ends[:, j % ends.shape[1]], goal.rate, -mean)
        guesses.append(Guess(times, speeds, member if same_sign else flipped_sign(member)))
    work = count * (20 + levels) // 40 + found.pairs // 1000
    return guesses, work


def _signals(rng: np.random.Generator, count: int, mean: float) -> Floats:
    """Draw signs of both rotors and times of their switches [s], shape (6, `count`).

    A rotor switches never, once or twice, and in the mean `mean` from the end [s].
    """
    times = mean * rng.standard_exponential((INPUT_SIZE, 2, count), dtype=np.float32)
    switches = rng.integers(3, size=(INPUT_SIZE, count))
    first = np.where(switches == 0, np.float32(_NEVER), times[:, 0])
    second = np.where(switches < 2, np.float32(_NEVER), times[:, 1])
    signs = np.sign(rng.random((INPUT_SIZE, count), dtype=np.float32) - 0.5)
    in_order = np.stack((np.minimum(first, second), np.maximum(first, second)), axis=1)
    return np.concatenate((signs, in_order.reshape(4, -1)))


def random_guess(
    rng: np.random.Generator, duration: float, grid: Grid, max_speed: float, goal: Vector
) -> Guess:
    """Draw rotor speeds within the limit `max_speed` [rad/s], from rest to rest.

    Far from the limits, which hardly any other guess is: there the rotors cannot hold momentum.
    """
    intervals = int(rng.integers(*_INTERVALS))
    speeds: Vector = rng.uniform(-max_speed, max_speed, (intervals + 1, INPUT_SIZE))
    speeds[0] = speeds[-1] = 0.0
    drawn = Guess(np.linspace(0.0, duration, intervals + 1, dtype=np.float64), speeds, goal)
    times = grid.coarse(duration)
    return Guess(times, drawn.resampled(times), goal)
