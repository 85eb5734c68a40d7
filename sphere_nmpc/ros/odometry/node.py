# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The odometry node: estimates the pose of the sphere from an IMU inside it and the rotors.

subscribes  imu, joint_states, initialpose, pose_fix
publishes   pose, odom, ~/status, /diagnostics
services    ~/reset
"""

import math
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Imu, JointState
from std_srvs.srv import Trigger

from sphere_nmpc.errors import InvalidInputError
from sphere_nmpc.estimation.imu import ImuSettings
from sphere_nmpc.estimation.mounting import RobotFrames
from sphere_nmpc.estimation.odometry import Odometry
from sphere_nmpc.estimation.odometry.kept_pose import KeptPose, anywhere, pose_memory, since
from sphere_nmpc.model.error_state import fixed_axes_covariance
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector
from sphere_nmpc.ros import cdr
from sphere_nmpc.ros.cdr import BODY_FRAME, LARGEST_JOINTS, seconds, stamp_of
from sphere_nmpc.ros.control_clock import ClockedNode, ControlClock
from sphere_nmpc.ros.graph_monitor import NO_EVENTS
from sphere_nmpc.ros.input_monitor import CHECK_EVERY
from sphere_nmpc.ros.lifetime import run
from sphere_nmpc.ros.odometry.reports import OdometryReports
from sphere_nmpc.ros.pose_publisher import PosePublisher, frame_prefix
from sphere_nmpc.ros.settings import FrameSettings, OdometryNodeSettings, SchedulingSettings
from sphere_nmpc.ros.stored import SAVE_EVERY, Stored

_ALL = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)
"""QoS of measurements of which none may be dropped while the node is held up, for half a second at
2000 Hz; publishers of either reliability match."""
_FEW = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
_DEPTH = 10
"""Poses kept for a subscriber that is slow."""


class OdometryNode(ClockedNode):
    """Node that passes measurements to an `Odometry`, and publishes the pose at each of the IMU's.

    Parameters
    ----------
    parameter_overrides : list of Parameter, optional
        Parameters as given on a command line; for use within a program.
    """

    uses_events_executor = True

    def __init__(self, parameter_overrides: list[Parameter] | None = None) -> None:
        super().__init__("odometry", parameter_overrides)
        declare = self.parameters.declare
        self._settings = declare(OdometryNodeSettings()).settings
        self._imu = declare(ImuSettings(), "imu").settings
        self._robot = declare(RobotParameters(), "robot").settings
        self._scheduling = declare(SchedulingSettings())
        self._frame = declare(FrameSettings()).settings.world_frame
        self.parameters.warn_of_unknown()
        # Time need not keep pace with the wall clock: what is measured has a stamp.
        self._control_clock = ControlClock(self, self._clock_jumped, has_pace=False)
        self.odometry = Odometry(self._settings, self._imu, self._robot)
        self._prefix = frame_prefix(self, self._settings.frame_prefix)
        urdf = self._settings.robot_description
        self._frames = RobotFrames(urdf) if urdf else None
        self._mounted: str | None = None if self._frames else ""
        """Frame whose mounting is in force; None before the first, "" where there is none."""
        self._given: tuple[Vector, Vector | None] | None = None
        self._stored = Stored(
            self, pose_memory, self._settings.pose_memory, self._control_clock, self._fault_log,
            "pose", "at initial_state",
        )
        self._recalled: tuple[KeptPose, float] | None = None
        """Pose of the last run, and its age [s, wall], until a calibration has checked it."""
        self._saved_at, self._was_at_rest = -math.inf, False
        self._angles: Vector | None = None
        """Newest angles of the rotors [rad], shape (2,)."""
        self._epoch: int | None = None
        self._sent: list[tuple[Any, Any]] = []
        self._sent_stamp = -1
        self._publisher = PosePublisher(
            self, self._robot.shell_radius, self._prefix, self._frame, _DEPTH
        )
        self._reports = OdometryReports(
            self, self._control_clock, self._fault_log, self._event_log
        )
        raw: dict[str, Any] = {"event_callbacks": NO_EVENTS, "raw": True}
        self.create_subscription(Imu, "imu", self._receive_imu, _ALL, **raw)
        self.create_subscription(
            JointState, "joint_states", self._receive_joints, _ALL, largest=LARGEST_JOINTS, **raw
        )
        for topic, take in (("initialpose", self._set_pose), ("pose_fix", self._correct)):
            self.create_subscription(PoseWithCovarianceStamped, topic, take, _FEW, **raw)
        self.create_service(Trigger, "~/reset", self._reset)
        self.create_wall_timer(CHECK_EVERY, self._check)

    @property
    def thread_priority(self) -> int:
        """Real-time priority as set."""
        return self._scheduling.settings.thread_priority

    def _time(self, stamp: int) -> float:
        """Return a stamp [ns] as time of the odometry [s], which begins with the first one."""
        if self._epoch is None:
            self._epoch = stamp
        return seconds(stamp, self._epoch)

    def _receive_imu(self, message: bytes) -> None:
        imu = cdr.read(message, cdr.Imu)
        stamp, frame, numbers = imu
        if not self._reports.received(self._reports.imu, stamp, np.array(numbers)):
            return
        imu.check_measured()
        if not self._stored.is_settled:
            self._recall()
        if self._mounted is None and self._frames is not None:
            self._mount(frame, self._frames)
        elif self._mounted not in ("", frame):
            raise InvalidInputError("frame", frame, f"'{self._mounted}', as of the first reading")
        reading = np.array(imu.rate), np.array(imu.force)
        if self.odometry.observe_imu(self._time(stamp), *reading):
            self._publish()
        elif stamp == self._sent_stamp:
            # A simulator whose time stands still repeats its readings, for those that are late.
            for publisher, pose in self._sent:
                publisher.publish(pose)

    def _mount(self, frame: str, frames: RobotFrames) -> None:
        """Begin anew with the IMU where the description has the frame of its messages."""
        place, turn = frames.mounting(frame.removeprefix(self._prefix), BODY_FRAME)
        imu = replace(
            self._imu, position=tuple(place.tolist()), orientation=tuple(turn.tolist())
        )
        self.odometry = Odometry(self._settings, imu, self._robot)
        self._mounted, self._epoch = frame, None
        if self._given is not None:
            self.odometry.set_pose(0.0, *self._given)

    def _receive_joints(self, message: bytes) -> None:
        joints = cdr.read(message, cdr.Joints)
        found = joints.of_rotors()
        if found is None:
            return  # of other joints
        if not self._reports.received(self._reports.joints, joints.stamp, found):
            return
        angles, speeds, _ = found
        known = self._angles = angles if np.isfinite(angles).all() else None
        if self.odometry.observe_rotors(self._time(joints.stamp), speeds, known):
            self._publish()

    def _recall(self) -> None:
        """Begin with the last pose of an odometry that ended lately, if there is one."""
        self._recalled = self._stored.restore()
        if self._recalled is None:
            return
        kept, age = self._recalled
        radius = self._robot.shell_radius
        self._given = kept.pose, since(kept, age, self._settings.pivoting, radius)
        self.odometry.set_pose(0.0, *self._given)
        self._event_log.report(
            "pose", f"begins with that of {age:.0f} s ago (pose_memory), if it still holds"
        )

    def _check_recalled(self, kept: KeptPose, age: float) -> None:
        """Compare the pose of the last run with what the calibration has found."""
        estimate = self.odometry.estimate
        if estimate is None:
            return
        self._recalled = None
        contradiction = kept.contradiction(age, estimate, self._angles)
        if contradiction and not self.odometry.fixes_used:
            self.odometry.set_pose(estimate.time, estimate.pose, anywhere(estimate))
            self.odometry.faults.lost(estimate.time, contradiction)

    def _save(self) -> None:
        """Store the pose, at once where the sphere begins to move."""
        estimate, wall = self.odometry.estimate, time.monotonic()
        if estimate is None or self._recalled is not None:
            return
        at_rest = not (estimate.body_rate.any() or self.odometry.faults.is_lost)
        if wall < self._saved_at + SAVE_EVERY and at_rest is self._was_at_rest:
            return
        self._saved_at, self._was_at_rest = wall, at_rest
        self._stored.save(KeptPose(estimate.pose, estimate.covariance, at_rest, self._angles))

    def finish(self) -> None:
        """Store the last pose."""
        self._saved_at = -math.inf
        self._save()
        self._stored.close()

    def _publish(self) -> None:
        """Publish the newest estimate, with the stamp of its reading, while it is known."""
        if self._recalled is not None:
            self._check_recalled(*self._recalled)
        estimate, radius = self.odometry.estimate, self._robot.shell_radius
        if estimate is None or self._epoch is None or self.odometry.faults.is_lost:
            self._sent = []
            return
        stamp, pose = stamp_of(estimate.time, self._epoch), estimate.pose
        height_deviation = self._settings.height_deviation(radius)

        def moving() -> tuple[Vector, Vector, tuple[Vector, Vector]]:
            of_pose = fixed_axes_covariance(pose, estimate.covariance, height_deviation)
            covariances = of_pose, estimate.twist_covariance
            return estimate.velocity, estimate.body_rate, covariances

        self._sent_stamp, self._reports.pose = stamp, pose
        self._sent = self._publisher.messages([(stamp, pose)], pose, stamp, moving)
        for publisher, message in self._sent:
            publisher.publish(message)

    def _set_pose(self, message: bytes) -> None:
        """Take a pose as that of now: the stamp of who gives it is that of another clock."""
        self._given = cdr.read(message, cdr.UncertainPose).in_frame(self._frame)
        self._stored.is_settled = True
        self._recalled = None
        estimate = self.odometry.estimate
        now = self._time(self._control_clock.stamp()) if estimate is None else estimate.time
        self.odometry.set_pose(now, *self._given)
        self._event_log.report("initialpose", f"at {self._given[0].round(3).tolist()}")
        self._publish_if_found()

    def _correct(self, message: bytes) -> None:
        given = cdr.read(message, cdr.UncertainPose)
        fix = given.in_frame(self._frame)
        if not given.stamp:
            raise InvalidInputError("stamp", 0, "the time at which the fix was measured")
        reason = self.odometry.correct(self._time(given.stamp), *fix)
        if reason is not None:
            self._fault_log.report(reason.name, reason.text)
        self._publish_if_found()

    def _publish_if_found(self) -> None:
        """Publish at once where no pose was published of the newest reading; store the next."""
        self._saved_at = -math.inf
        if not self._sent:
            self._publish()

    def _check(self) -> None:
        if self._epoch is not None:
            heard = self._reports.imu.heard_until(self._control_clock.stamp())
            self.odometry.check(self._time(heard))
        self._reports.update(self.odometry)
        self._save()
        self._event_log.flush()

    def _reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Serve a robot, or a simulator, that is at its start again."""
        for stream in (self._reports.imu, self._reports.joints):
            stream.begin_anew(self._control_clock.stamp())
        self._begin_anew()
        response.success, response.message = True, "begins anew at initial_state"
        self._event_log.report("reset", response.message)
        return response

    def _begin_anew(self) -> None:
        """Forget all, and begin at `initial_state` with a calibration."""
        self._stored.is_settled = True
        self._stored.save(None)
        self._recalled = self._given = self._epoch = None
        self._sent, self._sent_stamp = [], -1
        self._mounted = None if self._frames else ""
        self.odometry = Odometry(self._settings, self._imu, self._robot)

    def _clock_jumped(self, changed: bool) -> None:
        """Begin anew where simulated time does, else keep the pose."""
        clock = self._control_clock
        if clock.simulated and not changed:  # it jumps back only
            self._event_log.report("clock", "goes back; begins anew at initial_state")
            self._begin_anew()
            return
        self._event_log.report("clock", "shows another time; the pose stays, motion is lost")
        self.odometry.forget()
        self._epoch, self._sent, self._sent_stamp = None, [], -1


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; see `sphere_nmpc.ros.lifetime.run`."""
    return run(OdometryNode, args, __doc__ or "")
