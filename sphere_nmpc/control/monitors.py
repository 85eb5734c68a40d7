# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Monitors of the loop: arrival, missing progress, steps of the pose, reserve of the rotors."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from sphere_nmpc.control.decision import Decision
from sphere_nmpc.control.pose_stream import SAME_POSE_DEVIATIONS
from sphere_nmpc.model.disturbance import (
    Disturbance,
    push_against,
    rest_speeds,
    speeds_at_rest,
    time_to_saturation,
)
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import (
    MOMENTUM,
    POSITION,
    QUATERNION,
    Vector,
    angle_error,
    position_error,
    state_error,
)
from sphere_nmpc.reporting.conditions import Condition, Kind
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.strategy.plan import PlanStatus

_LEAVING_ERROR = 2.0
"""Relative error above which the goal counts as left: hysteresis against noise."""
_PERIODS_WITHOUT_PROGRESS = 6.0
"""Time without progress after which it is missing [sample periods], unless that is shorter than
`_MIN_TIME_WITHOUT_PROGRESS`."""
_MIN_TIME_WITHOUT_PROGRESS = 5.0
"""Shortest time after which progress is missing [s]: on a busy machine a search from rest takes
seconds."""
_STANDING_SHARE = 2e-3
"""Share of the largest speed [-] up to which a sphere stands, in the mean over that time."""
_FALLEN_ERROR_SHARE = 0.95
"""Share of an error [-] below which it has fallen."""
_IGNORED_ROLLING_RATIO = 4.0
"""Rolling that the rotor speeds sent should have caused, over what counts as standing [-], above
which they have had no effect."""
_WARNING_SPEED_SHARE = 0.7
"""Share of the limit of the rotor speeds from which on it is near [-]."""
_MAX_REPORTED_TIME = 60.0
"""Longest reported time to the limit [s]; slower changes are within the estimate's error."""


def relative_error(
    state: Vector | None, goal: Vector | None, settings: ControllerSettings
) -> float:
    """Return the error of a state over the tolerance [-]; nan without state or goal.

    With a tolerance of position or orientation of their own it is the larger of both ratios.
    """
    if state is None or goal is None:
        return math.nan
    position, angle = settings.tolerances
    if not (settings.position_tolerance or settings.orientation_tolerance):
        return state_error(state, goal) / settings.goal_tolerance
    return max(position_error(state, goal) / position, angle_error(state, goal) / angle)


class ArrivalDetector:
    """Detector of the arrival at the goal: the error has stayed below the tolerance for a time."""

    def __init__(self) -> None:
        self._away_since: float | None = None
        self._inside_since: float | None = None
        self.reached = False
        """Whether the sphere is at the goal."""
        self.took = float("nan")
        """Time [s] of the newest arrival: from the first sample, or from when the goal was left,
        until the error was within the tolerance."""

    def reset(self) -> None:
        """Discard past errors, as after an interruption."""
        if self.reached:
            self._away_since = None
        self._inside_since = None
        self.reached = False

    def update(self, time: float, error: float, dwell: float) -> bool:
        """Record a `relative_error` at a sampling instant [s]; return whether the goal is reached.

        The error has to stay below 1 for the time `dwell` [s]; nan counts as above.
        """
        if not error < (_LEAVING_ERROR if self.reached else 1.0):
            self.reset()
        elif self._inside_since is None or time < self._inside_since:
            self._inside_since = time
        if self._away_since is None or time < self._away_since:
            self._away_since = time
        if self._inside_since is not None and time >= self._inside_since + dwell:
            if not self.reached:
                self.took = self._inside_since - self._away_since
            self.reached = True
        return self.reached


class _Stand(NamedTuple):
    """First pose of a sphere that stands: control time [s], pose, error, place of the goal [m]."""

    since: float
    pose: Vector
    error: float
    place: Vector


