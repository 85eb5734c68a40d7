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
from sphere_nmpc.ros.conversions import joint_states_to_ros, rotor_speeds_from_ros
from sphere_nmpc.ros.guarded_node import GuardedNode
from sphere_nmpc.settings import ControllerSettings

SPEEDS = np.array([3.0, -4.0])


class Heard(Controller):
    """Controller that keeps what it hears of the rotors."""

    def __init__(self) -> None:
        super().__init__(ControllerSettings(strategy="paper"), RobotParameters())
        self.heard: list[tuple[float, np.ndarray]] = []

    def observe_rotors(self, time: float, speeds: np.ndarray) -> None:
        self.heard.append((time, speeds))


def joints(stamp: int, speeds: np.ndarray = SPEEDS) -> JointState:
    return joint_states_to_ros(np.zeros(2), speeds, np.zeros(2), stamp)


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


def test_rotors_are_found_by_name_among_other_joints() -> None:
    names = ["wheel", "rotor_2_joint", "rotor_1_joint"]
    message = JointState(name=names, velocity=[9.0, 2.0, 1.0])
    assert rotor_speeds_from_ros(message).tolist() == [1.0, 2.0]


@pytest.mark.parametrize(
    ("names", "speeds"),
    [
        (["rotor_1_joint"], [1.0]),
        (["rotor_1_joint", "rotor_2_joint"], []),
        (["rotor_1_joint", "rotor_2_joint"], [1.0, float("nan")]),
        ([], []),
    ],
)
def test_speeds_that_are_missing_or_not_finite_are_none(
    names: list[str], speeds: list[float]
) -> None:
    assert rotor_speeds_from_ros(JointState(name=names, velocity=speeds)) is None
