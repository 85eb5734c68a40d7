# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The launch file run by launch itself, with the nodes of a built workspace."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import yaml
from patience import LOCKSTEP

pytest.importorskip(
    "launch_pytest", reason="is no part of the ROS wheels: apt install ros-jazzy-launch-pytest"
)

import launch_pytest
from ament_index_python.packages import get_package_share_directory
from geometry_msgs.msg import PoseStamped
from launch.actions import IncludeLaunchDescription, RegisterEventHandler
from launch.event_handlers import OnProcessExit
from launch.launch_description_sources import PythonLaunchDescriptionSource
from std_msgs.msg import Bool

from launch import LaunchDescription
from sphere_nmpc.ros.guarded_node import LATCHED
from sphere_nmpc.ros.messages import pose_to_ros
from sphere_sim.scenario.scenarios import PAPER_CASES

pytestmark = pytest.mark.slow

PARAMETERS = {
    "/**/simulator": {"ros__parameters": LOCKSTEP},
    "/**/controller": {"ros__parameters": {"lockstep": True}},
}
"""In lockstep the run does not depend on how busy the machine is."""


@launch_pytest.fixture
def launched(tmp_path) -> tuple[LaunchDescription, dict[str, int]]:
    """Return the description to launch, and exit codes by executable as the processes end."""
    params_file = tmp_path / "lockstep.yaml"
    params_file.write_text(yaml.safe_dump(PARAMETERS), encoding="utf-8")
    file = Path(get_package_share_directory("sphere_nmpc")) / "launch" / "sphere.launch.py"
    arguments = {"params_file": str(params_file), "real_time_factor": "0.0"}
    codes: dict[str, int] = {}

    def note(event, context) -> None:
        codes[Path(event.cmd[0]).name] = event.returncode

    return LaunchDescription([
        RegisterEventHandler(OnProcessExit(on_exit=note)),
        IncludeLaunchDescription(
            PythonLaunchDescriptionSource(str(file)), launch_arguments=arguments.items()
        ),
    ]), codes


@pytest.mark.launch(fixture=launched)
def test_launched_nodes_bring_the_sphere_to_its_goal_and_end_in_order(
    launched, graph
) -> Iterator[None]:
    _, codes = launched

    def until(condition: Callable[[], object]) -> None:
        graph.until(lambda: codes or condition())
        assert not codes, "a process has ended"

    arrivals = graph.collect(Bool, "controller/at_goal", LATCHED)
    goals = graph.collect(PoseStamped, "controller/active_goal", LATCHED)
    sender = graph.probe.create_publisher(PoseStamped, "goal_pose", 10)
    until(lambda: sender.get_subscription_count() > 0)
    sender.publish(pose_to_ros(PAPER_CASES[1].goal, 0, 0.3))
    until(lambda: goals)
    until(lambda: arrivals and arrivals[-1].data)
    yield
    # Others may be installed, such as robot_state_publisher.
    assert codes.items() >= {"simulator": 0, "controller": 0}.items()
