# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Approach to a goal in a narrow place: straight lines that are gone back along from it.

Without momentum every motion can be gone back along. So the sphere can reach the goal from any
place to which straight lines lead from there, if it begins with the orientation that they lead to;
in the open a search brings it there with that orientation.
"""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sphere_nmpc.floor.floor import Floor
from sphere_nmpc.floor.way import in_sight
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.goal import Orientation
from sphere_nmpc.model.state import POSE, POSITION, Vector, without_momentum
from sphere_nmpc.solver.roll_out import roll_out
from sphere_nmpc.strategy.clearance import Margin, is_clear, needed_distance
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.time_optimal.arrival import Arrival, ArrivalSolver
from sphere_nmpc.strategy.time_optimal.on_the_way import way_of
from sphere_nmpc.strategy.time_optimal.straight import joined, straight_hold

_OPEN = 0.8
"""Room beyond the needed distance [Rs] with which a search finds motions easily."""
_NARROW = 0.2
"""Room at a goal [Rs] below which it hardly does."""
_LENGTHS = 0.5, 1.0, 1.75, 3.0, 5.0
"""Lengths of the lines that are tried [Rs]."""
_LINES = 6
"""Lines of an approach at most."""


class Approach(NamedTuple):
    """Motion that ends at the goal.

    Attributes
    ----------
    pose : ndarray, shape (6,)
        Pose at its start.
    hold : FirstOrderHold
        Rotor speeds, from time 0 on.
    """

    pose: Vector
    hold: FirstOrderHold


def is_narrow(situation: Situation, floor: Floor) -> bool:
    """Return whether there is little room at the goal."""
    there = float(floor.distances(situation.goal[None, POSITION])[0])
    return there < situation.least_distance + _NARROW * floor.radius


def approach_to(
    situation: Situation, floor: Floor, solver: ArrivalSolver
) -> Approach | None:
    """Return an approach to the goal from the open; None where none is found.

    It goes back along the way from the sphere to the goal, or away from what is near.
    """
    here, holds = replace(situation, state=without_momentum(situation.goal)), []
    path = way_of(situation, floor).path(situation.state[POSITION])[::-1]
    for _ in range(_LINES):
        found = _line(here, floor, path, solver)
        if found is None:
            break
        hold, here = found
        holds.append(hold)
        place = here.state[POSITION]
        room = float(floor.distances(place[None, :])[0]) - situation.least_distance
        if room > _OPEN * floor.radius:
            break
        path = path[int(np.argmin(np.linalg.norm(path - place, axis=1))) :]
    if not holds:
        return None
    return Approach(here.state[POSE], joined([gone_back(hold) for hold in reversed(holds)]))


def _line(
    situation: Situation, floor: Floor, path: Vector, solver: ArrivalSolver
) -> tuple[FirstOrderHold, Situation] | None:
    """Return the line that gains the most room for its time, and the situation at its end."""
    place, needed = situation.state[POSITION], needed_distance(situation, Margin.STRAIGHT)
    away = np.linalg.norm(path - place, axis=1)
    lengths = floor.radius * np.array(_LENGTHS)
    on_path = [path[int(np.argmax(away >= length))] for length in lengths if away[-1] > length]
    targets = np.array([*on_path, *(place + length * _away(floor, place) for length in lengths)])
    room = floor.distances(targets) - situation.least_distance
    seen = in_sight(floor, place, targets, needed) & (room > 0.0)
    best, most = None, -math.inf
    for target, there in zip(targets[seen], room[seen], strict=True):
        hold = straight_hold(situation.state, target, situation.constants, solver)
        if hold is None or not is_clear(situation, hold, Margin.STRAIGHT):
            continue
        gain = min(float(there), _OPEN * floor.radius) / (hold.end + solver.grid.unit)
        if gain > most:
            end = roll_out(
                situation.state, hold.speeds, np.diff(hold.times), situation.constants.as_array()
            )[-1]
            best, most = (hold, replace(situation, state=end)), gain
    return best


def _away(floor: Floor, place: Vector) -> Vector:
    """Return the direction in which the distance to what is occupied grows fastest."""
    step = 0.05 * floor.radius * np.vstack((np.eye(2), -np.eye(2)))
    found = floor.distances(place + step)
    slope: Vector = found[:2] - found[2:]
    return slope / max(float(np.linalg.norm(slope)), 1e-12)


def gone_back(hold: FirstOrderHold) -> FirstOrderHold:
    """Return the hold by which the sphere goes back along the motion of another, from rest."""
    return FirstOrderHold(hold.end - hold.times[::-1], -hold.speeds[::-1])


def with_approach(
    situation: Situation, arrival: Arrival, approach: Approach
) -> Arrival | None:
    """Return the arrival at the start of an approach with that; None if it is not clear."""
    first = arrival.hold
    speeds = np.vstack((first.speeds, approach.hold.speeds[1:]))
    times = np.concatenate((first.times, first.end + approach.hold.times[1:]))
    aimed = replace(arrival, goal=situation.goal, orientation=Orientation.FULL)
    found = aimed.followed(situation, FirstOrderHold(times, speeds))
    return found if is_clear(situation, found.hold, Margin.KEPT) else None
