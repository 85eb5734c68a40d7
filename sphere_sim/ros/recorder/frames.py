# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Transforms of a robot's frames, made of its poses, its description and its joint states."""

import struct
from collections.abc import Iterable, Mapping

from sphere_nmpc.errors import SphereNmpcError
from sphere_nmpc.estimation.mounting import Joint, RobotFrames
from sphere_nmpc.model import rotation
from sphere_nmpc.ros.cdr import BODY_FRAME, Joints, Pose, Text, read
from sphere_nmpc.ros.cdr_messages import transforms_message

TRANSFORMS = "tf2_msgs/msg/TFMessage"
MOVING, STATIC = "/tf", "/tf_static"
SOURCES = ("pose", "robot_description", "joint_states")
"""Topics of which transforms are made."""
Entry = tuple[int, str, bytes]
"""Time of arrival [ns], topic, and message in CDR."""


class Frames:
    """Transforms as a robot and robot_state_publisher publish them; `prefix` is of its frames."""

    def __init__(self, prefix: str) -> None:
        self._prefix = prefix
        self._joints: dict[str, Joint] = {}

    def transforms(self, messages: Iterable[Entry], named: Mapping[str, str]) -> list[Entry]:
        """Return the transforms that messages give, those of fixed joints for `STATIC`.

        `named` has the topics of the robot by their names before any remapping.
        """
        found, sources = [], {named[name]: name for name in SOURCES if name in named}
        for arrival, topic, message in messages:
            source = sources.get(topic)
            try:
                made = self._transforms(source, message) if source else b""
            except (SphereNmpcError, struct.error):
                continue  # the message is recorded all the same
            if made:
                found.append((arrival, STATIC if source == SOURCES[1] else MOVING, made))
        return found

    def _transforms(self, source: str, message: bytes) -> bytes:
        if source == "pose":
            stamp, frame, numbers = read(message, Pose)
            return transforms_message(stamp, [(frame, self._prefix + BODY_FRAME, numbers)])
        if source == "robot_description":
            self._joints = RobotFrames(read(message, Text).text).joints
            fixed = [it.name for it in self._joints.values() if not it.axis.any()]
            return self._of_joints(0, dict.fromkeys(fixed, 0.0))
        joints = read(message, Joints)
        return self._of_joints(joints.stamp, dict(zip(joints.names, joints.angles, strict=False)))

    def _of_joints(self, stamp: int, angles: Mapping[str, float]) -> bytes:
        """Return the transforms of joints that have these angles [rad]."""
        found = []
        for child, joint in self._joints.items():
            if joint.name in angles:
                own = rotation.exponential(angles[joint.name] * joint.axis)
                w, *xyz = rotation.product(joint.turn, own).tolist()
                frames = self._prefix + joint.parent, self._prefix + child
                found.append((*frames, (*joint.place.tolist(), *xyz, w)))
        return transforms_message(stamp, found) if found else b""
