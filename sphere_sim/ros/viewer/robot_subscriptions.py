# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Subscriptions to the topics of one robot, for what is drawn of it."""

import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import OccupancyGrid, Path
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState

from sphere_nmpc.errors import InvalidStateError
from sphere_nmpc.floor.occupancy import InvalidMapError
from sphere_nmpc.model.state import Vector
from sphere_nmpc.quantities import stamp_text
from sphere_nmpc.ros import cdr
from sphere_nmpc.ros.floor_messages import floor_of
from sphere_nmpc.ros.graph_monitor import publishers_of
from sphere_nmpc.ros.messages import framed_places_from_ros, pose_from_ros
from sphere_sim.recording.message_fields import TRUE_POSE
from sphere_sim.viewer.live_frame import LiveFrame
from sphere_sim.viewer.source import Frame

_LONGEST_PLAN = 400
"""Poses of a plan that are converted."""
_STATUS = "controller/status"


class RobotSubscriptions:
    """Subscriptions that keep the newest frame of a robot.

    They are best effort with a depth of 1, and a small one for true poses: messages that arrive
    between two frames cost nothing, and no publisher waits for the viewer.

    With `scene_only` pose, goal and plan are enough: no floor, no rotor speeds and nothing about
    the controller. `on_pose` is called after each pose that was accepted in the given frame.
    """

    def __init__(
        self, node: Node, frame: str, scene_only: bool = False,
        on_pose: Callable[[], object] = lambda: None,
    ) -> None:
        self.message_count = 0
        """Number of messages received."""
        self.live = LiveFrame(time.monotonic())
        """Frame that the messages update."""
        self._node, self._frame, self._on_pose = node, frame, on_pose
        self._diagnostics_prefix = f"{node.get_namespace()}/controller:".lstrip("/")
        newest = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        # An estimate arrives later than the true pose of its time.
        several = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)

        def subscribe(
            kind: type, topic: str, take: Callable[[Any], None], qos: QoSProfile | int,
            raw: bool = True,
        ) -> None:
            def received(message: Any) -> None:
                self.message_count += 1
                take(message)

            node.create_subscription(kind, topic, received, qos, raw=raw)

        pose, truth = (partial(self._take_pose, take)
                       for take in (self.live.add_pose, self.live.add_true_pose))
        subscribe(PoseStamped, "pose", pose, newest)
        subscribe(PoseStamped, TRUE_POSE, truth, several)
        subscribe(PoseStamped, "controller/active_goal", self._take_goal, latched)
        subscribe(Path, "controller/predicted_path", self._take_plan, newest, raw=False)
        if scene_only:
            return
        subscribe(Path, "controller/path", self._take_path, latched, raw=False)
        subscribe(OccupancyGrid, "controller/floor", self._take_floor, latched)
        subscribe(JointState, "joint_states", self._take_joint_states, newest)
        subscribe(DiagnosticStatus, _STATUS, self._take_status, newest)
        subscribe(DiagnosticArray, "/diagnostics", self._take_diagnostics, 10)

    def newest(self) -> Frame:
        """Return the newest frame."""
        controllers = publishers_of(self._node, _STATUS, DiagnosticStatus)
        return self.live.take(time.monotonic(), len(controllers))

    def _take_pose(self, take: Callable[[float, Vector, float, float], None], raw: bytes) -> None:
        now = time.monotonic()
        pose = cdr.read(raw, cdr.Pose)
        try:
            state = pose.in_frame(self._frame)
        except InvalidStateError as error:
            self.live.refused = str(error)
            return
        take(cdr.seconds(pose.stamp), state, pose.numbers[2], now)
        self._on_pose()

    def _take_joint_states(self, raw: bytes) -> None:
        rotors = cdr.read(raw, cdr.Joints).of_rotors()
        if rotors is not None:  # others have other joints
            self.live.add_rotors(*rotors[1:])

    def _take_goal(self, raw: bytes) -> None:
        goal = cdr.read(raw, cdr.Pose)
        with suppress(InvalidStateError):
            self.live.add_goal(stamp_text(goal.stamp), goal.in_frame(goal.frame))

    def _take_plan(self, message: Path) -> None:
        self.live.controller_at = time.monotonic()
        with suppress(InvalidStateError):
            states = [pose_from_ros(pose) for pose in message.poses[:_LONGEST_PLAN]]
            self.live.update(plan=np.array(states).reshape(-1, 6))

    def _take_path(self, message: Path) -> None:
        with suppress(InvalidStateError):
            frame, is_none = message.header.frame_id, not message.poses
            places = np.empty((0, 2)) if is_none else framed_places_from_ros(message, frame)
            self.live.update(path=places)

    def _take_floor(self, raw: bytes) -> None:
        self.live.floor_refused = ""
        try:
            self.live.update(floor=floor_of(cdr.read(raw, cdr.OccupancyGrid)))
        except InvalidMapError as error:
            self.live.floor_refused = str(error)

    def _take_status(self, raw: bytes) -> None:
        self.live.controller_at = time.monotonic()
        self.live.add_status(cdr.read(raw, cdr.Status).values)

    def _take_diagnostics(self, raw: bytes) -> None:
        statuses = cdr.read(raw, cdr.Diagnostics).statuses
        if any(status.name.startswith(self._diagnostics_prefix) for status in statuses):
            self.live.controller_at = time.monotonic()
