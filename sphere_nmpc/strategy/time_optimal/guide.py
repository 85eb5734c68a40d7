# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Guide along a route: what a search aims at, and straight lines where it finds nothing.

A goal that is in sight and not too far is aimed at itself. Otherwise a local goal is: the farthest
place in sight along the route, with any orientation; long before the sphere is there, a search
from its predicted motion aims at the next one. Where nothing stands the route is a straight line.

Where searches find nothing the sphere rolls straight, from rest to rest. Without momentum every
motion can be gone back along: so it reaches a goal in a narrow place from any place to which lines
lead from there, if it begins with the orientation that they lead to.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sphere_nmpc.floor.route import Route, StraightRoute, in_sight, route_to
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.goal import STANDING, Goal, Orientation
from sphere_nmpc.model.state import POSE, POSITION, QUATERNION, Vector, without_momentum
from sphere_nmpc.solver.roll_out import roll_out
from sphere_nmpc.strategy.clearance import Margin, is_clear, needed_distance
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.plan import Plan, PlanStatus
from sphere_nmpc.strategy.time_optimal.arrival import ArrivalSolver, rolled_out
from sphere_nmpc.strategy.time_optimal.lines import gone_back, line_hold
from sphere_nmpc.strategy.time_optimal.steady_rolling import SteadyRolling

_LONGEST_LEG = 1e4
"""Leg of a straight route on which the sphere rolls steadily [m]: the direction to a goal at
100 km would have to be planned to more digits than the solver attains."""
_LAST_LEG = 2.5
"""Length of the last leg at most, over that of the others."""
_FARTHEST = 14.0
"""Largest distance of a local goal on a route with corners [Rs]."""
_CANDIDATES = 24
"""Number of places among which a local goal is chosen."""
_LENGTHS = 0.1, 0.3, 0.75, 1.75, 3.0, 5.0, 10.0
"""Lengths of the lines that are tried [Rs]. Local goals are no nearer than the shortest one.

By its length the way left at the end of a part has to be less than where the sphere has last
rested: there are then finitely many rests on the way to a goal.
"""
_LINES = 6
"""Lines to a narrow place at most."""
_OPEN, _NARROW = 0.8, 0.2
"""Room beyond the needed distance [Rs] with which a search finds motions easily; room at a goal
below which it hardly does."""
_REST_COSTS = 1.5
"""Time of the rest of a route, over that of rolling it without a stop: there will be others."""


class Aim(NamedTuple):
    """What a search aims at.

    Attributes
    ----------
    situation : Situation
        With the goal that is aimed at.
    is_final : bool
        Whether that is the final goal.
    detour : float
        Length by which the way there is longer than the straight line [m].
    share : float
        Share of the planning effort that it is worth.
    """

    situation: Situation
    is_final: bool
    detour: float = 0.0
    share: float = 1.0


class Guidance(NamedTuple):
    """What to do next on the way to a goal.

    Attributes
    ----------
    aims : list of Aim
        What to search for, one after the other until something is found.
    sees_goal : bool
        Whether the goal is in sight.
    by_lines : bool
        Whether lines are tried where nothing is found: not to be led along one where the next
        search finds the way to a goal in sight.
    reason : str
        Why there is no way to the goal; empty otherwise.
    """

    aims: list[Aim]
    sees_goal: bool = False
    by_lines: bool = True
    reason: str = ""


def route_of(situation: Situation) -> Route | StraightRoute:
    """Return the routes to the goal of a situation."""
    return route_to(situation.floor, situation.goal[POSITION], situation.least_distance)


