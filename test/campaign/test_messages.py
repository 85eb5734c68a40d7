# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Controller and simulator keep the limits under arbitrary messages and with a failing solver."""

import random

import numpy as np
import pytest

pytest.importorskip("rclpy")

import bad_strategy
from geometry_msgs.msg import PoseStamped
from hostile import NUMBERS, extreme
from judge import LimitCheck
from rclpy.parameter import Parameter
from rclpy.serialization import deserialize_message
from trajectory_msgs.msg import JointTrajectory

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.control.decision import Mode
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import make_state
from sphere_nmpc.ros.controller.node import ControllerNode
from sphere_nmpc.ros.messages import (
    hold_and_stamp,
    pose_message,
    speeds_message,
    trajectory_message,
)
from sphere_nmpc.settings import STRATEGIES, ControllerSettings
from sphere_sim.ros.simulator.node import SimulatorNode

STEPS = [1e-9, 1e-6, 1e-3, 0.01, 0.05, 0.25, 1.0, 60.0, 3600.0]
SHARES = [0.02, 0.02, 0.05, 0.4, 0.3, 0.15, 0.03, 0.02, 0.01]
SPEEDS = [1.0, 100.0, 1e4, 1e300, 1e308]
NOISE = {"pose_position_noise": 1e-4, "pose_orientation_noise": 1e-3}
SETTINGS = ControllerSettings(strategy="paper")
START = np.array([1.0, -1.0, 1.0, 0.0, 0.0, 0.0])
GOAL = np.array([0.0, 0.0, 0.6, 0.0, 0.0, 0.8])


@pytest.fixture
def controller(graph) -> ControllerNode:
    node = ControllerNode([Parameter("strategy", value="paper")])
    graph.add(node)
    return node


@pytest.fixture
def sent(controller, monkeypatch) -> LimitCheck:
    check = LimitCheck()
    publish = controller._sender._trajectories.publish

    def check_and_publish(message) -> None:
        # Relative to the epoch, as times since 1970 would be rounded.
        hold, _ = hold_and_stamp(message, 0, controller._control_clock.epoch)
        check.trajectory(hold)
        publish(message)

    monkeypatch.setattr(controller._sender._trajectories, "publish", check_and_publish)
    return check


@pytest.mark.parametrize("share", [0.0, 0.5])
def test_any_pose_and_goal_leave_the_controller_within_its_limits(
    controller, sent, share
) -> None:
    """Half of the poses, or none, are those that a robot can have."""
    rng, draws = random.Random(1), np.random.default_rng(1)
    sent.begin()
    for _ in range(100):
        now = controller.get_clock().now().nanoseconds
        place, turn = draws.choice([0.0, 1e-300, 5.0, -1e6, 1e5], 2), draws.normal(size=4)
        pose = pose_message(make_state(place, turn / np.linalg.norm(turn)), now, 0.3)
        hostile = extreme(rng, PoseStamped, pose)
        controller._receive_goal(deserialize_message(hostile, PoseStamped))
        controller._receive_pose(pose if rng.random() < share else hostile)
        controller._tick()
    assert not sent.broken
    assert share == 0.0 or sent.worst_speed > 0.0, "plans were sent"


def test_any_command_leaves_the_robot_within_its_limits(graph) -> None:
    node = SimulatorNode([Parameter("start_paused", value=True)])
    graph.add(node)
    rng = random.Random(1)
    valid = trajectory_message(FirstOrderHold(np.arange(3.0), np.array([[0, 0], [9, -9], [0, 0]])))
    for _ in range(150):
        node._receiver._receive_trajectory(extreme(rng, JointTrajectory, valid))
        node._receiver._receive_speeds(speeds_message(np.array(rng.choices(NUMBERS, k=2))))
        before = np.array(node.simulator.speed_reference)
        for _ in range(3):
            node._advance()
        after = node.simulator.speed_reference
        assert np.all(np.isfinite(node.simulator.plant.state))
        assert np.all(np.abs(after) <= 100.0) and np.all(np.abs(after - before) <= 12.0 + 1e-9)


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("noise", [{}, NOISE], ids=["exact", "noisy"])
@pytest.mark.parametrize("scale", [1.0, 1e6])
def test_numbers_that_are_far_from_those_of_a_robot_cause_neither_warning_nor_failure(
    noise, scale
) -> None:
    rng = np.random.default_rng(1)
    controller = Controller(ControllerSettings(strategy="paper", **noise), RobotParameters())
    time, place, turn = 0.0, np.zeros(2), np.array([1.0, 0.0, 0.0, 0.0])
    for i in range(200):
        time += rng.choice(STEPS, p=SHARES)
        if rng.random() < 0.3:
            place = np.clip(scale * rng.normal(size=2), -1e6, 1e6)
        if rng.random() < 0.2:
            turn = rng.normal(size=4)
            turn /= np.linalg.norm(turn)
        state = make_state(place, turn)
        controller.observe(time, state)
        controller.observe_rotors(time, rng.choice(SPEEDS) * rng.uniform(-1.0, 1.0, 2))
        if i % 40 == 0:
            controller.set_goal(make_state(np.clip(scale * rng.normal(size=2), -1e6, 1e6), turn))
        if rng.random() < 0.25:
            controller.commit(controller.decide(time), time)
    assert controller.failures == 0, controller.last_failure
    for _ in range(30):  # The motion of a robot again, which rests after it has been disabled.
        time += 0.1
        controller.enabled = False
        controller.observe(time, state)
        decision = controller.decide(time)
        controller.commit(decision, time)
    np.testing.assert_allclose(decision.state, state, atol=1e-2)
    assert controller.failures == 0, controller.last_failure


@pytest.mark.parametrize(
    ("mode", "expected"),
    [("", Mode.TRACKING), ("raise", Mode.FALLBACK), ("nan", Mode.FALLBACK),
     ("nothing", Mode.FALLBACK), ("wild", Mode.TRACKING)],
)
def test_controller_reports_its_mode_and_keeps_the_limits(
    tmp_path, monkeypatch, mode, expected
) -> None:
    for name, entry in STRATEGIES.items():
        monkeypatch.setitem(STRATEGIES, name, entry)
    mode_file = tmp_path / "mode"
    bad_strategy.register(mode_file)
    controller = Controller(SETTINGS, RobotParameters())
    controller.set_goal(GOAL)
    check = LimitCheck()
    for number in range(4):
        time = number * SETTINGS.period
        if number == 2:
            mode_file.write_text(mode)
        controller.observe(time, START)
        decision = controller.decide(time)
        hold = controller.commit(decision, time + 0.01)
        assert hold is not None
        check.trajectory(hold)
    assert decision.mode is expected
    assert not check.broken
