# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Settings of the recorder, its default topics, and topic patterns.

``goal_pose``, ``goal_point``, ``goals`` and ``path`` are not recorded by default: ``ros2 topic pub
--once`` publishes to its first matched subscription and ends, so that with a recorder among the
subscribers the goal may never reach the controller. Accepted goals are on
``controller/active_goal``, paths on ``controller/path``, refused ones in ``/rosout``. For the same
reason pushes are recorded from ``simulator/pushed``, ``map`` and ``keepout`` as they are put
together on ``controller/floor``, and ``initialpose`` is not recorded. Nor is ``imu``, which a
simulator reads only for a subscriber.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase

from sphere_nmpc.quantities import quantity, validate

DEFAULT_TOPICS = (
    "pose",
    "odom",
    "ground_truth/*",
    "joint_states",
    "pose_fix",
    "odometry/*",
    "rotor_trajectory",
    "rotor_commands",
    "controller/*",
    "simulator/pushed",
    "robot_description",
    "/clock",
    "/diagnostics",
    "/parameter_events",
    "/rosout",
    "/tf",
    "/tf_static",
)
"""Names and patterns; those without a leading slash are in the namespace of the recorder."""

KNOWN_TYPES = {
    "pose": "geometry_msgs/msg/PoseStamped",
    "odom": "nav_msgs/msg/Odometry",
    "ground_truth/pose": "geometry_msgs/msg/PoseStamped",
    "ground_truth/odom": "nav_msgs/msg/Odometry",
    "joint_states": "sensor_msgs/msg/JointState",
    "pose_fix": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "odometry/status": "diagnostic_msgs/msg/DiagnosticStatus",
    "rotor_trajectory": "trajectory_msgs/msg/JointTrajectory",
    "rotor_commands": "std_msgs/msg/Float64MultiArray",
    "controller/active_goal": "geometry_msgs/msg/PoseStamped",
    "controller/status": "diagnostic_msgs/msg/DiagnosticStatus",
    "controller/floor": "nav_msgs/msg/OccupancyGrid",
    "controller/path": "nav_msgs/msg/Path",
    "simulator/pushed": "geometry_msgs/msg/Vector3Stamped",
    "robot_description": "std_msgs/msg/String",
    "/clock": "rosgraph_msgs/msg/Clock",
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
}
"""Types of topics that are subscribed to before they have a publisher, so that their first
messages are not missed; messages of another type on these topics are of another sender."""

LATCHED = (
    "controller/active_goal", "controller/floor", "controller/path", "robot_description",
)
"""Topics among these whose publisher keeps the last message for late subscribers."""


@dataclass(frozen=True)
class RecorderSettings:
    """Folder, topics, start and commit period of recordings."""

    output: str = quantity(
        "", "-", "Folder of the bag, which must not exist; runs/<date and time> if empty"
    )
    topics: tuple[str, ...] = quantity(
        DEFAULT_TOPICS, "-", "Topics to record; * stands for anything, names without a leading "
        "slash are in the node's namespace",
    )
    record_on_start: bool = quantity(
        True, "-", "Whether to record from the start, or to wait for the start service"
    )
    commit_period: float = quantity(
        0.5, "s", "Wall time after which received messages are on disk in a readable bag",
        minimum=0.05, maximum=60.0,
    )

    def __post_init__(self) -> None:
        validate(self)


def absolute(name: str, namespace: str) -> str:
    """Return the full name of a topic or pattern for a node in `namespace`."""
    return name if name.startswith("/") else f"{namespace.rstrip('/')}/{name}"


def matches_any(topic: str, patterns: Sequence[str]) -> bool:
    """Return whether a topic matches a pattern, in full names; ``*`` matches anything."""
    return any(fnmatchcase(topic, pattern) for pattern in patterns)
