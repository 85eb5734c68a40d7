# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The subscription of measured rotor speeds, over DDS."""

import numpy as np
import pytest
from sensor_msgs.msg import JointState

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.ros.controller.control_clock import ControlClock
from sphere_nmpc.ros.controller.rotor_receiver import RotorReceiver
from sphere_nmpc.ros.guarded_node import GuardedNode
from sphere_nmpc.ros.messages import joint_states_message
from sphere_nmpc.settings import ControllerSettings

SPEEDS = np.array([3.0, -4.0])


class Heard(Controller):
    """Controller that keeps what it hears of the rotors."""

    def __init__(self) -> None:
        super().__init__(ControllerSettings(strategy="paper"), RobotParameters())
        self.heard: list[tuple[float, np.ndarray]] = []

    def observe_rotors(self, time: float, speeds: np.ndarray) -> None:
        self.heard.append((time, speeds))


def joints(stamp: int, speeds: np.ndarray = SPEEDS) -> bytes:
    return joint_states_message(np.zeros(2), speeds, np.zeros(2), stamp)


def test_speeds_are_heard_until_they_are_no_longer_needed_and_again_when_they_are(graph) -> None:
    node = GuardedNode("listener")
    graph.add(node)
    controller, windows = Heard(), []
    clock = ControlClock(node, lambda changed: None)
    receiver = RotorReceiver(node, controller, clock, windows.append)
    publisher = graph.probe.create_publisher(JointState, "joint_states", 10)
    graph.until(lambda: publisher.get_subscription_count() == 1)
    publisher.publish(joints(clock.stamp() + 10**12))
    stamp = clock.stamp()
    publisher.publish(joints(stamp))
    graph.until(lambda: controller.heard)
    (time, speeds), = controller.heard
    assert time == pytest.approx(clock.time_of(stamp)), "not the one of another clock"
    assert speeds.tolist() == SPEEDS.tolist() and windows == [0.0]

    controller.rotor_feedback._in_time = 10
    receiver.update()
    graph.until(lambda: publisher.get_subscription_count() == 0)
    controller.rotor_feedback.resume()
    receiver.update()
    graph.until(lambda: publisher.get_subscription_count() == 1)
