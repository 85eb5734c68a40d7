# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""A node goes on after any error, with one line, for each kind of callback and both executors."""

from concurrent.futures import Future
from typing import Any

import pytest
from geometry_msgs.msg import PoseStamped
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.parameter import Parameter as RosParameter
from rclpy.serialization import serialize_message
from std_srvs.srv import SetBool
from type_description_interfaces.srv import GetTypeDescription

from sphere_nmpc.errors import SphereNmpcError
from sphere_nmpc.ros.controller.node import ControllerNode
from sphere_nmpc.ros.guarded_node import GuardedNode, spin_for
from sphere_nmpc.ros.lifetime import _make_executor

DAMAGED = b"\x00\x01\x00\x00\x07"


def pose(number: int) -> PoseStamped:
    message = PoseStamped()
    message.header.stamp.sec = number
    return message


class Wanting(GuardedNode):
    """Node each callback of which raises on demand."""

    def __init__(self) -> None:
        super().__init__("wanting")
        self.declare_parameter("number", 1)
        self.heard: list[int] = []
        self.ticks = 0
        self.ends = [
            self.create_subscription(PoseStamped, "pose", self._take, 10),
            self.create_subscription(PoseStamped, "raw", self._take_raw, 10, raw=True),
            self.create_timer(0.01, self._tick),
            self.create_service(SetBool, "switch", self._switch),
            self.create_service(SetBool, "later", self._later),
            self.create_subscription(
                PoseStamped, "small", self._take, 10, largest=(100, "a short name")
            ),
        ]
        self.known: Future[bool] = Future()

    def work(self, executor: Executor) -> None:
        spin_for(executor, 0.01)

    def _take(self, message: PoseStamped) -> None:
        if message.header.frame_id:
            raise ValueError(message.header.frame_id)
        self.heard.append(message.header.stamp.sec)

    def _take_raw(self, message: bytes) -> None:
        raise SphereNmpcError(f"raw: given {len(message)} bytes, expected none")

    def _tick(self) -> None:
        self.ticks += 1
        if self.ticks < 10:
            raise KeyError("tick")

    def _later(self, request: SetBool.Request, response: SetBool.Response) -> Any:
        if request.data:
            yield self.known
        response.success = self.known.result(0.0)
        return response

    def _switch(self, request: SetBool.Request, response: SetBool.Response) -> Any:
        if not request.data:
            raise RuntimeError("stuck")
        response.success = True
        return response


@pytest.fixture(params=[True, False], ids=["events executor", "single-threaded executor"])
def wanting(graph, request) -> Wanting:
    """Return the node, which is served by an executor of its own."""
    node, executor = Wanting(), _make_executor(request.param)
    assert isinstance(executor, SingleThreadedExecutor) is not request.param
    graph.serve(node, executor)
    graph._busy.append(node)
    return node


def warnings(capfd) -> list[str]:
    """Return the lines of the node, all of which are warnings."""
    lines = capfd.readouterr().err.splitlines()
    assert all(line.startswith("[WARN] ") for line in lines), lines
    return [line.partition("[wanting]: ")[2] for line in lines]


def test_messages_after_those_that_fail_are_taken_at_once(graph, wanting, capfd) -> None:
    bad = pose(0)
    bad.header.frame_id = "a\n[FATAL] forged" + "x" * 200
    publisher, raw = graph.publisher(PoseStamped, "pose"), graph.publisher(PoseStamped, "raw")
    graph.until(lambda: wanting.ticks >= 12)
    messages = [bad, DAMAGED, bad, DAMAGED, pose(1), DAMAGED, pose(2)]
    for message in messages:  # several at a time, as after a pause of the executor
        publisher.publish(message)
    raw.publish(serialize_message(bad)[:100])
    graph.until(lambda: wanting.heard == [1, 2])
    publisher.publish(pose(3))
    graph.until(lambda: wanting.heard == [1, 2, 3])
    graph.until(lambda: wanting._fault_log.counts["raw refused"] == 1)
    printed = warnings(capfd)
    (failed,) = (line for line in printed if line.startswith("callback failed: "))
    assert failed.startswith("callback failed: KeyError \"'tick'\" (test_guarded_node.py, line ")
    (of_pose,) = (line for line in printed if line.startswith("pose refused: "))
    assert of_pose.startswith("pose refused: ValueError 'a\\n[FATAL] forgedxxx")
    assert len(of_pose) < 200
    assert "raw refused: raw: given 100 bytes, expected none" in printed
    counts = wanting._fault_log.counts
    assert counts["pose refused"] == 5 and counts["callback failed"] == 9


