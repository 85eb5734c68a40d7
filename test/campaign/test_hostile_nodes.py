# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Nodes under malformed bytes and extreme values on each topic, parameter and service.

Nothing of it ends a node or breaks a limit: each still answers, does its work and ends in order,
and its log has short printable lines only.
"""

import math
import random
import signal

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("viser")

from fuzz import FuzzSession
from geometry_msgs.msg import PoseStamped
from hostile import NUMBERS, damaged, extreme, extreme_value, parameter_value
from judge import LimitCheck
from node_session import class_of
from patience import PATIENCE
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rclpy.serialization import deserialize_message
from rosbags.rosbag2 import Reader
from trajectory_msgs.msg import JointTrajectory
from tries import messages

from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.state import make_state
from sphere_nmpc.ros.controller.node import ControllerNode
from sphere_nmpc.ros.messages import (
    hold_and_stamp,
    pose_message,
    speeds_message,
    trajectory_message,
)
from sphere_sim.ros.simulator.node import SimulatorNode

SEED = 26
TOPICS = {
    "/clock", "/pose", "/goal_pose", "/joint_states", "/rotor_trajectory", "/rotor_commands",
    "/control_period", "/simulator/push", "/controller/active_goal", "/controller/predicted_path",
    "/controller/status", "/diagnostics",
}
"""Topics that the nodes subscribe to, and further ones of the recorder."""
UNKNOWN_TYPE = 99
BUSY = "commands more than 0.5 s ahead"
"""A complaint that a busy machine alone can cause."""


def drawn_for(name: str) -> random.Random:
    """Return a source of random values that is the same in each run, in whatever order."""
    return random.Random(f"{SEED} {name}")


def disturb_topic(session: FuzzSession, topic: str) -> None:
    """Send extreme values and damaged bytes on a topic."""
    rng, valid = drawn_for(topic), session.current_example(topic)
    given = [extreme(rng, session.topics[topic], valid) for _ in range(6)]
    given += [damaged(rng, valid) for _ in range(12)]
    sending = messages(session, [topic], lambda _: given.pop())
    while given:
        next(sending)
        session.until(lambda: False, 0.01)  # so that also a depth of 1 takes each of them
    sending.close()


def disturb_parameters(session: FuzzSession) -> None:
    """Set each parameter to values of each type; what is refused, is so with a reason."""
    for node, own in session.parameters.items():
        for name in own:
            rng = drawn_for(f"{node}/{name}")
            values = [parameter_value(rng, ParameterValue(type=kind)) for kind in range(10)]
            results = []
            for several in (values, [ParameterValue(type=UNKNOWN_TYPE)]):
                given = [ParameterMessage(name=name, value=value) for value in several]
                request = SetParameters.Request(parameters=given)
                results += session.call(f"{node}/set_parameters", request).results
            assert len(results) == len(values) + 1
            assert all(result.successful or result.reason for result in results), name
            assert not results[-1].successful and str(UNKNOWN_TYPE) in results[-1].reason


def disturb_services(session: FuzzSession) -> None:
    """Request each service with extreme values."""
    for node in session.nodes:
        for name, types in session.node.get_service_names_and_types_by_node(node, "/"):
            rng, kind = drawn_for(name), class_of(types[0])
            session.services.setdefault(name.strip("/"), kind)
            request = kind.Request()
            for field, of in request.get_fields_and_field_types().items():
                setattr(request, field, extreme_value(rng, of))
            session.call(name.strip("/"), request)


@pytest.mark.slow
def test_no_message_parameter_or_request_ends_a_node(tmp_path) -> None:
    complaints: list[tuple[str, ...]] = []
    with FuzzSession(tmp_path, lambda *words: complaints.append(words)) as session:
        session.judge.lenient_until = math.inf  # use_sim_time is one of the parameters
        session.start(*session.nodes)
        session.learn()
        assert session.topics.keys() >= TOPICS
        for topic in session.topics:
            disturb_topic(session, topic)
        disturb_parameters(session)
        disturb_services(session)
        session.is_pushed = True
        session.restore()
        assert session.control_back(np.random.default_rng(SEED)) is not None
        session.check_logs()
        session.expected.update(session.nodes)
        for process in session.processes:
            process.send(signal.SIGINT)
        codes = {process.name: process.wait(PATIENCE) for process in session.processes}
    assert [words for words in complaints if words[0] != BUSY] == []
    assert codes == dict.fromkeys(session.nodes, 0)
    bags = sorted(tmp_path.glob("bag*"))
    assert len(bags) > 1
    for bag in bags:
        with Reader(bag) as reader:
            list(reader.messages())


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
        check.sent(hold)
        check.delivered(hold)
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
