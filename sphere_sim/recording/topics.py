# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""What is recorded unless somebody says otherwise, and which topics a pattern means.

``goal_pose`` is not among it: ``ros2 topic pub --once`` sends at its first matched subscription,
and with a recorder among the subscribers the goal may never reach the controller. Accepted
goals are on ``controller/active_goal``, refused ones in ``/rosout``.
"""

from collections.abc import Sequence
from fnmatch import fnmatchcase

DEFAULT_TOPICS = (
    "pose",
    "odom",
    "joint_states",
    "rotor_trajectory",
    "rotor_commands",
    "controller/*",
    "simulator/*",
    "/clock",
    "/diagnostics",
    "/parameter_events",
    "/rosout",
    "/tf",
    "/tf_static",
)
"""Names and patterns; those without a slash in front are in the namespace of the recorder."""

KNOWN_TYPES = {
    "pose": "geometry_msgs/msg/PoseStamped",
    "odom": "nav_msgs/msg/Odometry",
    "joint_states": "sensor_msgs/msg/JointState",
    "rotor_trajectory": "trajectory_msgs/msg/JointTrajectory",
    "rotor_commands": "std_msgs/msg/Float64MultiArray",
    "controller/active_goal": "geometry_msgs/msg/PoseStamped",
    "/clock": "rosgraph_msgs/msg/Clock",
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
}
"""Types of the topics that are awaited before anybody publishes them, so that the first messages
are not missed."""

LATCHED = ("controller/active_goal",)
"""Those of them whose publisher keeps the last message for late subscribers."""


def absolute(name: str, namespace: str) -> str:
    """Return a topic or pattern with its full name, as a node in `namespace` would see it."""
    return name if name.startswith("/") else f"{namespace.rstrip('/')}/{name}"


def is_wanted(topic: str, patterns: Sequence[str]) -> bool:
    """Tell whether a full topic name matches one of the full patterns; ``*`` matches anything."""
    return any(fnmatchcase(topic, pattern) for pattern in patterns)