def test_request_that_fails_is_answered_with_the_reason(graph, wanting, capfd) -> None:
    refused = graph.call(SetBool, "switch", data=False)
    assert (refused.success, refused.message) == (False, "RuntimeError 'stuck'")
    assert graph.call(SetBool, "switch", data=True).success
    good = Parameter(name="number", value=ParameterValue(type=2, integer_value=7))
    unknown = Parameter(name="number", value=ParameterValue(type=99))
    several = [good, unknown, unknown]
    results = graph.call(SetParameters, "wanting/set_parameters", parameters=several).results
    assert [result.successful for result in results] == [True, False, False]
    assert "99 is not a valid Parameter.Type" in results[1].reason
    assert results[2].reason == "one before it was refused"
    assert wanting.get_parameter("number").value == 7
    result = graph.call(
        SetParametersAtomically, "wanting/set_parameters_atomically", parameters=[unknown]
    ).result
    assert not result.successful and "99 is not a valid" in result.reason
    described = graph.call(
        GetTypeDescription, "wanting/get_type_description", type_hash="a\n[FATAL] forged",
    )
    assert not described.successful and "a\\n[FATAL] forged" in described.failure_reason
    of_requests = [line for line in warnings(capfd) if "failed" not in line]
    assert [line.partition(":")[0] for line in of_requests] == [
        "switch refused", "wanting/set_parameters refused",
        "wanting/set_parameters_atomically refused", "wanting/get_type_description refused",
    ]


def test_answer_that_has_to_be_waited_for_holds_nothing_up(graph, wanting, capfd) -> None:
    answers = [graph.ask(SetBool, "later", data=True) for _ in range(2)]
    ticks = wanting.ticks
    graph.until(lambda: wanting.ticks > ticks + 20)
    assert not any(answer.done() for answer in answers)
    early = graph.call(SetBool, "later", data=False)
    assert not early.success and early.message.startswith("TimeoutError")
    wanting.known.set_result(True)
    graph.until(lambda: all(answer.done() for answer in answers))
    assert all(answer.result().success for answer in answers)
    wanting.known = Future()
    failing = graph.ask(SetBool, "later", data=True)
    ticks = wanting.ticks
    graph.until(lambda: wanting.ticks > ticks + 20)
    wanting.known.set_exception(KeyError("nothing"))
    graph.until(failing.done)
    assert (failing.result().success, failing.result().message) == (
        False, "KeyError \"'nothing'\""
    )
    refused = [line for line in warnings(capfd) if line.startswith("later refused: ")]
    assert len(refused) == 1 and wanting._fault_log.counts["later refused"] == 2


def test_message_that_is_too_large_is_refused_before_it_is_read(graph, wanting, capfd) -> None:
    publisher = graph.publisher(PoseStamped, "small")
    large = pose(1)
    large.header.frame_id = "x" * 1000
    publisher.publish(large)
    publisher.publish(pose(2))
    graph.until(lambda: wanting.heard == [2])
    (line,) = (line for line in warnings(capfd) if line.startswith("small refused"))
    assert line == "small refused: small: given 1076 bytes, expected at most a short name"


def test_node_whose_constructor_failed_can_be_destroyed(graph, monkeypatch) -> None:
    """As rclpy does from Kilted on when its context ends."""
    made, make = [], GuardedNode.__init__
    monkeypatch.setattr(
        GuardedNode, "__init__", lambda node, *given: (made.append(node), make(node, *given))[1]
    )
    with pytest.raises(SphereNmpcError, match="horizon: given 0"):
        ControllerNode([RosParameter("horizon", value=0)])
    made[0].destroy_node()