def local_goal(situation: Situation, solver: ArrivalSolver, failed: int) -> Guidance:
    """Return what to aim at in a situation: the goal if it is in sight, else a place on the route.

    Parameters
    ----------
    situation : Situation
        State at the start, and the final goal.
    solver : ArrivalSolver
        Solver with the limits of the drives.
    failed : int
        Searches before that have found nothing: after each the local goal is nearer.
    """
    place, goal, floor = situation.state[POSITION], situation.goal[POSITION], situation.floor
    steady, near = situation.has_small_momentum, solver.near_distance
    leg, distance = _LONGEST_LEG if steady else near, float(np.linalg.norm(goal - place))
    # Before the routes are computed, which takes as long as a search on a large floor.
    sees_goal = failed % 2 == 0 and floor.least_distance(place) > 0.0 and bool(
        in_sight(floor, place, goal[None, :], needed_distance(situation, Margin.FOUND))[0]
    )
    if sees_goal and distance <= (leg if failed and not steady else _LAST_LEG * leg):
        narrow = floor.least_distance(goal) - situation.least_distance < _NARROW * situation.radius
        aims = [] if narrow else [Aim(situation, is_final=True)]
        return Guidance(aims, sees_goal, by_lines=narrow or failed > 0)
    if sees_goal:
        aims = [_aim_at(situation, place + (leg / distance) * (goal - place))]
        return Guidance(aims, by_lines=failed > 0)
    route = route_of(situation)
    path = route.path(place)
    if len(path) == 0:
        return Guidance([], reason=(
            f"the goal: no way with {situation.least_distance:.3g} m (radius and clearance) on "
            "either side leads there from the place of the sphere"
        ))
    chosen = _place_on(path, situation, failed)
    detour = 0.0
    if not failed:
        length = route.length(place) - route.length(chosen)
        detour = max(1e-3, length - float(np.linalg.norm(chosen - place)))
    aims = [_aim_at(situation, chosen, detour)]
    if route.length(place) <= near:
        aims.insert(0, Aim(situation, True, detour_to_goal(situation), share=0.5))
    return Guidance(aims)


def _aim_at(situation: Situation, place: Vector, detour: float = 0.0) -> Aim:
    goal = np.concatenate((place, situation.goal[QUATERNION]))
    aimed = replace(situation, goal=goal, orientation=Orientation.ANY, goal_rate=STANDING)
    return Aim(aimed, is_final=False, detour=detour)


def _place_on(path: Vector, situation: Situation, failed: int) -> Vector:
    """Return the place on the path of a route that is aimed at, shape (2,) [m]."""
    place, radius, near = situation.state[POSITION], situation.radius, 0.5**failed
    reach = max(_LENGTHS[0], _FARTHEST * near) * radius
    straight = float(np.linalg.norm(situation.goal[POSITION] - place))
    if failed and straight < reach:
        reach = max(_LENGTHS[0] * radius, near * straight)
    away: Vector = np.linspace(reach / _CANDIDATES, reach, _CANDIDATES, dtype=np.float64)
    targets = along(path, away)
    needed = needed_distance(situation, Margin.FOUND)
    seen = np.flatnonzero(in_sight(situation.floor, place, targets, needed))
    return targets[seen[-1] if seen.size else 0]


def along(path: Vector, away: Vector) -> Vector:
    """Return the places, shape (P, 2) [m], at lengths along a path, shape (K, 2).

    They are in the order of the lengths; for all that are longer it is the end, once.
    """
    steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
    at = np.concatenate(([0.0], np.cumsum(steps)))
    away = np.unique(np.minimum(away, at[-1]))
    return np.column_stack([np.interp(away, at, path[:, axis]) for axis in (0, 1)])


def detour_to_goal(situation: Situation) -> float:
    """Return by how much the way to the goal is longer than the straight line [m]; 0 in sight."""
    place, goal = situation.state[POSITION], situation.goal[POSITION]
    needed = needed_distance(situation, Margin.KEPT)
    if in_sight(situation.floor, place, goal[None, :], needed)[0]:
        return 0.0
    return max(1e-3, route_of(situation).length(place) - float(np.linalg.norm(goal - place)))


def leads_on(situation: Situation, rested: Vector, place: Vector) -> bool:
    """Return whether a part that ends at a place leads on from where the sphere has last rested.

    Both are of shape (2,) [m].
    """
    route = route_of(situation)
    return route.length(place) <= route.length(rested) - _LENGTHS[0] * situation.radius


def line_on(situation: Situation, solver: ArrivalSolver, rested: Vector) -> Plan | None:
    """Return the fastest of the straight lines that lead on to the goal, from rest to rest.

    It is there where a search finds nothing, as long as it is clear of what is occupied: the
    orientation does not matter to it. The sphere has last `rested` at a place, shape (2,) [m].
    """
    place, route = situation.state[POSITION], route_of(situation)
    targets = along(route.path(place), situation.radius * np.array(_LENGTHS))
    speed = SteadyRolling.of(situation.constants, solver.robot.max_rotor_speed).speed

    def cost(line: Plan) -> float:
        return line.duration + _REST_COSTS * route.length(line.states[-1, POSITION]) / speed

    lines = _lines(situation, solver, targets)
    on = (line for line in lines if leads_on(situation, rested, line.states[-1, POSITION]))
    return min(on, key=cost, default=None)


