# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Status messages of a recorded robot's controller, with their times."""

import math
from collections.abc import Iterator

from sphere_nmpc.quantity import NANOSECONDS
from sphere_sim.recording.bag_clock import BagClock
from sphere_sim.recording.controller_status import number
from sphere_sim.recording.messages import Messages


def read_statuses(
    messages: Messages, robot: str, clock: BagClock
) -> Iterator[tuple[float, dict[str, str]]]:
    """Yield time [s] and key-value pairs of each status message.

    Parameters
    ----------
    messages : Messages
        The bag.
    robot : str
        Namespace of the robot, without a slash at its end.
    clock : BagClock
        The run's clock.
    """
    for topic in sorted(messages.decoded):
        if not (topic.startswith(f"{robot}/") and topic.endswith("/status")):
            continue
        for received, message in messages.decoded[topic]:
            values = {pair.key: pair.value for pair in message.values}
            yield _time(values, received, clock), values


def _time(values: dict[str, str], received: int, clock: BagClock) -> float:
    time = number(values, "time_s")
    if math.isfinite(time):
        # Without simulated time the controller counts from its own start.
        return clock.time_of_message(round(time * NANOSECONDS), received)
    return clock.time_of_log(received)
