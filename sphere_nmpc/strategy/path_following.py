# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Planner along paths, whatever the strategy for goals is.

A plan is the fastest motion along the next part of the path from the measured state, up to a stop
on it, by `sphere_nmpc.solver.path_motion`: it brings the centre back to the path from beside it.
Once a sample period, and whenever something is new, it is planned anew, so that the stop is
reached only where the path ends or leads too near to what is occupied. How the sphere turns on the
way is free at each crossing of Gamma, and decides how near to their limits both rotors turn: other
choices are drawn, and followed where the whole plan is faster.

With momentum the rotors hold it along the motion besides; what is left, a turn about the body's z
axis, is met by the next plan.
"""

import math
from dataclasses import replace
from typing import cast

import numpy as np

from sphere_nmpc.model.course import Course, LegEnd
from sphere_nmpc.model.disturbance import after_slope, is_zero, rest_speeds
from sphere_nmpc.model.error_state import EXPECTED_DEVIATIONS
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.goal import Goal, Orientation
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.path import Path
from sphere_nmpc.model.state import POSE, POSITION, QUATERNION, without_momentum
from sphere_nmpc.reporting.conditions import Condition, Kind
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.solver.path_motion import PathLimits, PathMotion, PathProblem, along_path
from sphere_nmpc.solver.roll_out import roll_out
from sphere_nmpc.strategy.clearance import Margin, is_clear, needed_distance
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.plan import Plan
from sphere_nmpc.strategy.rest import hold_momentum, stop
from sphere_nmpc.strategy.time_optimal.steady_rolling import SteadyRolling

_HORIZON = 2.0
"""Time that is planned ahead, at the pace of the path [s; for the robot of Table 1]."""
_MAX_SPEED = 1.5
"""Largest speed of the centre [Rs in the time of a ramp of the rotors to their limit]: errors
decay along the path, and faster the rotors cannot follow. Table 1 attains 0.62."""
_SEARCH_LENGTH = 3.0
"""Length of the path ahead on which the sphere is looked for [Rs]."""
_TRIES_PER_PERIOD = 8
"""Other choices that are tried each sample period."""
_MAX_CHOICE = 1.5
"""Largest |C| that is drawn: with 1 the contact point turns back at a latitude of 58 degrees."""
_MIN_GAIN = 0.01
"""Time by which another choice has to be faster [s; for the robot of Table 1]."""
_SAME_STATE_SHARE = 0.05
"""Difference from the predicted state that is nothing new, over the tolerance of the path."""


class PathFollowing:
    """Planner along the paths of a course; at the end of each the strategy for goals takes over.

    Parameters
    ----------
    settings : ControllerSettings
        Sample period, control rate, speed along paths.
    robot : RobotParameters
        Limits of the drives.
    """

    def __init__(self, settings: ControllerSettings, robot: RobotParameters) -> None:
        self._settings, self._robot = settings, robot
        self.reset()

    def reset(self) -> None:
        """Forget how far the sphere is; it then counts as at the start of the path."""
        self.way = 0.0
        """Length of the path up to the place that is nearest [m]."""
        self._leg: tuple[object, int] | None = None
        self._turn = 0.0
        self._end = math.inf
        """When the path has been followed [s]."""
        self._draw = np.random.default_rng(0)

    def change(self, settings: ControllerSettings) -> None:
        """Use other settings from the next plan on."""
        self._settings = settings

    def leads(self, situation: Situation) -> bool:
        """Return whether the end of the path of the leg has not been reached yet."""
        path, aimed = _path_of(situation), (situation.course.origin, situation.leg)
        if aimed != self._leg:
            self.reset()
            self._leg = aimed
        place, radius = situation.state[POSITION], situation.constants.shell_radius
        first, last = self.way - radius, self.way + _SEARCH_LENGTH * radius
        self.way = path.nearest(place, first, last)
        away = float(np.linalg.norm(place - path.places[-1]))
        # Where poses are noisy the end would be corrected again and again.
        near = away <= EXPECTED_DEVIATIONS * situation.place_deviation
        if near and self.way >= path.length - path.spacing:
            self._end = -math.inf
        return situation.time < self._end

    def has_followed(self, course: Course, leg: int, time: float) -> bool:
        """Return whether the path of a leg has been followed at a time [s]."""
        return self._leg == (course.origin, leg) and time >= self._end

    def plan(self, situation: Situation) -> Plan:
        """Return the plan along the path of the leg."""
        path = _path_of(situation)
        plan = self._along(path, situation)
        rests = plan.leg.end is LegEnd.REST and not plan.stops
        self._end = plan.end if rests else math.inf
        until = min(situation.time + self._settings.period, self._end)
        return replace(plan, until=until, tolerance=_SAME_STATE_SHARE * path.tolerance)

    def _along(self, path: Path, situation: Situation) -> Plan:
        """Return the plan along the path."""
        units, period = self._settings.units, self._settings.control_period
        problem = self._problem(path, situation)
        best, pace = along_path(problem), problem.limits.pace

        def cost(motion: PathMotion) -> float:
            return float(motion.times[-1] + (problem.last - motion.ways[-1]) / pace)

        least = (problem.last - self.way) / pace
        for _ in range(max(1, round(_TRIES_PER_PERIOD * period / self._settings.period))):
            if cost(best) < least + 2.0 * _MIN_GAIN * units.time:
                break
            turn = self._draw.uniform(-_MAX_CHOICE, _MAX_CHOICE)
            motion = along_path(replace(problem, turn=turn))
            # One that would have to begin slower leads away from the path.
            begins = motion.jump <= best.jump
            if begins and cost(motion) < cost(best) - _MIN_GAIN * units.time:
                best, self._turn = motion, turn
        plan = self._plan(path, situation, best)
        if is_clear(situation, plan.hold, Margin.KEPT):
            return plan
        return self._up_to_obstacle(path, situation, replace(problem, turn=self._turn))

    def _problem(self, path: Path, situation: Situation) -> PathProblem:
        """Return the motion that is sought, without what holds the momentum."""
        robot, units, largest = self._robot, self._settings.units, self._robot.max_rotor_speed
        acceleration = min(robot.max_rotor_acceleration, situation.plant.acceleration)
        steady = SteadyRolling.of(situation.constants, largest).speed
        followed = _MAX_SPEED * situation.constants.shell_radius / (largest / acceleration)
        pace = min(self._settings.path_speed or steady, steady, followed)
        held = float(np.linalg.norm(situation.momentum))
        limits = PathLimits(max(largest - held, 0.1 * largest), acceleration, pace)
        speeds = situation.speeds
        if held:
            speeds = speeds - rest_speeds(situation.momentum, situation.state[QUATERNION])
        last = min(path.length, self.way + _HORIZON * units.time * pace)
        return PathProblem(
            path, self.way, last, situation.state, speeds, situation.constants.as_array(), limits,
            self._turn,
        )

    def _plan(self, path: Path, situation: Situation, motion: PathMotion) -> Plan:
        """Return the plan of a motion."""
        robot, now, speeds = self._robot, situation.time, motion.speeds
        constants, disturbance = situation.constants.as_array(), situation.disturbance
        durations = np.diff(motion.times)
        is_disturbed = not is_zero(situation.momentum, disturbance)
        if is_disturbed:
            still = roll_out(without_momentum(situation.state), speeds, durations, constants)
            speeds = speeds + [
                rest_speeds(after_slope(situation.momentum, disturbance, float(time)), quaternion)
                for time, quaternion in zip(motion.times, still[:, QUATERNION], strict=True)
            ]
        speeds[0] = situation.speeds
        hold = FirstOrderHold(now + motion.times, speeds)
        states = roll_out(
            situation.state, hold.speeds, hold.durations, constants, disturbance=disturbance
        )
        left = path.length - float(motion.ways[-1])
        pose = states[-1, POSE].copy()
        pose[POSITION] = path.at(float(motion.ways[-1]))[:2]
        leg = replace(
            situation.course.legs[situation.leg],
            goal=Goal(pose, Orientation.ANY, since=hold.end),
            end=LegEnd.THROUGH if left > 0.0 else LegEnd.REST, way_left=left,
            time_left=left * hold.durations.sum() / max(float(motion.ways[-1]) - self.way, 1e-9),
        )
        plan = Plan(
            hold, states, leg=leg, error=0.0,
            conditions=(Condition(Kind.PLANNED, f"along the path, {left:.2f} m after it"),),
        )
        if not is_disturbed:
            return plan
        rest = hold_momentum(
            hold, states[-1, 6:], disturbance, states[-1, QUATERNION], robot.max_rotor_speed
        )
        return plan.spliced(rest, np.tile(states[-1], (rest.times.size, 1)))

    def _up_to_obstacle(self, path: Path, situation: Situation, problem: PathProblem) -> Plan:
        """Return the plan up to where the path leads too near to what is occupied."""
        needed = needed_distance(situation, Margin.KEPT)
        ahead = path.places[int(self.way / path.spacing) :]
        blocked = np.flatnonzero(situation.floor.distances(ahead) < needed)
        near = self.way + path.spacing * float(blocked[0]) if blocked.size else problem.last
        reason = (
            f"the path: {near:.2f} m from its start it leads nearer than {needed:.3g} m to what "
            "is occupied"
        )
        for share in (1.0, 0.9, 0.7, 0.4, 0.2, 0.1):
            last = self.way + share * (min(near, problem.last) - self.way)
            if last <= self.way + path.spacing:
                break
            plan = self._plan(path, situation, along_path(replace(problem, last=last)))
            if is_clear(situation, plan.hold, Margin.KEPT):
                return plan.giving_up(reason) if blocked.size else plan
        return stop(situation, self._robot, "the path is blocked").giving_up(reason)


def _path_of(situation: Situation) -> Path:
    """Return the path of the leg that is followed."""
    return cast(Path, situation.course.legs[situation.leg].follows)
