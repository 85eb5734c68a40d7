# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Topics of the robot of a bag by their roles: message types, and what the run says of itself.

Names alone do not identify a topic: poses are remapped to the topic of a capture system, commands
to that of the drives. What identifies it, in this order: the recorder's and the controller's own
words, the name before any remapping, and the messages: joints named as the rotors, and poses of a
sphere that rolls.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from sphere_nmpc.model import rotation
from sphere_nmpc.model.state import POSITION, QUATERNION, are_states
from sphere_nmpc.ros.cdr import (
    JOINT_NAMES,
    TYPES,
    Diagnostics,
    Joints,
    OccupancyGrid,
    Pose,
    Status,
    Trajectory,
    Vector3,
)
from sphere_sim.recording.bag_files import (
    TOPICS_PREFIX,
    BagError,
    full_topic_name,
    last_part,
    object_of,
)
from sphere_sim.recording.message_fields import POSE_TOPIC, TRUE_POSE
from sphere_sim.recording.messages import Messages

_POSE, _JOINTS, _PLANS = TYPES[Pose], TYPES[Joints], TYPES[Trajectory]
_NAMED = {
    "status": TYPES[Status], "pushed": TYPES[Vector3], "floor": TYPES[OccupancyGrid],
    "diagnostics": TYPES[Diagnostics],
}
"""Types of the topics whose names are those of nodes of this package."""
_GOALS = ("/goal_pose", "/active_goal")
_FEWEST = 20
"""Poses of a topic that can be those of a robot: a second of them at the lowest rate that the
controller expects. Goals are fewer."""


@dataclass(frozen=True)
class Robot:
    """Topics of one robot of a bag, by their full names.

    `namespace` has no slash at its end, and `controller` is the full name of its node. The run is
    judged on `pose`; where these poses are the true ones of a simulator, `estimate` has those that
    the controller used, and is empty otherwise.
    """

    namespace: str
    controller: str
    pose: str
    estimate: str
    joint_states: str
    rotor_trajectory: str


def is_read(topic: str, msgtype: str) -> bool:
    """Return whether a run may have messages of this topic and type."""
    return msgtype in (_POSE, _JOINTS, _PLANS) or _NAMED.get(last_part(topic)) == msgtype


def find_robot(messages: Messages, namespace: str | None, pose_topic: str | None) -> Robot:
    """Return the robot in a namespace, or the only one of the bag.

    `pose_topic` names the topic of its poses where that cannot be found out. `BagError` is raised,
    with what could be chosen, where there is no such robot or topic, or there are several.
    """
    found = _Bag(messages)
    pose_topic = None if pose_topic is None else full_topic_name(pose_topic)
    robot = found.select(namespace, pose_topic)
    nodes = found.controllers(robot)
    stated = found.stated(robot, nodes)
    pose, estimate = found.judged(robot, stated) if pose_topic is None else (pose_topic, "")
    return Robot(
        robot, nodes[0] if nodes else f"{robot}/controller", pose, estimate,
        found.of_rotors(robot, "joint_states", _JOINTS, stated),
        found.of_rotors(robot, "rotor_trajectory", _PLANS, stated),
    )


