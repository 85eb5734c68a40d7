# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""A simulator on the system clock: its stamps, what it refuses, and time without service."""

import time

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.ros.messages import (
    stamp_from_ros,
)
from sphere_sim.ros.simulator.node import SimulatorNode
from sphere_sim.ros.simulator.settings import SimulatorNodeSettings
from sphere_sim.scenario.scenarios import PAPER_CASES

CASE = PAPER_CASES[1]
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
MS = 1_000_000
A_MINUTE = 60_000 * MS
"""More than a busy machine takes from stamp to arrival [ns]; the clocks differ by 1.8e9 s."""


def test_stamps_are_those_of_the_system_clock_which_nothing_stops(
    graph, monkeypatch, capfd
) -> None:
    node = SimulatorNode([Parameter("clock", value="system")])
    graph.add(node)
    poses, odometry = graph.collect(PoseStamped, "pose"), graph.collect(Odometry, "odom")
    joints = graph.collect(JointState, "joint_states")
    graph.until(lambda: len(poses) > 50 and odometry and joints)
    graph.spin()
    now = time.time_ns()
    for message in (poses[-1], odometry[-1], joints[-1]):
        assert abs(now - stamp_from_ros(message.header.stamp)) < A_MINUTE
    assert graph.probe.count_publishers("/clock") == 0
    answer = graph.call(SetBool, "simulator/pause", SetBool.Request(data=True))
    assert not answer.success and "clock: system" in answer.message
    assert not graph.call(Trigger, "simulator/step", Trigger.Request()).success
    result = node.set_parameters([Parameter("real_time_factor", value=2.0)])[0]
    assert not result.successful and "clock: system" in result.reason

    time.sleep(0.5)  # the node is not served
    served = time.time_ns()
    graph.until(lambda: stamp_from_ros(poses[-1].header.stamp) > served + 100 * MS)
    assert node._simulated_clock.lost == 0.0
    stamps = np.array([stamp_from_ros(message.header.stamp) for message in poses])
    assert np.all(np.diff(stamps) > 0) and np.all((stamps - stamps[0]) % (10 * MS) == 0)
    assert np.max(np.diff(stamps)) > 400 * MS, "one step over the gap, no burst"

    real = time.time_ns
    monkeypatch.setattr(time, "time_ns", lambda: real() + 3600 * 10**9)
    graph.until(lambda: stamp_from_ros(poses[-1].header.stamp) > real() + 3500 * 10**9)
    assert "system clock jumped: given a jump of 3600.0" in capfd.readouterr().err


@pytest.mark.parametrize(
    "settings", [{"lockstep": True}, {"real_time_factor": 0.0}, {"start_paused": True}]
)
def test_settings_that_need_a_clock_of_their_own_are_refused(settings) -> None:
    with pytest.raises(InvalidParameterError, match=f"{next(iter(settings))}.*clock: system"):
        SimulatorNodeSettings(clock="system", **settings)
