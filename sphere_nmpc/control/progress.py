# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Detection of missing progress: plans are made, and the sphere stands away from its goal."""

import math
from dataclasses import dataclass

import numpy as np

from sphere_nmpc.control.decision import Decision
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import QUATERNION, Vector, angle_error, position_error, state_error
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.strategy.plan import PlanStatus

_PERIODS = 6.0
"""Time without progress after which it is missing [sample periods] ..."""
_SHORTEST = 5.0
"""... but at least [s]: on a busy machine a search from rest takes seconds."""
_STANDING = 2e-3
"""Share of the largest speed [-] up to which a sphere stands, in the mean over that time."""
_FALLEN = 0.95
"""Share of an error [-] below which it has fallen."""
_NOISE_FACTOR = 5.0
"""Standard deviations of a measured pose [-] within which two poses do not differ."""
_IGNORED = 4.0
"""Rolling that the rotor speeds sent should have caused, over what counts as standing [-], above
which they have had no effect."""


@dataclass(frozen=True, eq=False)
class _Stand:
    """Where and since when the sphere stands.

    Attributes
    ----------
    since : float
        Control time of the first pose [s].
    pose : ndarray, shape (6,)
        That pose.
    error : float
        Its distance to the goal in R^6.
    """

    since: float
    pose: Vector
    error: float


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
        self._found = ""

    def update(
        self,
        time: float,
        pose: Vector,
        goal: Vector,
        speeds: Vector,
        decision: Decision,
        settings: ControllerSettings,
    ) -> str:
        """Record a sampling instant; return what there is instead of progress, empty where it is.

        Poses are compared once a sample period, whatever the control rate.

        Parameters
        ----------
        time : float
            Sampling instant [s].
        pose : ndarray, shape (6,)
            Newest measured state.
        goal : ndarray, shape (6,)
            Goal in force.
        speeds : ndarray, shape (2,)
            Rotor speeds in force [rad/s].
        decision : Decision
            Plan for this instant, with the drift.
        settings : ControllerSettings
            Sample period, tolerance of the goal, noise of the poses.
        """
        elapsed = time - self._time
        if 0.0 <= elapsed < 0.99 * settings.period:
            return self._found
        self._time = time
        self._found = self._compare(elapsed, pose, goal, speeds, decision, settings)
        return self._found

    def _compare(
        self,
        elapsed: float,
        pose: Vector,
        goal: Vector,
        speeds: Vector,
        decision: Decision,
        settings: ControllerSettings,
    ) -> str:
        """Return the result of `update`, `elapsed` [s] after the last one."""
        time, plan, error = self._time, decision.plan, state_error(pose, goal)
        resting = plan.status is PlanStatus.HOLDING and not plan.given_up
        if resting or error < _tolerance(settings):
            self._stand = None
            return ""
        longest = max(_PERIODS * settings.period, _SHORTEST)
        standing = _STANDING * self._gain * self._max_speed * longest + self._noise(settings)
        stand = self._stand
        if stand is None or elapsed < 0.0 or self._progresses(stand, pose, error, standing):
            self._stand, self._rolling = _Stand(time, pose, error), 0.0
            return ""
        self._rolling += self._gain * _excess(speeds, decision, time) * elapsed
        waited = time - stand.since
        if waited < longest:
            return ""
        ignored = self._rolling if self._rolling > _IGNORED * standing else 0.0
        return (
            f"given a sphere that has stood {error:.2g} from its goal for {waited:.1f} s, "
            f"expected motion; {self._cause(decision, ignored)}"
        )

    def _progresses(self, stand: _Stand, pose: Vector, error: float, standing: float) -> bool:
        """Return whether the sphere has moved by more than `standing` [rad], or its error fell."""
        return (
            error < _FALLEN * stand.error
            or position_error(pose, stand.pose) > standing * self._radius
            or angle_error(pose, stand.pose) > standing
        )

    def _noise(self, settings: ControllerSettings) -> float:
        """Return the rolling [rad] that two noisy poses of one place may differ by."""
        position = settings.pose_position_noise / self._radius
        return _NOISE_FACTOR * max(position, settings.pose_orientation_noise)

    def _cause(self, decision: Decision, ignored: float) -> str:
        """Return what is known of the cause, such as `ignored` rolling [rad] of the rotors."""
        plan = decision.plan
        if ignored:
            return (
                f"the rotor speeds sent would have rolled it by {ignored * self._radius:.2g} m: "
                "is it blocked, do its rotors turn, is the pose its own?"
            )
        if plan.given_up:
            return f"the strategy gives up {plan.given_up}"
        if plan.status is PlanStatus.RAMP_TO_REST:
            return f"there is no plan: {plan.message}"
        told = f"{plan.status.value}: {plan.message}" if plan.message else plan.status.value
        knots = zip(plan.hold.times, plan.hold.speeds, strict=True)
        planned = max(_excess(speeds, decision, float(time)) for time, speeds in knots)
        if planned < _STANDING * self._max_speed:
            return f"the plan leaves it where it is ({told})"
        return f"each plan begins at rest and moves it later ({told})"


def _tolerance(settings: ControllerSettings) -> float:
    """Return the error in R^6 below which no progress is needed, or none can be told."""
    # Two coordinates, and half the rotation about each of three axes.
    noise = math.hypot(
        math.sqrt(2.0) * settings.pose_position_noise,
        math.sqrt(0.75) * settings.pose_orientation_noise,
    )
    return settings.goal_tolerance + _NOISE_FACTOR * noise


def _excess(speeds: Vector, decision: Decision, time: float) -> float:
    """Return the largest difference of rotor speeds from those of rest at `time` [rad/s].

    A blocked sphere looks like one with the momentum that its rotors hold. Saturated rotors do not
    hold it, so that what stands then is not held by them, and all of their speed counts.
    """
    drift, state = decision.drift, decision.state
    saturated = decision.plan.status is PlanStatus.SATURATED
    if drift.is_zero or state is None or saturated:
        return float(np.max(np.abs(speeds)))
    turn = state[QUATERNION]
    held = drift.after_rest(turn, time - decision.plan.hold.start).rest_speeds(turn)
    return float(np.max(np.abs(speeds - held)))
