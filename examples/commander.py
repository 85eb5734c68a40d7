# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""BasicNavigator of Nav2 commands the sphere: to poses, along a path, and a task is cancelled.

It needs nav2_simple_commander (``apt install ros-jazzy-nav2-simple-commander``), and a robot with
the navigator::

    ros2 launch sphere_nmpc sphere.launch.py navigator:=true
    python3 examples/commander.py
"""

import math
import sys

import rclpy
from geometry_msgs.msg import PoseStamped
from nav2_simple_commander.robot_navigator import BasicNavigator, TaskResult
from nav_msgs.msg import Path

FRAME = "world"
"""The `world_frame` of the nodes; it is "map" where they are started with world_frame:=map."""


def pose(x: float, y: float, yaw: float = 0.0) -> PoseStamped:
    """Return an upright pose: position [m] and angle about the vertical [rad]."""
    found = PoseStamped()
    found.header.frame_id = FRAME
    found.pose.position.x, found.pose.position.y = x, y
    found.pose.orientation.z, found.pose.orientation.w = math.sin(yaw / 2), math.cos(yaw / 2)
    return found


def finish(navigator: BasicNavigator, task: str, expected: TaskResult) -> bool:
    """Wait for the end of a task, print it, and return whether it is the expected one."""
    while not navigator.isTaskComplete():
        pass  # it waits for 0.1 s each time
    found = navigator.getResult()
    # Earlier versions of Nav2 have no message.
    reason = getattr(navigator.result_future.result().result, "error_msg", "")
    print(f"{task}: {found.name.lower()} {reason}".rstrip(), flush=True)
    return found is expected


def main() -> int:
    """Run the tasks; return 0 if each ended as it should."""
    rclpy.init()
    navigator = BasicNavigator()
    # The sphere has no map server and no AMCL: its pose is known from the start.
    navigator.waitUntilNav2Active(localizer="robot_localization")

    navigator.goToPose(pose(1.0, 0.5, math.pi / 2))
    longest = 0.0
    while not navigator.isTaskComplete():
        feedback = navigator.getFeedback()  # None until the controller has taken the goal
        if feedback is not None:
            longest = max(longest, feedback.distance_remaining)
    print(f"the way to the pose was {longest:.1f} m long", flush=True)
    as_expected = [finish(navigator, "pose", TaskResult.SUCCEEDED)]

    # The sphere stays at each of them for `waypoint_pause` of the navigator.
    navigator.followWaypoints([pose(1.0, -0.5), pose(0.0, -0.5), pose(0.0, 0.0)])
    as_expected.append(finish(navigator, "waypoints", TaskResult.SUCCEEDED))

    places = [(0.1 * number, 0.2 * math.sin(0.6 * number)) for number in range(11)]
    navigator.followPath(Path(poses=[pose(x, y) for x, y in places]))
    as_expected.append(finish(navigator, "path", TaskResult.SUCCEEDED))

    navigator.goToPose(pose(5.0, 0.0))
    while not navigator.isTaskComplete():
        feedback = navigator.getFeedback()
        if hasattr(feedback, "current_pose") and feedback.current_pose.pose.position.x > 1.5:
            navigator.cancelTask()  # ends when the sphere rests, on the path that was planned
            break
    as_expected.append(finish(navigator, "far pose", TaskResult.CANCELED))

    navigator.destroy_node()
    rclpy.try_shutdown()
    return 0 if all(as_expected) else 1


if __name__ == "__main__":
    sys.exit(main())
