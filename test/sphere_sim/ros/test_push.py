# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Push on running nodes: the controller finds the momentum and returns to its goal."""

import math

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped, Vector3
from patience import LOCKSTEP
from rclpy.parameter import Parameter
from ros_graph import values_of

from sphere_nmpc.model.state import make_state
from sphere_nmpc.ros.controller.node import ControllerNode
from sphere_nmpc.ros.messages import pose_to_ros
from sphere_sim.ros.simulator.node import SimulatorNode

GOAL = make_state((0.5, -0.5), (math.cos(0.4), 0.0, 0.0, math.sin(0.4)))


@pytest.mark.slow
def test_pushed_sphere_returns_and_the_status_has_its_momentum(graph) -> None:
    start = [0.4, -0.5, *GOAL[2:].tolist()]
    given = {"initial_state": start, "real_time_factor": 0.0, "pose_rate": 20.0, **LOCKSTEP}
    simulator = SimulatorNode([Parameter(k, value=v) for k, v in given.items()])
    given = {"use_sim_time": True, "lockstep": True, "goal_memory": 0.0}
    node = ControllerNode([Parameter(k, value=v) for k, v in given.items()])
    graph.add(simulator)
    graph.add(node)
    statuses = graph.collect(DiagnosticStatus, "controller/status")
    pushes = graph.publisher(Vector3, "simulator/push")
    graph.publisher(PoseStamped, "goal_pose").publish(pose_to_ros(GOAL, 0, 0.3))
    graph.until(lambda: node.controller.at_goal and statuses)
    values = values_of(statuses[-1])
    assert values["momentum_x"] == "0" and values["saturation_s"] == "inf"

    pushes.publish(Vector3(x=0.3, y=-0.4))
    graph.until(lambda: simulator.simulator.plant.momentum.any())
    graph.until(lambda: not node.controller.at_goal)
    graph.until(lambda: node.controller.at_goal)
    momentum = simulator.simulator.plant.momentum
    np.testing.assert_allclose(momentum, [0.12, 0.09, 0.0], atol=1e-9)
    values = values_of(statuses[-1])
    # The constants are learnt from this very motion.
    reported = [float(values[f"momentum_{axis}"]) for axis in "xyz"]
    np.testing.assert_allclose(reported, momentum, atol=0.01)
    held = [float(values[f"rest_speed_{i}"]) for i in (1, 2)]
    assert np.hypot(*held) == pytest.approx(0.5 * 37.5, rel=0.1)
    assert values["giving_up"] == ""
