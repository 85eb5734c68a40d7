# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The calls of BasicNavigator that examples use, for where nav2_simple_commander is not installed.

A test copies this file to where ``nav2_simple_commander.robot_navigator`` is looked for.
"""

from enum import Enum
from typing import Any

import rclpy
from action_msgs.msg import GoalStatus
from lifecycle_msgs.srv import GetState
from nav2_msgs.action import FollowPath, FollowWaypoints, NavigateToPose
from rclpy.action import ActionClient
from rclpy.node import Node


class TaskResult(Enum):
    """End of a task; numbers as in nav2_simple_commander."""

    UNKNOWN = 0
    SUCCEEDED = 1
    CANCELED = 2
    FAILED = 3


_RESULTS = {
    GoalStatus.STATUS_SUCCEEDED: TaskResult.SUCCEEDED,
    GoalStatus.STATUS_CANCELED: TaskResult.CANCELED,
    GoalStatus.STATUS_ABORTED: TaskResult.FAILED,
}


class BasicNavigator(Node):
    """Client of the actions, with one task at a time."""

    def __init__(self) -> None:
        super().__init__("basic_navigator")
        self._pose_client = ActionClient(self, NavigateToPose, "navigate_to_pose")
        self._waypoint_client = ActionClient(self, FollowWaypoints, "follow_waypoints")
        self._path_client = ActionClient(self, FollowPath, "follow_path")
        self._handle: Any = None
        self._feedback: Any = None
        self.result_future: Any = None

    def waitUntilNav2Active(
        self, navigator: str = "bt_navigator", localizer: str = "amcl"
    ) -> None:
        assert localizer == "robot_localization"
        client = self.create_client(GetState, f"{navigator}/get_state")
        client.wait_for_service()
        label = ""
        while label != "active":
            label = self._done(client.call_async(GetState.Request())).current_state.label

    def goToPose(self, pose: Any) -> bool:
        return self._begin(self._pose_client, NavigateToPose.Goal(pose=pose))

    def followWaypoints(self, poses: Any) -> bool:
        return self._begin(self._waypoint_client, FollowWaypoints.Goal(poses=poses))

    def followPath(self, path: Any, controller_id: str = "", goal_checker_id: str = "") -> bool:
        return self._begin(self._path_client, FollowPath.Goal(
            path=path, controller_id=controller_id, goal_checker_id=goal_checker_id
        ))

    def cancelTask(self) -> None:
        self._done(self._handle.cancel_goal_async())

    def isTaskComplete(self) -> bool:
        rclpy.spin_until_future_complete(self, self.result_future, timeout_sec=0.1)
        return bool(self.result_future.done())

    def getFeedback(self) -> Any:
        return self._feedback

    def getResult(self) -> TaskResult:
        return _RESULTS.get(self.result_future.result().status, TaskResult.UNKNOWN)

    def _begin(self, client: ActionClient, goal: Any) -> bool:
        client.wait_for_server()
        self._handle = self._done(client.send_goal_async(goal, self._take))
        if self._handle.accepted:
            self.result_future = self._handle.get_result_async()
        return bool(self._handle.accepted)

    def _take(self, message: Any) -> None:
        self._feedback = message.feedback

    def _done(self, future: Any) -> Any:
        rclpy.spin_until_future_complete(self, future)
        return future.result()