class Progress:
    """Detector of missing progress from the measured poses, for robots of any size and speed.

    There is progress while the sphere moves or its error falls; at the goal none is needed. The
    poses are used as measured: one predicted from the speeds sent moves also where the sphere does
    not.

    Parameters
    ----------
    robot : RobotParameters
        Robot as built: its radius and largest speed.
    """

    def __init__(self, robot: RobotParameters) -> None:
        self._radius = robot.shell_radius
        self._gain = robot.lumped.input_gain
        self._max_speed = robot.max_rotor_speed
        self.reset()

    def reset(self) -> None:
        """Discard past poses, as with a new goal or while the robot is disabled."""
        self._stand: _Stand | None = None
        self._time = -math.inf
        self._rolling = 0.0
        self._found: Condition | None = None

    def update(
        self, time: float, pose: Vector, goal: Vector, speeds_at: Callable[[float], Vector],
        decision: Decision, settings: ControllerSettings,
    ) -> Condition | None:
        """Record a sampling instant; return that there is no progress, None where there is.

        Poses are compared once a sample period, whatever the control rate. At the sampling instant
        `time` [s] `pose` is the newest measured state; `speeds_at` returns the rotor speeds in
        force at a time [rad/s].
        """
        elapsed = time - self._time
        if 0.0 <= elapsed < 0.99 * settings.period:
            return self._found
        self._time, self._found = time, None
        plan, error = decision.plan, state_error(pose, goal)
        holds = plan.status is PlanStatus.HOLDING and not plan.given_up
        if holds:
            # With momentum it is moved on purpose, see `docs/momentum.md`.
            is_near = relative_error(decision.state, decision.goal, settings) < 1.0
            none_needed = is_near or bool(decision.momentum.any())
        else:
            none_needed = error < _tolerance(settings)
        if none_needed:
            self._stand = None
            return None
        longest = max(_PERIODS_WITHOUT_PROGRESS * settings.period, _MIN_TIME_WITHOUT_PROGRESS)
        standing = _STANDING_SHARE * self._gain * self._max_speed * longest + self._noise(settings)
        stand = self._stand
        if stand is None or elapsed < 0.0 or (
            # Noisy poses do not show that it rests where a plan holds it, unless the goal moves.
            not np.array_equal(goal[POSITION], stand.place) if holds
            else self._progresses(stand, pose, error, standing)
        ):
            self._stand, self._rolling = _Stand(time, pose, error, goal[POSITION]), 0.0
            return None
        self._rolling += self._gain * _excess(speeds_at(time), decision, time) * elapsed
        waited = time - stand.since
        if waited < longest:
            return None
        ignored = self._rolling if self._rolling > _IGNORED_ROLLING_RATIO * standing else 0.0
        self._found = Condition(
            Kind.NO_PROGRESS,
            f"given a sphere that has stood for {waited:.1f} s, error {error:.2g}, "
            f"expected motion; {self._cause(decision, ignored)}",
        )
        return self._found

    def _progresses(self, stand: _Stand, pose: Vector, error: float, standing: float) -> bool:
        """Return whether the sphere has moved by more than `standing` [rad], or its error fell."""
        return (
            error < _FALLEN_ERROR_SHARE * stand.error
            or position_error(pose, stand.pose) > standing * self._radius
            or angle_error(pose, stand.pose) > standing
        )

    def _noise(self, settings: ControllerSettings) -> float:
        """Return the rolling [rad] that two noisy poses of one place may differ by."""
        position = settings.pose_position_noise / self._radius
        return SAME_POSE_DEVIATIONS * max(position, settings.pose_orientation_noise)

    def _cause(self, decision: Decision, ignored: float) -> str:
        """Return what is known of the cause, such as `ignored` rolling [rad] of the rotors."""
        plan = decision.plan
        if plan.status is PlanStatus.HOLDING and not plan.given_up:
            return (
                "it rests as near as its poses show where it is: less noise of the poses, or a "
                "larger goal_tolerance"
            )
        if ignored:
            return (
                f"the rotor speeds sent would have rolled it by {ignored * self._radius:.2g} m: "
                "is it blocked, do its rotors turn, is the pose its own?"
            )
        if plan.given_up:
            return f"the strategy gives up {plan.given_up}"
        if plan.status is PlanStatus.RAMP_TO_REST:
            return f"there is no plan: {plan.message}"
        described = f"{plan.status.value}: {plan.message}" if plan.message else plan.status.value
        knots = zip(plan.hold.times, plan.hold.speeds, strict=True)
        planned = max(_excess(speeds, decision, float(time)) for time, speeds in knots)
        if planned < _STANDING_SHARE * self._max_speed:
            return f"the plan leaves it where it is ({described})"
        return f"each plan begins at rest and moves it later ({described})"


def _tolerance(settings: ControllerSettings) -> float:
    """Return the error in R^6 below which no progress is needed, or none can be seen."""
    # Two coordinates, and half the rotation about each of three axes.
    noise = math.hypot(
        math.sqrt(2.0) * settings.pose_position_noise,
        math.sqrt(0.75) * settings.pose_orientation_noise,
    )
    position, angle = settings.tolerances
    return min(position, 0.5 * angle) + SAME_POSE_DEVIATIONS * noise


def _excess(speeds: Vector, decision: Decision, time: float) -> float:
    """Return the largest difference of rotor speeds from those of rest at `time` [rad/s].

    A blocked sphere looks like one with the momentum that its rotors hold. Saturated rotors do not
    hold it, so that what stands then is not held by them, and all of their speed counts.
    """
    state = decision.state
    if state is None or decision.plan.status is PlanStatus.SATURATED:
        return float(np.max(np.abs(speeds)))
    elapsed = np.array([time - decision.plan.hold.start])
    held = speeds_at_rest(state[MOMENTUM], decision.disturbance, state[QUATERNION], elapsed)[0]
    return float(np.max(np.abs(speeds - held)))


def rotor_reserve(
    momentum: Vector, disturbance: Disturbance, robot: RobotParameters, goal: Vector
) -> Condition | None:
    """Return the warning about rotors that hold a momentum at the goal; None without one."""
    quaternion, limit = goal[QUATERNION], robot.max_rotor_speed
    needed = float(np.max(np.abs(rest_speeds(momentum, quaternion))))
    if needed < _WARNING_SPEED_SHARE * limit:
        return None
    x, y = push_against(robot, momentum).tolist()
    push = f"a push of {math.hypot(x, y):.2g} N s towards {math.degrees(math.atan2(y, x)):.0f} deg"
    if needed >= limit:
        return Condition(
            Kind.ROTORS_AT_LIMIT, f"given a momentum that needs {needed:.0f} rad/s at the "
            f"goal, expected at most {limit:.0f}; the sphere rolls until {push} or the opposite "
            "slope takes the momentum, which a level floor leaves as it is",
        )
    left = time_to_saturation(momentum, disturbance, quaternion, limit)
    if left > _MAX_REPORTED_TIME:
        return None
    return Condition(
        Kind.ROTORS_NEAR_LIMIT, f"given {needed:.0f} of {limit:.0f} rad/s to hold the momentum "
        f"at the goal, and {left:.1f} s until it can be held no longer; a level floor, a balanced "
        f"sphere or {push} helps",
    )
