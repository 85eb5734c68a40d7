# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Running nodes under malformed bytes and extreme values on each topic, parameter and service.

Nothing of it ends a node or breaks a limit: each still answers, does its work and ends in order,
and its log has short printable lines only.
"""

import math
import random
import signal
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("viser")

from fuzz import FuzzSession
from hostile import damaged, extreme, extreme_value, parameter_value
from node_session import class_of
from patience import PATIENCE
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import SetParameters
from rosbags.rosbag2 import Reader
from tries import messages

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
            kinds = [ParameterValue(type=kind) for kind in range(10) for _ in range(2)]
            values = [parameter_value(rng, kind) for kind in kinds]
            results = []
            for several in (values, [ParameterValue(type=UNKNOWN_TYPE)]):
                given = [Parameter(name=name, value=value) for value in several]
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
            for _ in range(2):
                session.call(name.strip("/"), extreme_request(rng, kind.Request()))


def extreme_request(rng: random.Random, request: Any) -> Any:
    """Return a request with extreme values."""
    for field, name in request.get_fields_and_field_types().items():
        setattr(request, field, extreme_value(rng, name))
    return request


@pytest.mark.slow
def test_no_message_parameter_or_request_ends_a_node(tmp_path) -> None:
    complaints: list[tuple[str, ...]] = []
    with FuzzSession(tmp_path, lambda *words: complaints.append(words)) as session:
        session.judge.on_system_clock_until = math.inf  # use_sim_time is one of the parameters
        session.judge.reset_until = math.inf
        session.start(*session.nodes)
        session.learn()
        assert session.topics.keys() >= TOPICS
        for topic in session.topics:
            disturb_topic(session, topic)
        disturb_parameters(session)
        disturb_services(session)
        session.changed = {"parameters", "services", "plant"}
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