def lines_to_goal(
    situation: Situation, solver: ArrivalSolver
) -> tuple[Vector, FirstOrderHold] | None:
    """Return lines from the open to the goal, and the pose, shape (6,), where they begin.

    None where none are found. They go back along the route to the goal, or away from what is near.
    """
    here, holds = replace(situation, state=without_momentum(situation.goal)), []
    path = route_of(situation).path(situation.state[POSITION])[::-1]

    def room(place: Vector) -> float:
        free = situation.floor.least_distance(place) - situation.least_distance
        return min(free, _OPEN * situation.radius)

    def gain(line: Plan) -> float:
        return room(line.states[-1, POSITION]) / (line.duration + solver.grid.unit)

    for _ in range(_LINES):
        place, lengths = here.state[POSITION], situation.radius * np.array(_LENGTHS)
        path = path[int(np.argmin(np.linalg.norm(path - place, axis=1))) :]
        away = _away(here, place)
        targets = np.vstack((along(path, lengths), place + lengths[:, None] * away))
        line = max(_lines(here, solver, targets), key=gain, default=None)
        if line is None:
            break
        holds.append(gone_back(line.hold))
        here = replace(here, state=line.states[-1])
        if room(here.state[POSITION]) >= _OPEN * situation.radius:
            break
    if not holds:
        return None
    return here.state[POSE], joined(holds[::-1])


def _lines(
    situation: Situation, solver: ArrivalSolver, targets: Vector
) -> Iterator[Plan]:
    """Yield the motions straight to targets, shape (P, 2) [m], with any orientation, if clear."""
    place, needed = situation.state[POSITION], needed_distance(situation, Margin.STRAIGHT)
    constants = situation.constants
    for target in targets[in_sight(situation.floor, place, targets, needed)]:
        hold = line_hold(situation.state, target, constants, solver)
        if hold is None or not is_clear(situation, hold, Margin.STRAIGHT):
            continue
        states = roll_out(
            situation.state, hold.speeds, np.diff(hold.times), constants.as_array()
        )
        goal = Goal(states[-1, POSE].copy(), Orientation.ANY)
        yield Plan(PlanStatus.SOLVED, hold, states, goal, error=0.0)


def _away(situation: Situation, place: Vector) -> Vector:
    """Return the direction in which the distance to what is occupied grows fastest."""
    step = 0.05 * situation.radius * np.vstack((np.eye(2), -np.eye(2)))
    found = np.nan_to_num(situation.floor.distances(place + step))
    slope: Vector = found[:2] - found[2:]
    return slope / max(float(np.linalg.norm(slope)), 1e-12)


def joined(holds: list[FirstOrderHold]) -> FirstOrderHold:
    """Return holds from rest to rest, each from time 0 on, one after the other."""
    whole = holds[0]
    for hold in holds[1:]:
        whole = whole.followed_by(hold.delayed(whole.end))
    return whole


def with_lines(
    situation: Situation, plan: Plan, lines: FirstOrderHold
) -> Plan | None:
    """Return the plan to where lines to the goal begin together with them; None if not clear."""
    goal = replace(plan.goal, pose=situation.goal, orientation=Orientation.FULL)
    found = rolled_out(replace(plan, goal=goal), situation, joined([plan.hold, lines]))
    return found if is_clear(situation, found.hold, Margin.KEPT) else None


def time_to_go(situation: Situation, place: Vector, max_speed: float) -> float:
    """Return the time of rolling from a place to the final goal [s], and of its manoeuvre."""
    rolling = SteadyRolling.of(situation.constants, max_speed)
    return route_of(situation).length(place) / rolling.speed + 0.5 * rolling.turn_time


def way_of_time(time: float, situation: Situation, max_speed: float) -> float:
    """Return the length of the way [m] of a time to go [s]; see `time_to_go`."""
    rolling = SteadyRolling.of(situation.constants, max_speed)
    return rolling.speed * max(0.0, time - 0.5 * rolling.turn_time)
