# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Session over DDS: simulator, controller and viewer with a page, and a probe in the graph."""

import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from browser import Browser
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from page_helpers import page_of
from rcl_interfaces.srv import GetParameters
from rclpy.qos import DurabilityPolicy, QoSProfile
from ros_graph import Graph, values_of
from verb_process import start, stop

from sphere_nmpc.model.state import Vector, state_error
from sphere_nmpc.ros.messages import pose_from_ros, stamp_from_ros

CONTROLLER = (
    "-p", "use_sim_time:=true", "-p", "strategy:=time_optimal",
    "-p", "goal_memory:=0.0",  # no goal of a controller of another test
)
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


@dataclass
class Session:
    """Nodes, page, and a probe in the graph."""

    page: Browser
    graph: Graph
    processes: dict[str, subprocess.Popen]
    poses: list
    goals: list
    statuses: list
    folder: Path

    @property
    def time(self) -> int:
        """Stamp of the newest pose [ns]."""
        return stamp_from_ros(self.poses[-1].header.stamp)

    @property
    def goal(self) -> Vector:
        """Goal in force, shape (6,)."""
        return pose_from_ros(self.goals[-1])

    @property
    def error(self) -> float:
        """Error of the newest pose from the goal in force."""
        return state_error(pose_from_ros(self.poses[-1]), self.goal)

    @property
    def status(self) -> dict[str, str]:
        """Values of the newest status of the controller."""
        return values_of(self.statuses[-1])

    def real_time_factor(self) -> float:
        """Return the parameter of the simulator."""
        request = GetParameters.Request(names=["real_time_factor"])
        answer = self.graph.call(GetParameters, "simulator/get_parameters", request)
        return float(answer.values[0].double_value)

    def restart(self, verb: str, *arguments: str) -> None:
        """Start a node again."""
        self.processes[verb] = start(self.folder, verb, "--ros-args", *arguments)


@contextmanager
def open_session(
    executable: str, folder: Path, simulator: Sequence[str], size: tuple[int, int] = (800, 400)
) -> Iterator[Session]:
    """Run the nodes and open the page.

    Parameters
    ----------
    executable : str
        The browser.
    folder : Path
        Folder of the logs.
    simulator : sequence of str
        ROS arguments of the simulator.
    size : (int, int), optional
        Size of the page [px].
    """
    processes = {
        "simulator": start(folder, "simulator", "--ros-args", *simulator),
        "controller": start(folder, "controller", "--ros-args", *CONTROLLER),
        "viewer": start(folder, "viewer", "--port", "0"),
    }
    graph = Graph()
    poses = graph.collect(PoseStamped, "pose", 1)
    goals = graph.collect(PoseStamped, "controller/active_goal", LATCHED)
    statuses = graph.collect(DiagnosticStatus, "controller/status", 1)
    home = folder / "browser"
    home.mkdir()
    try:
        graph.until(lambda: page_of(folder))
        with Browser(executable, home, size) as page:
            page.open(page_of(folder))
            yield Session(page, graph, processes, poses, goals, statuses, folder)
    finally:
        graph.close()
        stop(processes.values())
        for log in sorted(folder.glob("*.log")):  # shown where a test failed
            print(f"{log.name}:\n{log.read_text(errors='replace')[-3000:]}")
