# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""How far a course is followed: the leg in force, arrival at its goal, progress towards it."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from sphere_nmpc.control.active_course import ActiveCourse, CourseInForce
from sphere_nmpc.control.decision import Decision
from sphere_nmpc.control.monitors import ArrivalDetector, Progress, relative_error
from sphere_nmpc.control.planner import Planner
from sphere_nmpc.estimation.estimator import Estimator
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.path import Tracking
from sphere_nmpc.model.state import POSE, POSITION, Vector
from sphere_nmpc.reporting.conditions import Kind
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.strategy.in_force import InForce
from sphere_nmpc.strategy.time_optimal.steady_rolling import SteadyRolling

_INSTANT = 1e-3
"""Time within which a velocity is constant [s]."""


class CourseFollowing:
    """Owner of the course in force, and of what is known of its end.

    Parameters
    ----------
    robot : RobotParameters
        Robot as built, and the limits of its drives.
    planner : Planner
        Owner of the plan in force, and of how far a path is followed.
    estimator : Estimator
        Has the newest pose.
    """

    def __init__(self, robot: RobotParameters, planner: Planner, estimator: Estimator) -> None:
        self._robot, self._planner, self.estimator = robot, planner, estimator
        self.course = CourseInForce()
        """The course in force."""
        self.arrival = ArrivalDetector()
        """The arrival at the goal of the leg that is followed."""
        self._progress = Progress(robot)
        self.is_refused = False
        """Whether the goal was refused at the last sampling instant with a plan."""

    def take(self, given: ActiveCourse, time: float | None = None) -> bool:
        """Follow another course, from the next sampling instant on.

        False if it is the one in force, see `CourseInForce.take`; the present plan and its
        progress are then kept.
        """
        is_other = self.course.take(given, time, self.arrival.reached)
        if is_other:
            self._aim()
        return is_other

    def begin_anew(self) -> None:
        """Forget the plan and where the sphere was, as the poses until now lead nowhere."""
        self.arrival.reset()
        self._progress.reset()
        self._planner.reset()

    def _aim(self) -> None:
        """Aim at another goal."""
        self.arrival = ArrivalDetector()
        self._progress.reset()
        if not self._planner.compares_goals:
            self._planner.reset()

    def on_its_leg(
        self, time: float, state: Vector, before: InForce | None, settings: ControllerSettings
    ) -> ActiveCourse | None:
        """Return the course with the leg that is followed from a sampling instant `time` [s] on.

        A goal with others after it is reached where the sphere, in `state` of shape (9,), is
        within the tolerance, or has passed it since the last instant: where it is then is compared
        with what the plan in force `before` predicts.
        """
        active = self.course.at(time)
        while not (active is None or active.is_last or self.is_refused):
            away = relative_error(state, active.goal.nearest(state, time), settings)
            if active.leg.follows and not self._has_followed(active, time):
                break
            if not away < 1.0:
                if before is None or not before.has_passed(active.course, active.index, time):
                    break
                if not relative_error(state, before.at(time)[POSE], settings) < 1.0:
                    break
            self.course.advance()
            self._aim()
            active, before = self.course.at(time), None
        return active

    def _has_followed(self, active: ActiveCourse, time: float) -> bool:
        """Return whether the sphere is beyond the path of a leg, by whose end it may lead."""
        return self._planner.paths.has_followed(active.course, active.index, time)

    def judged(
        self, time: float, decision: Decision, active: ActiveCourse | None, pose: Vector,
        speeds_at: Callable[[float], Vector], settings: ControllerSettings,
    ) -> Decision:
        """Return a decision of a sampling instant `time` [s] with arrival or missing progress.

        `pose` is the newest one measured, shape (6,), and `speeds_at` returns the rotor speeds in
        force at a time [rad/s].
        """
        goal, found = decision.goal, decision.conditions
        away = relative_error(decision.state, goal, settings)
        if (self.is_refused and decision.solved) or (active and not active.is_last):
            away = math.nan  # a goal that is refused is not reached, wherever the sphere is
        elif active is not None and active.leg.follows and not self._has_followed(active, time):
            away = math.nan
        reached = self.arrival.update(time, away, settings.period)
        arrived = reached and found is Kind.TRACKING.conditions
        if goal is None or arrived or not decision.solved:
            self._progress.reset()
            return replace(decision, conditions=Kind.AT_GOAL.conditions) if arrived else decision
        missing = self._progress.update(time, pose, goal, speeds_at, decision, settings)
        if missing is None:
            return decision
        # First, as one that stands does not roll with saturated rotors.
        return replace(decision, conditions=(missing, *found))

    def goal_speed(self, time: float) -> float:
        """Return the speed at which the goal is expected to move at `time` on [m/s]."""
        active = self.course.at(time)
        return 0.0 if active is None else float(np.linalg.norm(active.goal.rate[POSITION]))

    def tracking(self) -> Tracking | None:
        """Return how the path is followed, by the newest pose; None where none is."""
        active = self.course.active
        path = None if active is None else active.leg.follows
        newest = None if path is None else self.estimator.newest
        if path is None or newest is None:
            return None
        way, place = self._planner.paths.way, newest[1][POSITION]
        x, y, direction, _ = path.at(way).tolist()
        along, left = math.cos(direction), math.sin(direction)
        speed = turned = math.nan
        in_force = self._planner.in_force
        if in_force is not None:
            since = max(newest[0], in_force.plan.hold.start)
            first, second = (in_force.at(since + step)[POSITION] for step in (0.0, _INSTANT))
            moved = (second - first) / _INSTANT
            speed = math.hypot(*moved)
            turned = math.remainder(math.atan2(moved[1], moved[0]) - direction, math.tau)
        return Tracking(
            way, path.length - way, along * (place[1] - y) - left * (place[0] - x), turned, speed
        )

    def remaining(self, time_left: float, way_left: float) -> tuple[float, float]:
        """Return time [s] and way [m] to the last of the goals; nan without goal or pose.

        To the goal that is aimed at they are those of the plan, where they are known, that is not
        nan; otherwise, and from goal to goal, those of rolling straight from rest to rest.
        """
        active, newest = self.course.active, self.estimator.newest
        if active is None or newest is None:
            return math.nan, math.nan
        rolling = SteadyRolling.of(
            self.estimator.plant.constants, self._robot.max_rotor_speed
        )
        ahead = (leg.goal.pose[POSITION] for leg in active.course.legs[active.index :])
        places = np.array([newest[1][POSITION], *ahead])
        ways: list[float] = np.linalg.norm(np.diff(places, axis=0), axis=1).tolist()
        if not math.isnan(way_left):
            ways[0] = way_left
        times = [rolling.duration(way) for way in ways]
        if way_left == 0.0 or not math.isnan(time_left):  # at rest at the goal, or planned
            times[0] = 0.0 if math.isnan(time_left) else time_left
        return sum(times), sum(ways)
