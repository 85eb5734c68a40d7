# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Client of the actions of the navigator, which checks that each goal has one end."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from action_msgs.msg import GoalStatus, GoalStatusArray
from geometry_msgs.msg import PoseStamped
from rclpy.action import ActionClient
from rclpy.node import Node
from rclpy.qos import qos_profile_action_status_default

from sphere_nmpc.model.state import upright_state
from sphere_nmpc.ros.messages import pose_to_ros

ENDS = {
    GoalStatus.STATUS_SUCCEEDED: "succeeded", GoalStatus.STATUS_CANCELED: "canceled",
    GoalStatus.STATUS_ABORTED: "aborted",
}
_AGAIN = 10.0
"""Time without an answer after which a goal is sent again [s]."""
RADIUS = 0.3
"""Height of goals [m], which nobody uses."""


def pose(x: float, y: float, yaw: float = 0.0) -> PoseStamped:
    """Return an upright pose without a frame."""
    return pose_to_ros(upright_state(x, y, yaw), 0, RADIUS, frame="")


def drawn(rng: np.random.Generator, reach: float = 1.5) -> PoseStamped:
    """Return a random upright pose within |x|, |y| < `reach` [m]."""
    x, y = rng.uniform(-reach, reach, 2)
    return pose(x, y, rng.uniform(-np.pi, np.pi))


@dataclass
class Sent:
    """A goal that was sent; `answer` is whether it was accepted, None before."""

    answer: Any = None
    result: Any = None
    feedback: list[Any] = field(default_factory=list)

    @property
    def is_accepted(self) -> bool:
        return bool(self.answer.result().accepted)

    @property
    def handle(self) -> Any:
        return self.answer.result()

    @property
    def end(self) -> str:
        """The end by the result; empty before."""
        done = self.result is not None and self.result.done()
        return ENDS[self.result.result().status] if done else ""

    @property
    def reason(self) -> str:
        return str(self.result.result().result.error_msg)


class NavigationClient:
    """Clients of the actions, on a node that `until` serves until a condition holds."""

    def __init__(self, node: Node, until: Callable[[Callable[[], object]], object]) -> None:
        from sphere_nmpc.ros.navigator.requests import action_types

        self._node, self._until = node, until
        self.kinds = action_types()
        self._clients = {name: ActionClient(node, kind, name) for name, kind in self.kinds.items()}
        self.ends: dict[bytes, list[int]] = {}
        """Terminal statuses of each goal, without repetitions, as they were published."""
        for name in self.kinds:
            node.create_subscription(
                GoalStatusArray, f"{name}/_action/status", self._note,
                qos_profile_action_status_default,
            )

    def wait_for_navigator(self) -> None:
        """Wait until all actions are offered."""
        for client in self._clients.values():
            self._until(client.server_is_ready)

    def navigators(self) -> set[bytes]:
        """Return ids of the navigators that are known; one that was killed is so for a while."""
        found = self._node.get_publishers_info_by_topic("navigate_to_pose/_action/status")
        return {bytes(one.endpoint_gid) for one in found}

    def send(self, *poses: PoseStamped, tree: str = "", name: str = "") -> Sent:
        """Send one goal, or several in order, and wait for the answer.

        `name` is that of the action, by default one of the first two.

        It is sent again where none comes: a client that knows a navigator which was killed does
        not wait until it is matched with the next one, whose answer is then lost.
        """
        default = "navigate_to_pose" if len(poses) == 1 else "navigate_through_poses"
        goal = self.kinds[name := name or default].Goal()
        if tree:
            goal.behavior_tree = tree
        if name == "navigate_to_pose":
            goal.pose = poses[0]
        elif hasattr(goal.poses, "goals"):  # newer versions
            goal.poses.goals = list(poses)
        else:
            goal.poses = list(poses)
        sent, due = Sent(), 0.0

        def is_answered() -> bool:
            nonlocal sent, due
            if (sent.answer is None or not sent.answer.done()) and time.monotonic() > due:
                sent, due = Sent(), time.monotonic() + _AGAIN
                sent.answer = self._clients[name].send_goal_async(goal, sent.feedback.append)
            return bool(sent.answer.done())

        self._until(is_answered)
        if sent.is_accepted:
            sent.result = sent.handle.get_result_async()
        return sent

    def cancel(self, sent: Sent) -> bool:
        """Cancel a goal; return whether the navigator will."""
        answer = sent.handle.cancel_goal_async()
        self._until(answer.done)
        return len(answer.result().goals_canceling) == 1

    def wait(self, *goals: Sent) -> Sequence[str]:
        """Wait for the ends of goals, and return them; each must have been published once."""
        self._until(lambda: all(sent.end for sent in goals))
        keys = [bytes(sent.handle.goal_id.uuid) for sent in goals]
        self._until(lambda: all(key in self.ends for key in keys))
        for key, sent in zip(keys, goals, strict=True):
            assert [ENDS[status] for status in self.ends[key]] == [sent.end]
        return [sent.end for sent in goals]

    def _note(self, message: GoalStatusArray) -> None:
        for status in message.status_list:
            key = bytes(status.goal_info.goal_id.uuid)
            if key in self.ends and status.status != self.ends[key][-1]:
                self.ends[key].append(status.status)
            elif key not in self.ends and status.status in ENDS:
                self.ends[key] = [status.status]
