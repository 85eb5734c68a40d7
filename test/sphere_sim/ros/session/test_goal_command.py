# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The goal command: its arguments, the goal it sends, and its exit code."""

import math
import threading

import numpy as np
import pytest
import rclpy
from geometry_msgs.msg import PoseStamped
from rclpy.qos import DurabilityPolicy, QoSProfile

from sphere_nmpc.ros.conversions import pose_from_ros
from sphere_sim.ros.session.goal_command import main, parse
from sphere_sim.scenario.scenarios import PAPER_CASES

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["1", "-2.5"], [1, -2.5, 1, 0, 0, 0]),
        (["0", "0", "--yaw", str(math.pi)], [0, 0, 0, 0, 0, 1]),
        (["-1", "2", "--quaternion", "0.5", "-0.5", "0.5", "0.5"], [-1, 2, 0.5, -0.5, 0.5, 0.5]),
        (["--case", "2"], PAPER_CASES[2].goal),
    ],
)
def test_arguments_name_a_goal(arguments, expected) -> None:
    np.testing.assert_allclose(parse(arguments)[0], expected, atol=1e-12)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["1"], "given 1 numbers"),
        (["1", "2", "--case", "1"], "--case brings its own"),
        (["1", "2", "--quaternion", "1", "1", "0", "0"], "norm 1.41421"),
        (["nan", "2"], "expected finite numbers"),
        (["1", "2", "--yaw", "1", "--quaternion", "1", "0", "0", "0"], "not allowed with"),
    ],
)
def test_wrong_arguments_exit_with_2(arguments, message, capsys) -> None:
    with pytest.raises(SystemExit, match="2"):
        parse(arguments)
    assert message in capsys.readouterr().err


def test_missing_controller_exits_with_1(capsys) -> None:
    assert main(["1", "2", "--timeout", "0.3"]) == 1
    assert "no controller was ready within 0.3 s" in capsys.readouterr().err


class Controller(threading.Thread):
    """A controller that confirms goals, or does not, in a context of its own."""

    def __init__(self, confirms: bool) -> None:
        super().__init__(daemon=True)
        self.received: list[np.ndarray] = []
        self._confirms = confirms
        self._context = rclpy.Context()
        rclpy.init(context=self._context)
        self._node = rclpy.create_node("controller", context=self._context)
        self._active = self._node.create_publisher(PoseStamped, "~/active_goal", LATCHED)
        self._active.publish(PoseStamped())  # the goal before this one
        self._node.create_subscription(PoseStamped, "goal_pose", self._take, 1)
        self._done = threading.Event()

    def _take(self, message: PoseStamped) -> None:
        self.received.append(pose_from_ros(message))
        if self._confirms:
            self._active.publish(message)

    def run(self) -> None:
        executor = rclpy.executors.SingleThreadedExecutor(context=self._context)
        executor.add_node(self._node)
        while not self._done.is_set():
            executor.spin_once(timeout_sec=0.05)
        self._node.destroy_node()
        executor.shutdown()

    def stop(self) -> None:
        self._done.set()
        self.join()
        self._context.try_shutdown()


@pytest.mark.parametrize(("confirms", "code"), [(True, 0), (False, 1)])
def test_goal_is_sent_once_and_its_acceptance_printed(confirms, code, capsys, monkeypatch) -> None:
    monkeypatch.setattr("sphere_sim.ros.session.goal_command._ANSWER_TIMEOUT", 1.0)
    controller = Controller(confirms)
    controller.start()
    try:
        assert main(["1", "2", "--yaw", "1", "--timeout", "20"]) == code
    finally:
        controller.stop()
    assert len(controller.received) == 1
    np.testing.assert_allclose(controller.received[0], parse(["1", "2", "--yaw", "1"])[0])
    printed = capsys.readouterr()
    # What the command knows, and where all else is told.
    assert ("in force; /controller/status reports the progress" in printed.out) == confirms
    assert ("not confirmed" in printed.err) != confirms
