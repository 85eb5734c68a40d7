# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Lockstep of both nodes: the controller tells its period, and every sample is answered."""

import pytest
from patience import LOCKSTEP
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Float64
from trajectory_msgs.msg import JointTrajectory

from sphere_nmpc.ros.controller.node import ControllerNode
from sphere_nmpc.ros.messages import stamp_from_ros
from sphere_sim.ros.simulator.node import SimulatorNode

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def simulator(graph, **settings) -> SimulatorNode:
    given = {**LOCKSTEP, "real_time_factor": 0.0, **settings}
    node = SimulatorNode([Parameter(name, value=value) for name, value in given.items()])
    graph.add(node)
    return node


def controller(graph, **settings) -> ControllerNode:
    given = {"lockstep": True, "use_sim_time": True, **settings}
    node = ControllerNode([Parameter(name, value=value) for name, value in given.items()])
    graph.add(node)
    return node


@pytest.mark.parametrize(
    ("of_simulator", "of_controller"),
    [
        ({}, {"strategy": "time_optimal"}),
        ({}, {"strategy": "paper"}),
        ({}, {"strategy": "paper", "control_rate": 3.0}),
        ({}, {"strategy": "paper", "sample_period": 2.318765432}),
        ({}, {"strategy": "paper", "robot.max_rotor_speed": 43.0}),
        ({"sample_period": 0.2}, {"strategy": "paper"}),
        ({"sample_period": 1.0}, {"strategy": "paper"}),
    ],
    ids=str,
)
def test_every_instant_of_the_controller_is_waited_for(graph, of_simulator, of_controller) -> None:
    sent = graph.collect(JointTrajectory, "rotor_trajectory")
    world = simulator(graph, **of_simulator)
    period = round(1e9 * controller(graph, **of_controller)._settings.control_period)
    graph.until(lambda: world.simulator.now >= 6 * period)
    assert world._simulated_clock.timeouts == 0
    stamps = {stamp_from_ros(message.header.stamp) for message in sent}
    assert stamps >= {i * period for i in range(1, 6)}


def test_controller_of_another_period_is_waited_for_after_a_restart(graph) -> None:
    world = simulator(graph)
    first = controller(graph, strategy="time_optimal")
    graph.until(lambda: world.simulator.now == 250_000_000)
    graph.remove(first)
    controller(graph, strategy="paper")
    graph.until(lambda: world.simulator.now >= 2_000_000_000)
    assert world._simulated_clock.timeouts == 0


@pytest.mark.parametrize("period", [float("nan"), -1.0, 0.0, 1e9])
def test_impossible_period_is_refused(graph, capfd, period) -> None:
    world = simulator(graph)
    graph.probe.create_publisher(Float64, "control_period", LATCHED).publish(Float64(data=period))
    graph.until(lambda: "control_period refused: given" in capfd.readouterr().err)
    assert world._simulated_clock.next_sample(0) == 250_000_000
