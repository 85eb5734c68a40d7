# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Momentum of a recorded run, from the controller's status messages, and pushes."""

import numpy as np

from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector
from sphere_sim.recording.bag_clock import BagClock
from sphere_sim.recording.controller_status import reported_drift, reported_momentum
from sphere_sim.recording.message_fields import known, stamp_of
from sphere_sim.recording.messages import Messages
from sphere_sim.recording.run import Momentum
from sphere_sim.recording.status_messages import read_statuses


def read_momentum(
    messages: Messages, robot: str, clock: BagClock, parameters: RobotParameters
) -> Momentum:
    """Return the momentum that a robot's controller reported, and the pushes of its simulator.

    Parameters
    ----------
    messages : Messages
        The bag.
    robot : str
        Namespace of the robot, without a slash at its end.
    clock : BagClock
        The run's clock.
    parameters : RobotParameters
        Those of the robot's controller, which define the units of the model.
    """
    reports = [
        (time, reported_momentum(values), drift)
        for time, values in read_statuses(messages, robot, clock)
        if (drift := reported_drift(values, parameters)) is not None
    ]
    pushes = [
        (clock.time_of_message(stamp_of(message), received),
         known(message.vector.x), known(message.vector.y))
        for topic, entries in messages.decoded.items()
        if topic.startswith(f"{robot}/") and topic.endswith("/pushed")
        for received, message in entries
    ]
    pushed: Vector = np.array(pushes, dtype=float).reshape(-1, 3)
    pushed = pushed[np.all(np.isfinite(pushed), axis=1)]
    return Momentum(
        np.array([time for time, _, _ in reports]),
        np.array([momentum for _, momentum, _ in reports]).reshape(-1, 3),
        tuple(drift for _, _, drift in reports),
        pushed[:, 0],
        pushed[:, 1:],
    )
