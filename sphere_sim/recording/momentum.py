# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Momentum of a recorded run, from the controller's status messages, and pushes."""

import numpy as np

from sphere_nmpc.model.state import Vector
from sphere_sim.recording.bag_clock import BagClock
from sphere_sim.recording.controller_status import reported_momentum
from sphere_sim.recording.message_fields import stamp_of
from sphere_sim.recording.messages import Messages
from sphere_sim.recording.run import Momentum
from sphere_sim.recording.status_messages import read_statuses


def read_momentum(messages: Messages, robot: str, clock: BagClock) -> Momentum:
    """Return the momentum that a robot's controller reported, and the pushes of its simulator.

    Parameters
    ----------
    messages : Messages
        The bag.
    robot : str
        Namespace of the robot, without a slash at its end.
    clock : BagClock
        The run's clock.
    """
    rows = [
        (time, *reported_momentum(values))
        for time, values in read_statuses(messages, robot, clock)
    ]
    reports: Vector = np.array(rows, dtype=float).reshape(-1, 4)
    reports = reports[np.all(np.isfinite(reports), axis=1)]
    pushes = [
        (clock.time_of_message(stamp_of(message), received), message.vector.x, message.vector.y)
        for topic, entries in messages.decoded.items()
        if topic.startswith(f"{robot}/") and topic.endswith("/pushed")
        for received, message in entries
    ]
    pushed = np.array(pushes, dtype=float).reshape(-1, 3)
    return Momentum(reports[:, 0], reports[:, 1:], pushed[:, 0], pushed[:, 1:])
