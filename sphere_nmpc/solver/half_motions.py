# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Half motions from the start and back from the goal, and pairs of them that nearly meet.

Without momentum the sphere rolls back along the same way with the opposite speeds. So a motion
from start to goal is one from the start and one from the goal that meet, and among a few thousand
of each, which are millions of pairs, some nearly do. The compiled functions work in single
precision; the plain ones, where there are none, give the same results but for rounding.
"""

import itertools
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sphere_nmpc.model.state import Vector
from sphere_nmpc.solver.native.library import library

LANES = 16
"""The number of half motions is a multiple of this."""

Floats = NDArray[np.float32]
Integers = NDArray[np.int32]


class Side(NamedTuple):
    """Half motions from one end; M of them, with a state at each of L + 1 knots.

    Attributes
    ----------
    end : ndarray, shape (6,) or (6, M)
        State at rest from which they begin, or one for each, all at one place.
    states : ndarray of float32, shape (L + 1, 6, M)
        States at the knots.
    steady : ndarray of int32, shape (M,)
        First knot from which both rotors stay at their limits.
    corners : ndarray of int32, shape (M,)
        Which of the four pairs of limits that is, 0 to 3; 3 - n is opposite to n.
    """

    end: Vector
    states: Floats
    steady: Integers
    corners: Integers


class Meetings(NamedTuple):
    """Best partner of each half motion from the start.

    Attributes
    ----------
    scores : ndarray of float32, shape (M,)
        Duration and the time for the distance at which the two miss each other [s]; infinite
        where there is no partner.
    periods : ndarray of int32, shape (M,)
        Number of knot periods of the whole motion.
    partners : ndarray of int32, shape (M,)
        Index of the half motion from the goal.
    pairs : int
        Number of pairs that were compared.
    """

    scores: Floats
    periods: Integers
    partners: Integers
    pairs: int


class Drives(NamedTuple):
    """What half motions have in common.

    Attributes
    ----------
    period : float
        Spacing of the knots [s], one integration step.
    ramp : float
        Time from rest to the limit of the rotor speeds [s].
    limit : float
        Limit of the rotor speeds [rad/s].
    """

    period: float
    ramp: float
    limit: float


def knots_of(signals: Floats, levels: int, begin: Vector, drives: Drives) -> Vector:
    """Return the rotor speeds at the knots of half motions [rad/s], shape (levels + 1, 2, M).

    Both rotors are at their limits but for ramps, which are centred at the switches: the mean of a
    signal of the values plus and minus one over a ramp to either side, times the limit.

    Parameters
    ----------
    signals : ndarray, shape (6, M)
        First signs of both rotors, and times of the first and the second switch of the first rotor
        and of the second [s], in ascending order.
    levels : int
        Number of periods.
    begin : ndarray, shape (2,) or (2, M)
        Rotor speeds at the first knot [rad/s], or those of each.
    drives : Drives
        Period, ramp and limit.
    """
    change = drives.limit * drives.period / drives.ramp
    times = drives.period * np.arange(levels + 1)[:, None, None]
    after, before = (
        _integral(np.abs(times + side), signals[2::2], signals[3::2])
        for side in (drives.ramp, -drives.ramp)
    )
    speeds: Vector = drives.limit * signals[:2] * (after - before) / (2.0 * drives.ramp)
    speeds[0] = begin.reshape(2, -1)
    for last, wanted in itertools.pairwise(speeds):
        wanted[:] = np.minimum(np.maximum(wanted, last - change), last + change)
    return speeds


def _integral(times: Vector, first: Floats, second: Floats) -> Vector:
    """Return the integral of a signal that is one until `first`, then minus one until `second`."""
    late = np.maximum(times - second, 0.0) - np.maximum(times - first, 0.0)
    return times + 2.0 * late


def half_motions(
    end: Vector, begin: Vector, signals: Floats, levels: int, drives: Drives, constants: Vector
) -> Side:
    """Return half motions from `end`, see `Side`, of a robot with lumped constants (4,).

    The other parameters as for `knots_of`, with the speeds of a motion from this end.
    """
    solver, count = library(), signals.shape[1]
    if solver is None:
        return plain_half_motions(end, begin, signals, levels, drives, constants)
    states = np.empty((levels + 1, 6, count), dtype=np.float32)
    states[0] = end.reshape(6, -1)
    steady, corners = np.empty((2, count), dtype=np.int32)
    arrays = (
        _doubles(constants), _doubles(begin),
        np.ascontiguousarray(signals, dtype=np.float32), states, steady, corners,
    )
    solver.hold_half_motions(count, levels, *drives, *_addresses(*arrays))
    return Side(end, states, steady, corners)


def plain_half_motions(
    end: Vector, begin: Vector, signals: Floats, levels: int, drives: Drives, constants: Vector
) -> Side:
    """Return what `half_motions` does, on NumPy and CasADi's virtual machine."""
    from sphere_nmpc.model.integrator import step_function

    count = signals.shape[1]
    knots = knots_of(signals, levels, begin, drives)
    step = step_function().map(count)
    states = np.empty((levels + 1, 6, count), dtype=np.float32)
    x: Any = np.broadcast_to(end.reshape(6, -1), (6, count))
    states[0] = x
    all_constants = np.repeat(constants[:, None], count, axis=1)
    for level in range(levels):
        x = step(x, knots[level], knots[level + 1], drives.period, all_constants)
        states[level + 1] = np.array(x)
    ramps = np.any(np.abs(knots) < 0.999 * drives.limit, axis=1)
    steady = levels + 1 - np.argmax(ramps[::-1], axis=0)
    corners = 2 * (knots[-1, 0] > 0.0) + (knots[-1, 1] > 0.0)
    return Side(end, states, steady.astype(np.int32), corners.astype(np.int32))


