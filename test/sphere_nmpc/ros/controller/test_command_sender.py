# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The final ramp is sampled up to rest, on a clock of its own and within a limited time."""

import time

import numpy as np
import pytest
from std_msgs.msg import Float64MultiArray

from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.ros.controller.command_sender import CommandSender

LAUNCH_PATIENCE = 5.0
"""Wall time after which launch kills a process that it has asked to end [s]."""


@pytest.fixture
def slept(graph, monkeypatch) -> list[float]:
    """Return the list of all sleeps [s], in which messages are received instead."""
    sleeps: list[float] = []

    def sleep(duration: float) -> None:
        sleeps.append(duration)
        graph.spin()

    monkeypatch.setattr(time, "sleep", sleep)
    return sleeps


def commands_of_final_ramp(graph, duration: float) -> np.ndarray:
    """Return the speeds sent at the end while a ramp of that duration [s] is in force."""
    received = graph.collect(Float64MultiArray, "rotor_commands")
    sender = CommandSender(graph.probe, 100.0, lambda: None)
    graph.probe.destroy_timer(sender._timer)
    graph.until(lambda: sender._speeds.get_subscription_count() > 0)
    sender.send(FirstOrderHold(np.array([3.0, 3.0 + duration]), np.array([[80, 40], [0, 0]])), 0)
    sender.send_final_ramp(3.0)
    graph.until(lambda: received and not any(received[-1].data))
    return np.array([message.data for message in received])


def test_final_ramp_is_sampled_at_the_command_rate_and_ends_at_rest(graph, slept) -> None:
    speeds = commands_of_final_ramp(graph, duration=0.2)
    np.testing.assert_allclose(speeds[:20, 0], np.arange(80.0, 0.0, -4.0), atol=1e-6)
    np.testing.assert_allclose(speeds[20:], 0.0, atol=1e-6)
    assert sum(slept) == pytest.approx(0.2, abs=0.011)


def test_final_ramp_that_would_take_too_long_is_cut_off_at_rest(graph, slept) -> None:
    speeds = commands_of_final_ramp(graph, duration=60.0)
    assert sum(slept) < 0.5 * LAUNCH_PATIENCE
    assert not speeds[-1].any()
