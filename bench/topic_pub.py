# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Send a goal as ``ros2 topic pub`` does, where that command is not installed.

    python bench/topic_pub.py X TIMES [KEEP_ALIVE]

With ``--once`` (TIMES 1) that command checks every 0.1 s for its first matched subscription,
sends, and ends 0.1 s later; with ``-t 3`` it sends three times, one second apart. This one ends
when the matched subscriptions have confirmed the goal, at the latest after KEEP_ALIVE [s].
"""

import sys
import time

import rclpy
from geometry_msgs.msg import PoseStamped
from rclpy.duration import Duration


def main(x: float, times: int, keep_alive: float = 0.1) -> None:
    """Send the goal, upright at x [m] on the x axis."""
    rclpy.init()
    node = rclpy.create_node("sender")
    publisher = node.create_publisher(PoseStamped, "/goal_pose", 10)
    while publisher.get_subscription_count() < 1:
        time.sleep(0.1)
    message = PoseStamped()
    message.header.frame_id, message.pose.orientation.w = "world", 1.0
    message.pose.position.x = x
    for number in range(times):
        time.sleep(1.0 if number else 0.0)
        publisher.publish(message)
    publisher.wait_for_all_acked(Duration(seconds=keep_alive))
    node.destroy_node()
    rclpy.shutdown()


if __name__ == "__main__":
    main(float(sys.argv[1]), int(sys.argv[2]), *map(float, sys.argv[3:]))
