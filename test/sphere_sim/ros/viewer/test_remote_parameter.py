# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Polled parameter whose answers arrive late, without a graph."""

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.parameter import Parameter
from rclpy.task import Future

from sphere_nmpc.settings import ControllerSettings
from sphere_sim.ros.viewer import remote_parameter
from sphere_sim.ros.viewer.remote_parameter import RemoteParameter


class Client:
    """Parameter client whose requests are answered by the test."""

    def __init__(self, *_) -> None:
        self.polls = []

    def services_are_ready(self) -> bool:
        return True

    def get_parameters(self, names, callback) -> None:
        self.polls.append(callback)

    def describe_parameters(self, names, callback) -> None:
        pass

    def set_parameters(self, parameters, callback) -> None:
        self.confirm = callback


def answer(value: str) -> Future:
    future = Future()
    message = Parameter("strategy", value=value).get_parameter_value()
    future.set_result(type("Answer", (), {"values": [message]}))
    return future


def test_answer_to_a_poll_before_a_change_does_not_undo_it(monkeypatch) -> None:
    monkeypatch.setattr(remote_parameter, "AsyncParameterClient", Client)
    parameter = RemoteParameter(None, "controller", "strategy", ControllerSettings, print)
    parameter.refresh()
    parameter.set("paper")
    parameter._client.polls[0](answer("time_optimal"))
    assert parameter.value == "paper"
    parameter._polled = float("-inf")
    parameter.refresh()
    parameter._client.polls[1](answer("plan_keeping"))
    assert parameter.value == "plan_keeping", "what another user has chosen since"


def test_values_of_no_type_and_choices_that_are_none_are_left_out(monkeypatch) -> None:
    monkeypatch.setattr(remote_parameter, "AsyncParameterClient", Client)
    parameter = RemoteParameter(None, "controller", "strategy", ControllerSettings, print)
    parameter.refresh()
    strange = answer("paper")
    strange.result().values[0].type = 99
    parameter._client.polls[0](strange)
    assert parameter.value is None
    described, listed = Future(), "one of: paper, <b>, , paper, time_optimal"
    described.set_result(type("Answer", (), {
        "descriptors": [ParameterDescriptor(additional_constraints=listed)]
    }))
    parameter._take_descriptor(described)
    assert parameter.choices == ("paper", "time_optimal"), "a list with repetitions breaks a page"
