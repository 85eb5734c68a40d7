# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Running nodes over DDS under the hardest faults at once, and under hostile messages."""

import json
import random
import signal
from contextlib import suppress

import pytest

pytest.importorskip("rclpy")

from actions import Action
from catalogue import FAULTS, Fault, chosen
from faults import write_json
from hostile import ROBOT, damaged, extreme, extreme_value, parameter_value
from judge import TOO_EARLY
from node_session import Session, Settings
from patience import PATIENCE
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import SetParameters
from trial import Outcome, Trial, run_trials
from tries import ACCEPTING

TOGETHER = (
    ("pose_dropped_100", "clock_back", "worker_killed"),
    ("solver_raises", "controller_killed", "disk_full"),
)
OF_A_BUSY_MACHINE = ("rotors turned for", "rotor_trajectory starts", TOO_EARLY)
"""Complaints that a busy machine alone can cause: the controller was not run for a while."""


@pytest.mark.slow
def test_faults_at_once_are_named_and_the_goal_is_reached_within_the_limits(tmp_path) -> None:
    plans = [(tuple(FAULTS[name] for name in names), 0) for names in TOGETHER]
    # Slowly, as the nodes share processors with other tests.
    outcomes = list(run_trials(plans, Settings(rtf=1.0), tmp_path))
    assert [outcome.fault for outcome in outcomes] == [" + ".join(names) for names in TOGETHER]
    for outcome in outcomes:
        assert [c for c in outcome.complaints if not c.startswith(OF_A_BUSY_MACHINE)] == []
        assert outcome.recovery >= 0.0
        assert 0.0 < outcome.worst_speed <= ROBOT.max_rotor_speed * 1.001
        assert 0.0 < outcome.worst_slew <= ROBOT.max_rotor_acceleration * 1.01


def test_json_of_a_campaign_has_a_row_for_each_fault(tmp_path) -> None:
    path = tmp_path / "f.json"
    outcomes = [Outcome("pose_nan", 1.0), Outcome("pose_nan", 3.0, repetition=1), Outcome("tilt")]
    write_json(path, outcomes, {"seed": 0})
    written = json.loads(path.read_text())
    assert written.keys() == {"campaign", "faults", "trials"} and len(written["trials"]) == 3
    first, second = written["faults"]
    assert first["tried"] == first["survived"] == 2
    assert (first["recover_median_s"], first["recover_s"]) == (2.0, 3.0)
    assert second["recover_s"] is None


def test_quick_campaign_has_each_group_and_less_than_half_of_the_faults() -> None:
    quick = chosen(quick=True)
    assert {fault.group for fault in quick} == {fault.group for fault in FAULTS.values()}
    assert len(quick) < len(FAULTS) / 2


TOPICS = {
    "/clock", "/pose", "/goal_pose", "/joint_states", "/rotor_trajectory", "/rotor_commands",
    "/control_period", "/simulator/push", "/controller/active_goal", "/controller/predicted_path",
    "/controller/status", "/diagnostics",
}
"""Topics that the nodes subscribe to, and further ones of the recorder."""
UNKNOWN_TYPE = 99


def drawn_for(name: str) -> random.Random:
    """Return a source of random values that is the same in each run, in whatever order."""
    return random.Random(f"26 {name}")


def disturb_topic(session: Session, topic: str) -> None:
    """Send extreme values and damaged bytes on a topic."""
    rng, valid = drawn_for(topic), session.current_example(topic)
    given = [extreme(rng, session.topics[topic], valid) for _ in range(8)]
    given += [damaged(rng, valid) for _ in range(8)]
    with session.publisher(session.topics[topic], topic, ACCEPTING) as publisher:
        for message in given:
            with suppress(RuntimeError):  # longer than the middleware can send
                publisher.publish(message)
            session.until(lambda: False, 0.01)  # so that also a depth of 1 takes each of them


def disturb_parameters(session: Session) -> None:
    """Set each parameter to values of each type; what is refused, is so with a reason."""
    for node, own in session.parameters.items():
        for name in own:
            rng = drawn_for(f"{node}/{name}")
            values = [parameter_value(rng, ParameterValue(type=kind)) for kind in range(10)]
            results = []
            for several in (values, [ParameterValue(type=UNKNOWN_TYPE)]):
                given = [Parameter(name=name, value=value) for value in several]
                request = SetParameters.Request(parameters=given)
                results += session.call(f"{node}/set_parameters", request).results
            assert len(results) == len(values) + 1
            assert all(result.successful or result.reason for result in results), name
            assert not results[-1].successful and str(UNKNOWN_TYPE) in results[-1].reason


def disturb_services(session: Session) -> None:
    """Request each service with extreme values."""
    for name, kind in session.services.items():
        rng, request = drawn_for(name), kind.Request()
        for field, of in request.get_fields_and_field_types().items():
            setattr(request, field, extreme_value(rng, of))
        session.call(name, request)


def disturb_everything(session: Session) -> Action:
    with session.restored():
        for topic in session.topics:
            disturb_topic(session, topic)
        disturb_parameters(session)
        disturb_services(session)
        yield


@pytest.mark.slow
def test_no_message_parameter_or_request_ends_a_node_or_breaks_a_limit(tmp_path) -> None:
    """Each node still answers, does its work and ends in order; its log has short lines only."""
    pytest.importorskip("viser")
    fault = Fault("everything", "hostile", disturb_everything, duration=0.0, goal_again=True,
                  continuous=False)
    with Session(tmp_path, Settings(rtf=1.0), everything=True) as session:
        assert session.topics.keys() >= TOPICS
        outcome = Trial(session, [fault]).run()
        for process in session.processes:
            process.send(signal.SIGINT)
        codes = {process.name: process.wait(PATIENCE) for process in session.processes}
    # A busy machine alone can cause such a complaint.
    assert [words for words in outcome.complaints if not words.startswith(TOO_EARLY)] == []
    assert codes == dict.fromkeys(session.nodes, 0)
