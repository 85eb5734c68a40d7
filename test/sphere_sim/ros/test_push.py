# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Push and slope on running nodes: the controller finds the momentum and returns to its goal."""

import math

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped, Vector3
from patience import LOCKSTEP
from rclpy.parameter import Parameter

from sphere_nmpc.control.decision import Mode
from sphere_nmpc.model.state import make_state
from sphere_nmpc.ros.controller.node import ControllerNode
from sphere_nmpc.ros.messages import pose_to_ros
from sphere_sim.ros.simulator.node import SimulatorNode

START = make_state((0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
GOAL = make_state((0.5, -0.5), (math.cos(0.4), 0.0, 0.0, math.sin(0.4)))
IMPULSE = 0.3, -0.4


class Run:
    """Simulator and controller in lockstep, at rest at an upright goal."""

    def __init__(self, graph) -> None:
        self.graph = graph
        given = {"initial_state": START.tolist(), "real_time_factor": 0.0, **LOCKSTEP}
        self.simulator = SimulatorNode([Parameter(k, value=v) for k, v in given.items()])
        given = {"use_sim_time": True, "lockstep": True, "goal_memory": 0.0}
        self.controller = ControllerNode([Parameter(k, value=v) for k, v in given.items()])
        graph.add(self.simulator)
        graph.add(self.controller)
        self._statuses = graph.collect(DiagnosticStatus, "controller/status")
        self.pushes = graph.publisher(Vector3, "simulator/push")
        graph.publisher(PoseStamped, "goal_pose").publish(pose_to_ros(GOAL, 0, 0.3))
        self.wait_at_goal()

    @property
    def momentum(self) -> np.ndarray:
        return self.simulator.simulator.plant.momentum

    def status(self, key: str) -> str:
        """Return a value of the newest status."""
        return next(pair.value for pair in self._statuses[-1].values if pair.key == key)

    @property
    def time(self) -> float:
        """Simulated time of the newest status [s]."""
        return float(self.status("time_s"))

    @property
    def level(self) -> bytes:
        return self._statuses[-1].level

    def wait_at_goal(self) -> None:
        self.graph.until(lambda: self.controller.controller.at_goal)


@pytest.mark.slow
def test_pushed_sphere_returns_and_the_status_has_its_momentum(graph) -> None:
    run = Run(graph)
    assert run.status("momentum_x") == "0" and run.status("saturation_s") == "inf"
    run.pushes.publish(Vector3(x=IMPULSE[0], y=IMPULSE[1]))
    graph.until(lambda: run.momentum.any())
    graph.until(lambda: not run.controller.controller.at_goal)
    run.wait_at_goal()
    np.testing.assert_allclose(run.momentum, [0.12, 0.09, 0.0], atol=1e-9)
    # The constants are learnt from this very motion.
    reported = [float(run.status(f"momentum_{axis}")) for axis in "xyz"]
    np.testing.assert_allclose(reported, run.momentum, atol=0.01)
    held = [float(run.status(f"rest_speed_{i}")) for i in (1, 2)]
    assert np.hypot(*held) == pytest.approx(0.5 * 37.5, rel=0.1)
    assert run.status("giving_up") == ""


@pytest.mark.slow
def test_slope_is_reported_until_a_rotor_is_at_its_limit_and_what_is_given_up_then(graph) -> None:
    run = Run(graph)
    slope, direction = 0.01, 2.0
    run.simulator.set_parameters(
        [Parameter("slope", value=slope), Parameter("slope_direction", value=direction)]
    )
    graph.until(lambda: max(abs(float(run.status(f"rest_speed_{i}"))) for i in (1, 2)) > 50.0)
    began, left = run.time, float(run.status("saturation_s"))
    graph.until(lambda: run.level == DiagnosticStatus.ERROR)
    # 14 rad/s per second fill the other half of a rotor in about 4 s; known to a sample or two.
    assert run.time - began == pytest.approx(left, abs=0.6)
    reported = [float(run.status(key)) for key in ("slope_deg", "slope_direction_deg")]
    assert reported[0] == pytest.approx(math.degrees(slope), rel=0.1)
    assert reported[1] == pytest.approx(math.degrees(direction), abs=6.0)
    assert float(run.status("saturation_s")) == 0.0
    assert run.status("mode") == Mode.SATURATED.value
    assert "cannot hold the momentum" in run.status("giving_up")
