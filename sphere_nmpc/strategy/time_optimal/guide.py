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
from functools import cached_property
from typing import NamedTuple

import numpy as np

from sphere_nmpc.floor.route import Route, StraightRoute, in_sight, route_to
from sphere_nmpc.model.course import Leg, LegEnd
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.goal import Goal, Orientation
from sphere_nmpc.model.state import POSE, POSITION, QUATERNION, Vector, without_momentum
from sphere_nmpc.solver.roll_out import roll_out
from sphere_nmpc.strategy.clearance import Margin, is_clear, needed_distance
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.plan import UNPLANNED_RATIO, Plan
from sphere_nmpc.strategy.time_optimal.arrival import ArrivalSolver, rolled_out
from sphere_nmpc.strategy.time_optimal.chain import joined
from sphere_nmpc.strategy.time_optimal.lines import gone_back, line_hold
from sphere_nmpc.strategy.time_optimal.steady_rolling import SteadyRolling

_MAX_LEG = 1e4
"""Leg of a straight route on which the sphere rolls steadily [m]: the direction to a goal at
100 km would have to be planned to more digits than the solver attains."""
_MAX_LAST_LEG_RATIO = 2.5
"""Length of the last leg at most, over that of the others."""
_MAX_GOAL_DISTANCE = 14.0
"""Largest distance of a local goal on a route with corners [Rs]."""
_CANDIDATES = 24
"""Number of places among which a local goal is chosen."""
_LINE_LENGTHS = 0.1, 0.3, 0.75, 1.75, 3.0, 5.0, 10.0
"""Lengths of the lines that are tried [Rs]. Local goals are no nearer than the shortest one.

By its length the way left at the end of a part has to be less than where the sphere has last
rested: there are then finitely many rests on the way to a goal.
"""
_MAX_LINES = 6
"""Lines to a narrow place at most."""
_OPEN_ROOM, _NARROW_ROOM = 0.8, 0.2
"""Room beyond the needed distance [Rs] with which a search finds motions easily; room at a goal
below which it hardly does."""


class Aim(NamedTuple):
    """What a search aims at.

    Attributes
    ----------
    situation : Situation
        With the goal that is aimed at: a local one is the end of a leg put in front.
    detour : float or None
        Length by which the way there is longer than the straight line [m]; None if that is free.
    share : float
        Share of the planning effort that it is worth.
    """

    situation: Situation
    detour: float | None = None
    share: float = 1.0

    @property
    def is_local(self) -> bool:
        """Whether the goal is a local one."""
        return self.situation.course.legs[self.situation.leg].end is LegEnd.THROUGH


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