def meet(
    start: Side, goal: Side, periods: range, wanted: int, period: float, speed: float,
    turn_weight: float,
) -> Meetings:
    """Find the best partner of each half motion from the start.

    Parameters
    ----------
    start, goal : Side
        Half motions from both ends, of equal number M; those from the goal are gone back along.
    periods : range
        Numbers of knot periods of the whole motion, in ascending order.
    wanted : int
        Longer motions are not compared once so many have a score that these cannot have.
    period : float
        Spacing of the knots [s].
    speed : float
        Speed of steady rolling [m/s]: what is too far from the other end is left out, and the
        distance by which two half motions miss each other counts as the time that it takes.
    turn_weight : float
        Weight of orientation [m^2]: of the squared distance of the quaternions.
    """
    solver, count = library(), start.steady.size
    if solver is None:
        return plain_meet(start, goal, periods, wanted, period, speed, turn_weight)
    scores, memory = np.empty(count, np.float32), np.empty(14 * (count + LANES), np.float32)
    lengths, partners = np.empty((2, count), np.int32)
    arrays = (
        _place(start), _place(goal), start.states, goal.states,
        np.concatenate((start.steady, goal.steady)),
        np.concatenate((start.corners, 3 - goal.corners)), memory, scores, lengths, partners,
    )
    pairs = solver.hold_meet(
        count, periods.start, periods.stop - 1, wanted, period, speed, turn_weight,
        *_addresses(*arrays),
    )
    return Meetings(scores, lengths, partners, int(pairs))


def plain_meet(
    start: Side, goal: Side, periods: range, wanted: int, period: float, speed: float,
    turn_weight: float,
) -> Meetings:
    """Find what `meet` does, on NumPy."""
    count, pairs = start.steady.size, 0
    scores = np.full(count, np.inf, dtype=np.float32)
    lengths, partners = np.zeros((2, count), dtype=np.int32)
    for n in periods:
        forth, back = (n + 1) // 2, n // 2
        if np.sum(scores <= n * period) >= wanted:
            break
        for corner in range(4):
            left = _collected(start, forth, corner, _place(goal), speed * period * back)
            right = _collected(goal, back, 3 - corner, _place(start), speed * period * forth)
            if left.size == 0 or right.size == 0:
                continue
            pairs += left.size * right.size
            x, y = start.states[forth][:, left], goal.states[back][:, right]
            apart = (x[0, :, None] - y[0]) ** 2 + (x[1, :, None] - y[1]) ** 2
            apart += 2.0 * turn_weight * (1.0 - np.abs(x[2:].T @ y[2:]))
            which = np.argmin(apart, axis=1)
            found = np.maximum(apart[np.arange(left.size), which], 0.0)
            score = n * period + np.sqrt(found) / speed
            better = score < scores[left]
            scores[left[better]], lengths[left[better]] = score[better], n
            partners[left[better]] = right[which[better]]
    return Meetings(scores, lengths, partners, pairs)


def _collected(
    side: Side, level: int, corner: int, place: Vector, reach: float
) -> NDArray[np.intp]:
    away = side.states[level][:2] - place[:, None]
    near = np.sum(away * away, axis=0) <= reach * reach
    return np.flatnonzero((side.steady <= level) & (side.corners == corner) & near)


def _place(side: Side) -> Vector:
    """Return the position of one end [m], shape (2,)."""
    return _doubles(side.end.reshape(6, -1)[:2, 0])


def _doubles(values: Vector) -> Vector:
    return np.ascontiguousarray(values, dtype=np.float64)


def _addresses(*arrays: NDArray[Any]) -> list[int]:
    return [array.ctypes.data for array in arrays]
