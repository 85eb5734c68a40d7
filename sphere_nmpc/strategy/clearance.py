# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Clearance of a plan: the certificate between its samples.

Without momentum |v| <= Rs c1 |u|, whatever the orientation, so that the way between two samples of
a path is no longer than the integral of that bound; the clearance at the samples then bounds that
between them. With momentum the speed of rolling freely is added, which is an estimate: the
certificate holds as far as that estimate does. A sphere inside of what is occupied has no distance
that it could keep: no motion is certified from there.
"""

import math
from enum import Enum
from typing import NamedTuple

import numpy as np

from sphere_nmpc.floor.floor import Floor
from sphere_nmpc.model.disturbance import GRAVITY, is_zero
from sphere_nmpc.model.error_state import EXPECTED_DEVIATIONS
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.state import MOMENTUM, POSITION, Vector
from sphere_nmpc.reporting.conditions import Kind
from sphere_nmpc.solver.half_motions import Side
from sphere_nmpc.solver.native.library import library
from sphere_nmpc.solver.roll_out import roll_out
from sphere_nmpc.strategy.contract import Situation

_MAX_SAMPLE_TIMES = 0.06, 0.015, 0.0025
"""Longest time between two samples of a path [1 / (c1 u_max)]: 25.5 mm of the way for Table 1 with
both rotors at their limits, and 6.4 and 1.1 mm where that does not certify it."""
_MAX_CHANGE = 1e-3
"""Distance [m] by which a plan may be nearer to what is occupied than its goal, a goal nearer than
a radius that is learnt, and the clearance fall where it is too small already."""
_ROUNDING_DISTANCE = 1e-6
"""Distance [m] by which a goal may lack radius and clearance."""
_MIN_INERTIA_SHARE = 0.1
"""Least share [-] of its inertia about the contact point that an imbalance leaves a sphere; beyond
it the bound of the speed is none."""


class Margin(Enum):
    """Clearance of a plan beyond the needed one [Rs].

    Each is less than the one before, for what changes in a plan as it is solved again.
    """

    FOUND = 0.02
    """Margin of a plan that a search finds."""
    STRAIGHT = 0.013
    """Margin of one along a straight line."""
    KEPT = 0.007
    """Margin of one that is being followed."""
    SENT = 0.0
    """Margin of a command that begins later than it was planned."""


def needed_distance(situation: Situation, margin: Margin) -> float:
    """Return the distance [m] of the sphere's centre from what is occupied that a plan keeps.

    The margin is for what changes in a plan and for the error of the estimated place. A goal may
    be as near as is allowed: a plan to it has no margin that it lacks.
    """
    floor = situation.floor
    beyond = margin.value * floor.radius + EXPECTED_DEVIATIONS * situation.place_deviation
    there = floor.least_distance(situation.goal.pose[POSITION]) - _MAX_CHANGE
    return min(situation.least_distance + beyond, max(there, situation.radius))


def refusal(situation: Situation, floor: Floor) -> tuple[Kind, str] | None:
    """Return why the sphere is not to move on a floor, whatever a plan is; None if it may."""
    place = situation.state[POSITION]
    if floor.is_occupied(place):
        inside = floor.grid.contains(place)
        return Kind.START_OCCUPIED if inside else Kind.START_OUTSIDE, (
            "the goal: the place of the sphere is occupied or outside of the floor, so that no "
            "motion keeps clear"
        )
    goal, radius = situation.goal.pose[POSITION], situation.radius
    distance = floor.distance(goal)
    if distance >= max(floor.needed - _ROUNDING_DISTANCE, radius - _MAX_CHANGE):
        return None
    if distance > 0.0:
        least = f"radius and clearance, {floor.needed:.3g} m"
        if radius > floor.needed:
            least = f"the radius that is learnt, {radius:.3g} m"
        reason = f"the goal: it is {distance:.3g} m from what is occupied, less than {least}"
        return Kind.GOAL_OCCUPIED, reason
    if floor.grid.contains(goal):
        return Kind.GOAL_OCCUPIED, "the goal: it is occupied"
    return Kind.GOAL_OUTSIDE, "the goal: it is outside of the floor"


def clearance_of(situation: Situation, hold: FirstOrderHold, margin: Margin) -> float:
    """Return the clearance that the motion by a hold is certified to keep, from time 0 (now) on.

    It is that between the sphere and what is occupied [m], infinite where nothing is; nan where it
    is not certified to be enough. A sphere that is nearer at the start than it has to be comes no
    nearer, and never into contact. What is certified with a margin is with all that are less.
    """
    floor = situation.floor
    if floor.is_empty:  # at every sample, in no time
        return math.inf
    found = certified(situation, hold, needed_distance(situation, margin))
    # What a start that is short of a larger margin has to keep may be less.
    for larger in Margin:
        if larger is margin or not math.isnan(found):
            break
        needed = needed_distance(situation, larger)
        if needed > floor.least_distance(situation.state[POSITION]):
            found = certified(situation, hold, needed)
    return found - situation.radius


def certified(situation: Situation, hold: FirstOrderHold, needed: float) -> float:
    """Return the distance [m] that a motion is certified to keep, nan if that is not enough."""
    solver = library()
    if solver is None:
        return plain_certified(situation, hold, needed)
    constants, disturbance = situation.constants, situation.disturbance
    corners, place = situation.floor.corner_distances, _place_of(situation.floor)
    # Named, so that they live until the call has ended.
    arrays = (
        constants.as_array(), disturbance.as_array(), hold.durations,
        np.ascontiguousarray(hold.speeds), np.ascontiguousarray(situation.state), corners,
    )
    spacings = _spacings(situation, hold)
    found: float = solver.hold_clearance(
        hold.times.size - 1, *(array.ctypes.data for array in arrays), *corners.shape,
        place.ctypes.data, needed, situation.radius, _MAX_CHANGE, bound_of_speed(situation),
        spacings.ctypes.data, spacings.size,
    )
    return found


def _place_of(floor: Floor) -> Vector:
    """Return where the grid of a floor is, as the compiled solver takes it, shape (5,)."""
    x, y, yaw = floor.fine.origin
    return np.array((x, y, math.cos(yaw), math.sin(yaw), floor.fine.resolution))


def _spacings(situation: Situation, hold: FirstOrderHold) -> Vector:
    """Return the longest times between samples [s] that are tried one after the other."""
    largest = max(1.0, float(np.max(np.abs(hold.speeds))))
    found: Vector = np.array(_MAX_SAMPLE_TIMES) / (situation.constants.input_gain * largest)
    return found


def plain_certified(situation: Situation, hold: FirstOrderHold, needed: float) -> float:
    """Do what `certified` does, on NumPy."""
    found = math.nan
    for longest in _spacings(situation, hold):
        profile = profile_of(situation, hold, float(longest))
        found = profile.certified(needed, situation.radius)
        first, least = float(profile.distances[0]), float(np.min(profile.distances))
        if least < needed <= first or not math.isnan(found):
            break  # closer samples would change nothing
    return found


def is_clear(situation: Situation, hold: FirstOrderHold, margin: Margin) -> bool:
    """Return whether the motion by a hold is certified to keep clear; see `clearance_of`."""
    return not math.isnan(clearance_of(situation, hold, margin))


class Profile(NamedTuple):
    """Clearance profile: the distance to what is occupied along a motion.

    Attributes
    ----------
    places : ndarray, shape (K, 2)
        Places along the motion [m].
    distances : ndarray, shape (K,)
        Lower bounds of the distances there [m].
    lengths : ndarray, shape (K - 1,)
        Upper bounds of the lengths of the way between them [m].
    """

    places: Vector
    distances: Vector
    lengths: Vector

    def certified(self, needed: float, radius: float) -> float:
        """Return a distance that the motion keeps [m], nan if it is not certified to keep enough.

        Where it begins with less than is `needed` [m], its distance must not fall until it has
        that. One that begins without a contact, within a `radius` [m], is certified not to have
        any between its samples either; from within what is occupied no motion is certified.
        """
        # From one sample the distance falls and to the next one it rises by no more than the way.
        distances, start = self.distances, float(self.distances[0])
        between = 0.5 * (distances[:-1] + distances[1:] - self.lengths)
        if start >= needed:
            least = float(np.min(between, initial=start))
            return least if least >= needed else math.nan
        if not start > 0.0:
            return math.nan
        reached = np.maximum.accumulate(distances)
        # Short of it at the start, whether a path falls is only known at its samples.
        known = np.where(reached[:-1] < needed, distances[1:], between)
        wanted = np.maximum(np.minimum(needed, reached[1:]) - _MAX_CHANGE, min(start, radius))
        if np.any(known < wanted) or (start >= radius and np.any(between < radius)):
            return math.nan
        return float(min(np.min(distances), np.min(between, initial=start)))


def profile_of(situation: Situation, hold: FirstOrderHold, longest: float) -> Profile:
    """Return the clearance profile of a motion.

    There are samples at all knots, and at most `longest` [s] apart.
    """
    constants, times = situation.constants, hold.times - hold.start
    parts = np.maximum(1, np.ceil(np.diff(times) / longest)).astype(int)
    shares = [k + np.arange(1, n + 1) / n for k, n in enumerate(parts)]
    at: Vector = np.concatenate(([0.0], *shares))
    index = np.arange(times.size, dtype=float)
    sampled = np.interp(at, index, times)
    speeds: Vector = np.column_stack([
        np.interp(sampled, times, hold.speeds[:, rotor]) for rotor in (0, 1)
    ])
    # To a power of two, as the memory for each number of samples is kept.
    missing = (1 << len(at).bit_length()) - len(at)
    durations = np.concatenate((np.diff(sampled), np.zeros(missing)))
    padded = np.vstack((speeds, np.tile(speeds[-1], (missing, 1))))
    states = roll_out(
        situation.state, padded, durations, constants.as_array(), math.inf, situation.disturbance
    )[: len(at)]
    norms = np.linalg.norm(speeds, axis=1)
    if not is_zero(situation.momentum, situation.disturbance):
        norms = norms + np.linalg.norm(states[:, MOMENTUM], axis=1)
    ways = 0.5 * bound_of_speed(situation) * (norms[1:] + norms[:-1]) * np.diff(sampled)
    places = states[:, POSITION]
    return Profile(places, situation.floor.distances(places), ways)


def bound_of_speed(situation: Situation) -> float:
    """Return the largest speed of the centre for rotor speeds and momentum of length 1 [m/rad].

    That is Rs c1 by the largest length of the horizontal part of what the equations of motion
    (`sphere_nmpc.model.dynamics`) are solved by for a right side of length 1, over all
    orientations (docs/floor.md).
    """
    radius, gain, r1, r3 = situation.constants.as_array().tolist()
    fastest, transverse, axial = radius * gain, 1.0 - r1, 1.0 - r3
    more = axial - transverse
    if is_zero(situation.momentum, situation.disturbance):
        # No rotor turns about the body's z axis; no body has more, but what is learnt may.
        beyond = axial / (2.0 * math.sqrt(transverse * more)) if more > transverse else 1.0
        return float(fastest * beyond)
    ratio = r1 / r3
    factor, rise = max(1.0, 1.0 / ratio), (ratio * axial) ** 2 - transverse**2
    if rise and more:
        # Where z is neither vertical nor horizontal: the square of the cosine of its angle.
        square = transverse / more - 2.0 * transverse**2 / rise
        if 0.0 < square < 1.0:
            within = transverse * axial * more * (ratio**2 * axial - transverse)
            factor = max(factor, abs(rise) / (2.0 * ratio * math.sqrt(within)))
    imbalance = situation.disturbance.imbalance
    beside = gain * radius / GRAVITY * math.sqrt(imbalance.dot(imbalance))
    half = 0.5 * (ratio + transverse)
    least = half - math.sqrt(max(half**2 - ratio * min(transverse, axial), 0.0))
    return float(fastest * factor / max(1.0 - 2.0 * beside / least, _MIN_INERTIA_SHARE))


def end_before_collisions(situation: Situation, side: Side, beyond: Vector) -> None:
    """Let half motions end, for all that they are compared for, before they collide.

    From there on their places are infinite. They take place at a displacement `beyond`, shape
    (2,) [m].
    """
    solver, floor, states = library(), situation.floor, side.states
    if floor.is_empty:
        return
    needed = needed_distance(situation, Margin.FOUND)
    if solver is None:
        collided = floor.collided(states[:, :2].transpose(0, 2, 1) + beyond, needed)
        states[:, :2] = np.where(collided[:, None], np.inf, states[:, :2])
        return
    corners, place = floor.corner_distances, _place_of(floor)
    solver.hold_end_before_collisions(
        states.shape[2], len(states) - 1, beyond.ctypes.data, corners.ctypes.data,
        *corners.shape, place.ctypes.data, needed, states.ctypes.data,
    )


def stop_before_contact(situation: Situation, hold: FirstOrderHold) -> str:
    """Return how a stop, from time 0 (now) on, ends in a contact; empty if it does not."""
    if situation.floor.is_empty:
        return ""
    profile = profile_of(situation, hold, float(_spacings(situation, hold)[-1]))
    touched = np.flatnonzero(profile.distances < situation.radius)
    if not touched.size:
        return ""
    whole, free = (float(np.sum(profile.lengths[:last])) for last in (None, touched[0]))
    return f"a stop without contact: it takes {whole:.2f} m, and {free:.2f} m are free"