class Guide:
    """Guide of a search in one situation.

    Parameters
    ----------
    situation : Situation
        State at the start, and the goal.
    solver : ArrivalSolver
        Solver with the limits of the drives.
    rested : ndarray of shape (2,), or None
        Where the sphere has last rested [m]; None where it is now.
    """

    def __init__(
        self, situation: Situation, solver: ArrivalSolver, rested: Vector | None = None
    ) -> None:
        self._situation, self._solver = situation, solver
        self._place, self._goal = situation.state[POSITION], situation.goal.pose[POSITION]
        self._rested = self._place if rested is None else rested

    @cached_property
    def route(self) -> Route | StraightRoute:
        """Routes to the goal: to compute them takes as long as a search on a large floor."""
        situation = self._situation
        return route_to(situation.floor, self._goal, situation.least_distance)

    def guidance(self, failed: int) -> Guidance:
        """Return what to aim at: the goal if it is in sight, else a place on the route.

        `failed` searches before have found nothing: after each the local goal is nearer.
        """
        situation, place, goal = self._situation, self._place, self._goal
        floor, steady = situation.floor, situation.has_small_momentum
        near = self._solver.near_distance
        leg, distance = _MAX_LEG if steady else near, float(np.linalg.norm(goal - place))
        sees_goal = failed % 2 == 0 and floor.least_distance(place) > 0.0 and bool(
            in_sight(floor, place, goal[None, :], needed_distance(situation, Margin.FOUND))[0]
        )
        if sees_goal and distance <= (leg if failed and not steady else _MAX_LAST_LEG_RATIO * leg):
            room = floor.least_distance(goal) - situation.least_distance
            narrow = room < _NARROW_ROOM * situation.radius
            aims = [] if narrow else [Aim(situation)]
            return Guidance(aims, sees_goal, by_lines=narrow or failed > 0)
        if sees_goal:
            aims = [self._aim_at(place + (leg / distance) * (goal - place))]
            return Guidance(aims, by_lines=failed > 0)
        path = self.route.path(place)
        if len(path) == 0:
            return Guidance([], reason=(
                f"the goal: no way with {situation.least_distance:.3g} m (radius and clearance) "
                "on either side leads there from the place of the sphere"
            ))
        chosen = _place_on(path, situation, failed)
        detour = None
        if not failed:
            length = self.route.length(place) - self.route.length(chosen)
            detour = max(0.0, length - float(np.linalg.norm(chosen - place)))
        aims = [self._aim_at(chosen, detour)]
        if self.route.length(place) <= near:
            aims.insert(0, Aim(situation, self.detour(), share=0.5))
        return Guidance(aims)

    def _aim_at(self, place: Vector, detour: float | None = None) -> Aim:
        situation = self._situation
        pose = np.concatenate((place, situation.goal.pose[QUATERNION]))
        leg = Leg(Goal(pose, Orientation.ANY, since=situation.time), LegEnd.THROUGH)
        course = situation.course.by_way_of(situation.leg, leg)
        return Aim(replace(situation, course=course), detour)

    def detour(self) -> float | None:
        """Return by how much the way to the goal is longer than the line [m]; None in sight."""
        situation, place, goal = self._situation, self._place, self._goal
        needed = needed_distance(situation, Margin.KEPT)
        if in_sight(situation.floor, place, goal[None, :], needed)[0]:
            return None
        return max(0.0, self.route.length(place) - float(np.linalg.norm(goal - place)))

    def leads_on(self, plan: Plan) -> bool:
        """Return whether a plan leads on from where the sphere has last rested."""
        least = _LINE_LENGTHS[0] * self._situation.radius
        return self.route.length(_end_of(plan)) <= self.route.length(self._rested) - least

    def on_the_way(self, plan: Plan) -> Plan:
        """Return a plan to a place on the route, with what is left from there.

        That is the time of rolling from there to the goal, and of its manoeuvre.
        """
        limit = self._solver.robot.max_rotor_speed
        rolling = SteadyRolling.of(self._situation.constants, limit)
        way = self.route.length(_end_of(plan))
        time = way / rolling.speed + 0.5 * rolling.turn_time
        leg = replace(plan.leg, end=LegEnd.THROUGH, time_left=time, way_left=way)
        return replace(plan, leg=leg)

    def line_on(self) -> Plan | None:
        """Return the fastest of the straight lines that lead on to the goal, from rest to rest.

        It is there where a search finds nothing, as long as it is clear of what is occupied: the
        orientation does not matter to it.
        """
        situation, solver, route = self._situation, self._solver, self.route
        targets = along(route.path(self._place), situation.radius * np.array(_LINE_LENGTHS))
        speed = SteadyRolling.of(situation.constants, solver.robot.max_rotor_speed).speed

        def cost(line: Plan) -> float:
            return line.duration + UNPLANNED_RATIO * route.length(_end_of(line)) / speed

        on = filter(self.leads_on, _lines(situation, solver, targets))
        return min(on, key=cost, default=None)

    def lines_to_goal(self) -> tuple[Vector, FirstOrderHold] | None:
        """Return lines from the open to the goal, and the pose, (6,), where they begin.

        None where none are found. They go back along the route to the goal, or away from what is
        near.
        """
        situation, solver, holds = self._situation, self._solver, []
        here = replace(situation, state=without_momentum(situation.goal.pose))
        path = self.route.path(self._place)[::-1]

        def room(place: Vector) -> float:
            free = situation.floor.least_distance(place) - situation.least_distance
            return min(free, _OPEN_ROOM * situation.radius)

        def gain(line: Plan) -> float:
            return room(_end_of(line)) / (line.duration + solver.grid.unit)

        for _ in range(_MAX_LINES):
            place, lengths = here.state[POSITION], situation.radius * np.array(_LINE_LENGTHS)
            path = path[int(np.argmin(np.linalg.norm(path - place, axis=1))) :]
            away = _away(here, place)
            targets = np.vstack((along(path, lengths), place + lengths[:, None] * away))
            line = max(_lines(here, solver, targets), key=gain, default=None)
            if line is None:
                break
            holds.append(gone_back(line.hold))
            here = replace(here, state=line.states[-1])
            if room(here.state[POSITION]) >= _OPEN_ROOM * situation.radius:
                break
        if not holds:
            return None
        return here.state[POSE], joined(holds[::-1])


def _end_of(plan: Plan) -> Vector:
    """Return the place where a plan ends, shape (2,) [m]."""
    return plan.states[-1, POSITION]


def _place_on(path: Vector, situation: Situation, failed: int) -> Vector:
    """Return the place on the path of a route that is aimed at, shape (2,) [m]."""
    place, radius, near = situation.state[POSITION], situation.radius, 0.5**failed
    reach = max(_LINE_LENGTHS[0], _MAX_GOAL_DISTANCE * near) * radius
    straight = float(np.linalg.norm(situation.goal.pose[POSITION] - place))
    if failed and straight < reach:
        reach = max(_LINE_LENGTHS[0] * radius, near * straight)
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
            situation.state, hold.speeds, hold.durations, constants.as_array()
        )
        goal = Goal(states[-1, POSE].copy(), Orientation.ANY, since=hold.end)
        yield Plan(hold, states, leg=Leg(goal), error=0.0)


def _away(situation: Situation, place: Vector) -> Vector:
    """Return the direction in which the distance to what is occupied grows fastest."""
    step = 0.05 * situation.radius * np.vstack((np.eye(2), -np.eye(2)))
    found = np.nan_to_num(situation.floor.distances(place + step))
    slope: Vector = found[:2] - found[2:]
    return slope / max(float(np.linalg.norm(slope)), 1e-12)


def with_lines(
    situation: Situation, plan: Plan, lines: FirstOrderHold
) -> Plan | None:
    """Return the plan to where lines to the goal begin together with them; None if not clear."""
    goal = replace(situation.goal, orientation=Orientation.FULL)
    plan = replace(plan, leg=replace(plan.leg, goal=goal))
    found = rolled_out(plan, situation, joined([plan.hold, lines]))
    return found if is_clear(situation, found.hold, Margin.KEPT) else None
