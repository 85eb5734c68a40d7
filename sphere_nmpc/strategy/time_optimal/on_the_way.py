# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Goals on the way around obstacles: what a search aims at where the final goal is not in sight.

The farthest place in sight along the shortest way is aimed at, with any orientation; long before
the sphere is there, a search from its predicted motion aims at the next one. Where a search finds
nothing, the sphere rolls straight on, from rest to rest.
"""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sphere_nmpc.floor.floor import Floor
from sphere_nmpc.floor.way import Way, in_sight, way_to
from sphere_nmpc.model.goal import Orientation
from sphere_nmpc.model.state import POSITION, QUATERNION, Vector
from sphere_nmpc.strategy.clearance import Margin, is_clear, needed_distance
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.time_optimal.arrival import Arrival, ArrivalSolver
from sphere_nmpc.strategy.time_optimal.steady_rolling import SteadyRolling
from sphere_nmpc.strategy.time_optimal.straight import straight_arrival

_ROOM = 0.4, 0.15, 0.03, 0.0
"""Room beside a straight way that is looked for, in this order [Rs]: motions are not straight."""
_FARTHEST, _NEAREST = 14.0, 0.15
"""Distances of a goal on the way that is not the last one [Rs]."""
_CANDIDATES = 24
"""Number of places among which a goal on the way is chosen."""
_STRAIGHT = 10.0, 5.0, 3.0, 1.5, 0.75, 0.3, 0.1
"""Distances along the way [Rs] of places to which the sphere may roll straight."""
_REST_COSTS = 1.5
"""Time of the rest of a way, over that of rolling it without a stop: there will be others."""
_BEYOND = 1.5
"""Distance [Rs] by which it is then beyond what is in sight: motions are not straight."""
_LEAST_GAIN = 0.1
"""Length [Rs] by which the way left at the end of a part has to be less than where the sphere has
last rested: there are then finitely many rests on the way to a goal."""
_WORTH_IT = 0.7
"""Share of the distance of the farthest place in sight that one with more room has to have."""


class Aim(NamedTuple):
    """What a search aims at on the way to the final goal.

    Attributes
    ----------
    situation : Situation
        With the goal that is aimed at.
    is_goal : bool
        Whether the final goal is aimed at.
    reason : str
        Why nothing is aimed at; empty otherwise.
    detour : float
        Length by which the way there is longer than the straight line [m].
    """

    situation: Situation
    is_goal: bool = False
    reason: str = ""
    detour: float = 0.0


def way_of(situation: Situation, floor: Floor) -> Way:
    """Return the ways to the goal of a situation."""
    return way_to(floor, situation.goal[POSITION], situation.least_distance)


def aimed(situation: Situation, floor: Floor, fruitless: int) -> Aim:
    """Return what to aim at: the goal if it is in sight, else the farthest place that is.

    After `fruitless` searches it is nearer each time.
    """
    place, goal = situation.state[POSITION], situation.goal[POSITION]
    needed = needed_distance(situation, Margin.FOUND)
    near = 0.5**fruitless
    straight = float(np.linalg.norm(goal - place))
    # Before the ways are computed, which takes as long as a search on a large floor.
    if (
        fruitless % 2 == 0 and floor.distances(place[None, :])[0] > 0.0
        and in_sight(floor, place, goal[None, :], needed)[0]
    ):
        return Aim(situation, is_goal=True)
    way = way_of(situation, floor)
    path = way.path(place)
    if len(path) == 0:
        return Aim(situation, reason=(
            f"the goal: no way with {situation.least_distance:.3g} m (radius and clearance) on "
            "either side leads there from the place of the sphere"
        ))
    away = _lengths(path)
    reach = max(_NEAREST, _FARTHEST * near) * floor.radius
    if fruitless and straight < reach:
        reach = max(_NEAREST * floor.radius, near * straight)
    wanted = np.linspace(reach / _CANDIDATES, reach, _CANDIDATES)
    index = np.unique(np.minimum(np.searchsorted(away, wanted), len(path) - 1))
    targets = path[index]
    farthest = 0
    chosen = targets[0]
    for room in reversed(_ROOM):
        seen = np.flatnonzero(in_sight(floor, place, targets, needed + room * floor.radius))
        if seen.size == 0 or away[index[seen[-1]]] < _WORTH_IT * farthest:
            break
        farthest, chosen = max(farthest, away[index[seen[-1]]]), targets[seen[-1]]
    detour = 0.0
    if not fruitless:
        at = float(away[int(np.argmin(np.linalg.norm(path - chosen, axis=1)))])
        chosen = path[min(len(path) - 1, int(np.searchsorted(away, at + _BEYOND * floor.radius)))]
        length = way.length(place) - way.length(chosen)
        detour = max(1e-3, length - float(np.linalg.norm(chosen - place)))
    member = np.concatenate((chosen, situation.state[QUATERNION]))
    aim = replace(
        situation, goal=member, orientation=Orientation.ANY,
        goal_rate=np.zeros_like(situation.goal_rate),
    )
    return Aim(aim, detour=detour)


def detour_to_goal(situation: Situation, floor: Floor) -> float:
    """Return by how much the way to the goal is longer than the straight line [m]; 0 in sight."""
    place, goal = situation.state[POSITION], situation.goal[POSITION]
    needed = needed_distance(situation, Margin.KEPT)
    if in_sight(floor, place, goal[None, :], needed)[0]:
        return 0.0
    way = way_of(situation, floor)
    return max(1e-3, way.length(place) - float(np.linalg.norm(goal - place)))


def leads_on(situation: Situation, floor: Floor, rested: Vector, place: Vector) -> bool:
    """Return whether a part that ends at a place leads on from where the sphere has last rested.

    Both are of shape (2,) [m].
    """
    way = way_of(situation, floor)
    return way.length(place) <= way.length(rested) - _LEAST_GAIN * floor.radius


def rolled_straight(
    situation: Situation, floor: Floor, solver: ArrivalSolver, rested: Vector
) -> Arrival | None:
    """Return the fastest of the straight lines that lead on to the goal, from rest to rest.

    It is there where a search finds nothing, as long as it is clear of what is occupied: the
    orientation does not matter to it. The sphere has last `rested` at a place, shape (2,) [m].
    """
    place, way = situation.state[POSITION], way_of(situation, floor)
    path = way.path(place)
    away = _lengths(path)
    lengths = floor.radius * np.array(_STRAIGHT)
    targets = np.array([
        [np.interp(length, away, path[:, axis]) for axis in (0, 1)] for length in lengths
    ])
    needed = needed_distance(situation, Margin.STRAIGHT)
    seen = targets[in_sight(floor, place, targets, needed)]
    best, least = None, math.inf
    speed = SteadyRolling.of(situation.constants, solver.robot.max_rotor_speed).speed
    for target in seen:
        found = straight_arrival(situation, target, solver)
        if found is None or not leads_on(situation, floor, rested, found.states[-1, POSITION]):
            continue
        if not is_clear(situation, found.hold, Margin.STRAIGHT):
            continue
        cost = found.duration + _REST_COSTS * way.length(found.states[-1, POSITION]) / speed
        if cost < least:
            best, least = found, cost
    return best


def _lengths(path: Vector) -> Vector:
    """Return the lengths of a path up to its corners, from 0 on [m]."""
    steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
    found: Vector = np.concatenate(([0.0], np.cumsum(steps)))
    return found


def time_to_go(way: Way, place: Vector, situation: Situation, max_speed: float) -> float:
    """Return the time of rolling from a place to the final goal [s], and of its manoeuvre."""
    rolling = SteadyRolling.of(situation.constants, max_speed)
    return way.length(place) / rolling.speed + 0.5 * rolling.turn_time


def way_of_time(time: float, situation: Situation, max_speed: float) -> float:
    """Return the length of the way [m] of a time to go [s]; see `time_to_go`."""
    rolling = SteadyRolling.of(situation.constants, max_speed)
    return rolling.speed * max(0.0, time - 0.5 * rolling.turn_time)