class _Bag:
    """Robots of a bag, and the topics that can have a role."""

    def __init__(self, messages: Messages) -> None:
        self._messages = messages
        self._candidates = self._of_type(_POSE, lambda topic: not topic.endswith(_GOALS))
        rotors = [*self._of_type(_JOINTS, self._has_rotors),
                  *self._of_type(_PLANS, self._has_rotors)]
        with_pose = {_space(topic) for topic in self._candidates if last_part(topic) == "pose"}
        with_rotors = {_space(topic) for topic in rotors
                       if last_part(topic) in ("joint_states", "rotor_trajectory")}
        controlled = {_space(node) for node in self._nodes()}
        self._robots = sorted(
            controlled | (with_pose & with_rotors) or with_rotors or with_pose
        )
        self._possible = {*self._robots, *with_pose, *with_rotors}

    def select(self, given: str | None, pose_topic: str | None) -> str:
        """Return the namespace of the robot that is given, by itself or by its poses."""
        robots, names = self._robots, ", ".join(name or "/" for name in self._robots)
        if pose_topic is not None and pose_topic not in self._candidates:
            raise self._error(f"{pose_topic}: expected a topic of type {_POSE}")
        if given is not None:
            robot = full_topic_name(given).rstrip("/")
            if robot in self._possible or (pose_topic is not None and not robots):
                return robot
            raise self._error(f"no robot in namespace '{given}'; it has: {names or 'none'}")
        if len(robots) > 1 and pose_topic is not None:
            # Poses in the namespace of one of them are its own.
            robots = [it for it in robots if it == _space(pose_topic)] or robots
        if len(robots) > 1:
            raise self._error(f"holds several robots, choose one by its namespace: {names}")
        if robots or pose_topic is not None:
            return robots[0] if robots else ""
        raise self._without_poses("")

    def controllers(self, robot: str) -> list[str]:
        """Return the full names of the controllers of a robot."""
        return [node for node in self._nodes() if _space(node) == robot]

    def stated(self, robot: str, nodes: Sequence[str]) -> dict[str, str]:
        """Return topics that the run itself states, by their names before any remapping."""
        found = object_of(self._messages.custom_data.get(f"{TOPICS_PREFIX}{robot or '/'}", ""))
        for node in nodes:
            for _, message in self._messages.decoded.get(f"{node}/status", ())[:1]:
                if POSE_TOPIC in message.values:
                    found["pose"] = message.values[POSE_TOPIC]
        return {name: full_topic_name(str(topic)) for name, topic in found.items()}

    def judged(self, robot: str, stated: dict[str, str]) -> tuple[str, str]:
        """Return the topic of the poses to judge a robot on, and that of estimates of them."""
        truth = self._recorded(robot, TRUE_POSE, stated)
        if not truth:
            return self.poses(robot, stated), ""
        estimate = self._recorded(robot, "pose", stated) or f"{robot}/pose"
        self._messages.notes.append(
            f"{truth} has the true poses, on which the run is judged; {estimate} has estimates"
        )
        return truth, estimate

    def poses(self, robot: str, stated: dict[str, str]) -> str:
        """Return the topic with the poses of a robot."""
        if topic := self._recorded(robot, "pose", stated):
            return topic
        own, decoded = f"{robot}/pose", self._messages.decoded
        found = [topic for topic in self._free(robot, self._candidates)
                 if len(decoded.get(topic, ())) >= _FEWEST and self._is_in_frame(robot, topic)]
        if len(found) > 1:
            found = [topic for topic in found if self._rolls(topic)] or found
        if len(found) == 1:
            return self._told(own, found[0])
        if found:
            raise self._error(
                f"several topics may have the poses of the robot in namespace {robot or '/'}, "
                f"choose one with --pose-topic: {', '.join(found)}"
            )
        if own in self._candidates:
            return own  # which is empty
        raise self._without_poses(robot)

    def _recorded(self, robot: str, name: str, stated: dict[str, str]) -> str:
        """Return the topic of poses with a name before remapping; empty without messages."""
        own = f"{robot}/{name}"
        return next((topic for topic in (stated.get(name, own), own)
                     if topic in self._candidates and topic in self._messages.decoded), "")

    def of_rotors(self, robot: str, name: str, msgtype: str, stated: dict[str, str]) -> str:
        """Return the topic of a name and type whose joints are the rotors of a robot."""
        own = f"{robot}/{name}"
        found = self._of_type(msgtype, self._has_rotors)
        for topic in (stated.get(name, own), own):
            if topic in found:
                return topic
        found = self._free(robot, found)
        return self._told(own, found[0]) if len(found) == 1 else own

    def _told(self, own: str, topic: str) -> str:
        self._messages.notes.append(f"{own} is missing; that of this robot is {topic}")
        return topic

    def _nodes(self) -> list[str]:
        """Return the full names of the controllers of the bag."""
        goals = self._of_type(_POSE, lambda topic: topic.endswith("/active_goal"))
        reports = self._of_type(_NAMED["status"], lambda topic: any(
            "time_s" in message.values for _, message in self._messages.decoded.get(topic, ())[:1]
        ))
        return sorted({_space(topic) for topic in (*goals, *reports)} - {""})

    def _of_type(self, msgtype: str, fits: Callable[[str], bool]) -> list[str]:
        return sorted(topic for topic, kind in self._messages.types.items()
                      if kind == msgtype and fits(topic))

    def _has_rotors(self, topic: str) -> bool:
        """Return whether messages name the rotors; others may share the topic."""
        return any(set(JOINT_NAMES) <= set(it.names)
                   for _, it in self._messages.decoded.get(topic, ()))

    def _free(self, robot: str, topics: Iterable[str]) -> list[str]:
        """Return the topics that are not in the namespace of another robot."""
        others = {*self._robots} - {robot}
        return [topic for topic in topics if _space(topic) not in others]

    def _is_in_frame(self, robot: str, topic: str) -> bool:
        """Return whether the controller would accept the poses: those in the frame of goals."""
        decoded = self._messages.decoded
        frames = {message.frame for node in self.controllers(robot)
                  for _, message in decoded.get(f"{node}/active_goal", ())}
        return not frames or decoded[topic][0][1].frame in {"", *frames}

    def _rolls(self, topic: str) -> bool:
        """Return whether poses move as a sphere that rolls does, whatever its radius."""
        states = np.array([message.state for _, message in self._messages.decoded[topic]])
        states = states[are_states(states)]
        quaternions = states[:, QUATERNION]
        real, about_x, about_y, _ = rotation.products(
            quaternions[1:].T, rotation.conjugate(quaternions[:-1]).T
        )
        steps = np.diff(states[:, POSITION], axis=0)
        rolled = np.sign(real)[:, None] * np.column_stack((about_y, -about_x))
        common = float(np.sum(steps * rolled))
        # More than half of the motion is explained: a correlation.
        return common > 0.0 and common**2 > 0.5 * float(np.sum(steps**2) * np.sum(rolled**2))

    def _without_poses(self, robot: str) -> BagError:
        messages = self._messages
        missing = f"no topic 'pose' of type {_POSE}"
        if messages.truncated:
            return self._error(messages.incomplete(missing))
        if not messages.types:
            return self._error("is empty: it has no topic at all")
        # Types of equal names differ by their packages.
        others = ", ".join(
            f"{topic} ({kind if last_part(kind) == last_part(_POSE) else last_part(kind)})"
            for topic, kind in sorted(messages.types.items())
        )
        why = f"; it has {messages.unread}" if messages.unread else ", so a bag of another robot"
        return self._error(f"{missing} in namespace {robot or '/'}{why}; has: {others}")

    def _error(self, reason: str) -> BagError:
        if self._candidates and "--pose-topic" not in reason:
            reason += f"; --pose-topic takes one of {', '.join(self._candidates)}"
        return BagError(self._messages.path, reason)


def _space(topic: str) -> str:
    """Return what is before the last part of a full name, or before `TRUE_POSE`."""
    own = topic.removesuffix(f"/{TRUE_POSE}")
    return topic.rpartition("/")[0] if own == topic else own
