# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Simulator, controller and navigator as processes, which may be killed, and a client of them."""

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from navigation_client import NavigationClient
from patience import PATIENCE
from ros_graph import Graph, values_of

from sphere_nmpc.model.state import POSITION, Vector
from sphere_nmpc.ros.guarded_node import NEWEST
from sphere_nmpc.ros.messages import pose_from_ros
from sphere_sim.ros.session.process_set import ProcessSet, parameter_options

FACTOR = 4.0
"""Simulated over wall time."""
AT_REST = 0.01
"""Largest way of a sphere at rest [m]."""


class Session:
    """Simulator, controller and navigator in a set of processes, and a client.

    The navigator does not lose patience.
    """

    def __init__(self, graph: Graph, processes: ProcessSet) -> None:
        self.graph, self.processes = graph, processes
        patient = {"controller_timeout": PATIENCE, "no_progress_timeout": PATIENCE}
        given = {
            "simulator": {
                "real_time_factor": FACTOR, "initial_state": [0.0, 0.0, 1.0, 0.0, 0.0, 0.0],
            },
            "controller": {"use_sim_time": True, "goal_memory": 30.0},
            "navigator": {"use_sim_time": True, **patient},
        }
        for verb, parameters in given.items():
            self.processes.start(verb, ["--ros-args", *parameter_options(parameters)])
        self.statuses: list[dict[str, str]] = []
        """Values of all statuses of the controller."""
        self._pose: PoseStamped | None = None
        probe = graph.probe
        probe.create_subscription(
            DiagnosticStatus, "controller/status",
            lambda message: self.statuses.append(values_of(message)), 10,
        )
        # Of a queue the oldest pose would be taken first, from before the sphere came to rest.
        probe.create_subscription(PoseStamped, "pose", self._note, NEWEST)
        self.client = NavigationClient(probe, graph.until)
        self.client.wait_for_navigator()
        graph.until(lambda: self._pose and self.status()["mode"] == "no goal")

    def _note(self, message: PoseStamped) -> None:
        self._pose = message

    @property
    def place(self) -> Vector:
        """Position of the sphere [m], shape (2,)."""
        return pose_from_ros(self._pose)[POSITION]

    def moves(self) -> None:
        """Wait until the sphere moves."""
        start = self.place
        self.graph.until(lambda: np.linalg.norm(self.place - start) > 0.05)

    def status(self) -> dict[str, str]:
        """Return a status that is published from now on."""
        seen = len(self.statuses)
        self.graph.until(lambda: len(self.statuses) > seen + 1)
        return self.statuses[-1]

    def wait_for_rest(self) -> None:
        """Wait until the sphere stays in place for half a second.

        Its last commands and poses may be late on a busy machine.
        """
        def rests() -> bool:
            before = self.place
            self.graph.spin_for(0.5)
            return bool(np.linalg.norm(self.place - before) < AT_REST)

        self.graph.until(rests)

    def restart(self, name: str) -> None:
        """Kill a node and start it again."""
        self.processes[name].kill()
        self.processes[name].start()

    def log(self, name: str) -> str:
        """Return what a node has printed."""
        return self.processes[name].output
