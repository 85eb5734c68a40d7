# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Lockstep of both nodes: the controller tells its period, and every sample is answered."""

from patience import LOCKSTEP
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Float64
from trajectory_msgs.msg import JointTrajectory

from sphere_nmpc.ros.controller.node import ControllerNode
from sphere_nmpc.ros.conversions import stamp_from_ros
from sphere_sim.ros.simulator.node import SimulatorNode

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def simulator(graph) -> SimulatorNode:
    given = {**LOCKSTEP, "real_time_factor": 0.0, "pose_rate": 20.0}
    node = SimulatorNode([Parameter(name, value=value) for name, value in given.items()])
    graph.add(node)
    return node


def controller(graph, **settings) -> ControllerNode:
    given = {"lockstep": True, "use_sim_time": True, **settings}
    node = ControllerNode([Parameter(name, value=value) for name, value in given.items()])
    graph.add(node)
    return node


def test_controller_of_any_period_is_waited_for_also_after_a_restart(graph) -> None:
    sent = graph.collect(JointTrajectory, "rotor_trajectory")
    world = simulator(graph)
    for settings in (
        {"strategy": "time_optimal"},
        {"strategy": "paper", "control_rate": 3.0},
        {"strategy": "paper", "sample_period": 0.618765432},
    ):
        node = controller(graph, **settings)
        period = round(1e9 * node._settings.control_period)
        instants = {(world.simulator.now // period + i) * period for i in (2, 3, 4)}
        last = max(instants)
        graph.until(lambda last=last: world.simulator.now > last)
        assert {stamp_from_ros(message.header.stamp) for message in sent} >= instants
        graph.remove(node)
    assert world._simulated_clock.timeouts == 0


def test_impossible_periods_are_refused(graph, capfd) -> None:
    world = simulator(graph)
    sender = graph.probe.create_publisher(Float64, "control_period", LATCHED)
    for number, period in enumerate([float("nan"), -1.0, 0.0, 1e9], 1):
        sender.publish(Float64(data=period))
        graph.until(
            lambda number=number: world._fault_log.counts["control_period refused"] == number
        )
    assert "control_period refused: given nan" in capfd.readouterr().err
    assert world._simulated_clock.next_sample(0) == 250_000_000
