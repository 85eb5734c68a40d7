# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Simulator and controller, with a recording, RViz and the viewer where they are asked for.

ros2 launch sphere_nmpc sphere.launch.py record:=true viewer:=true rviz:=true namespace:=second
"""

from datetime import datetime
from pathlib import Path

from ament_index_python.packages import (
    PackageNotFoundError,
    get_package_prefix,
    get_package_share_directory,
)
from launch.actions import DeclareLaunchArgument, ExecuteProcess, LogInfo, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from launch import LaunchContext, LaunchDescription

PACKAGE = "sphere_nmpc"
RECORDED = (
    "pose", "odom", "joint_states", "goal_pose", "rotor_trajectory", "rotor_commands",
    "controller/active_goal", "controller/predicted_path", "controller/status",
)
ABSOLUTE = ("/clock", "/diagnostics", "/rosout", "/parameter_events")


def generate_launch_description() -> LaunchDescription:
    config = str(Path(get_package_share_directory(PACKAGE), "config", "sphere.yaml"))
    return LaunchDescription(
        [
            DeclareLaunchArgument("namespace", default_value="", description="Of all topics"),
            DeclareLaunchArgument(
                "params_file", default_value=config, description="Parameters of both nodes"
            ),
            DeclareLaunchArgument(
                "use_sim_time", default_value="true",
                description="Whether all nodes but the simulator follow its /clock",
            ),
            DeclareLaunchArgument("record", default_value="false", description="Write a bag"),
            DeclareLaunchArgument("rviz", default_value="false", description="Start RViz"),
            DeclareLaunchArgument(
                "viewer", default_value="false", description="Serve the page of the viewer"
            ),
            OpaqueFunction(function=actions),
        ]
    )


def actions(context: LaunchContext) -> list:
    """Return what to start; what is not installed is told and left out."""
    value = {
        name: LaunchConfiguration(name).perform(context)
        for name in ("namespace", "params_file", "use_sim_time", "record", "rviz", "viewer")
    }
    namespace, params = value["namespace"], value["params_file"]
    clock = {"use_sim_time": is_true(value["use_sim_time"])}
    common = {"namespace": namespace, "output": "screen"}
    started = [
        # The simulator makes the clock: it must not wait for it.
        Node(package=PACKAGE, executable="simulator", parameters=[params], **common),
        Node(package=PACKAGE, executable="controller", parameters=[params, clock], **common),
    ]
    share = Path(get_package_share_directory(PACKAGE))
    urdf = share / "urdf" / "sphere.urdf"
    if is_installed("robot_state_publisher") and urdf.exists():
        # Without a type launch takes the text for YAML, which the colon of a comment breaks.
        text = ParameterValue(urdf.read_text(encoding="utf-8"), value_type=str)
        description = {"robot_description": text}
        started.append(
            Node(
                package="robot_state_publisher", executable="robot_state_publisher",
                parameters=[description, clock], **common,
            )
        )
    if is_true(value["record"]):
        started.append(recording(namespace, clock))
    if is_true(value["viewer"]):
        started.append(Node(package=PACKAGE, executable="viewer", **common))
    if is_true(value["rviz"]):
        started.append(Node(package=PACKAGE, executable="markers", **common))
        started.append(rviz(share / "rviz" / "sphere.rviz", clock, namespace))
    return started


def recording(namespace: str, clock: dict[str, bool]) -> ExecuteProcess:
    """Return rosbag2's recorder, else the package's own; both write the same format."""
    if not (is_installed("ros2bag") and is_installed("rosbag2_storage_mcap")):
        return Node(
            package=PACKAGE, executable="recorder", namespace=namespace, parameters=[clock],
            output="screen",
        )
    prefix = f"/{namespace.strip('/')}" if namespace.strip("/") else ""
    topics = [f"{prefix}/{topic}" for topic in RECORDED] + list(ABSOLUTE)
    folder = f"runs/{datetime.now():%Y-%m-%d_%H-%M-%S}"
    follow = ["--use-sim-time"] if clock["use_sim_time"] else []
    return ExecuteProcess(
        cmd=["ros2", "bag", "record", "-s", "mcap", "-o", folder, *follow, "--topics", *topics],
        output="screen",
    )


def rviz(config: Path, clock: dict[str, bool], namespace: str) -> Node | LogInfo:
    """Return RViz, or the news that it is not installed."""
    if not is_installed("rviz2"):
        return LogInfo(msg="rviz:=true given, but rviz2 is not installed: going on without it")
    arguments = ["-d", str(config)] if config.exists() else []
    return Node(
        package="rviz2", executable="rviz2", arguments=arguments, parameters=[clock],
        namespace=namespace,
    )


def is_installed(package: str) -> bool:
    try:
        get_package_prefix(package)
    except PackageNotFoundError:
        return False
    return True


def is_true(text: str) -> bool:
    return text.lower() in ("true", "1")
