# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Rotor speeds, torques and plans of a recorded run, from joint states and trajectories."""

from collections.abc import Sequence

import numpy as np

from sphere_nmpc.errors import InvalidInputError
from sphere_nmpc.foreign_text import shown
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.state import Vector
from sphere_sim.recording.bag_clock import BagClock
from sphere_sim.recording.errors import BagError
from sphere_sim.recording.message_fields import known, stamp_of
from sphere_sim.recording.messages import Messages

ROTORS = ("rotor_1_joint", "rotor_2_joint")
"""Joint names of the rotors."""


def read_joint_states(
    messages: Messages, robot: str, clock: BagClock
) -> tuple[Vector, Vector, Vector]:
    """Return times [s], rotor speeds (m, 2) [rad/s] and torques (m, 2) [N m].

    Parameters
    ----------
    messages : Messages
        The bag; a note is added if it has no joint states.
    robot : str
        Namespace of the robot, without a slash at its end.
    clock : BagClock
        The run's clock.

    Raises
    ------
    BagError
        If the topic has other joints only.
    """
    topic = f"{robot}/joint_states"
    entries = messages.decoded.get(topic, [])
    rows = []
    for entry in entries:
        message = entry[1]
        names = list(message.name)
        if not set(ROTORS) <= set(names):
            # Other joints of a robot, such as grippers, may use the same topic.
            continue
        order = [names.index(name) for name in ROTORS]
        rows.append([
            clock.time_of_stamp(stamp_of(message)),
            *_select(message.velocity, order),
            *_select(message.effort, order),
        ])
    if entries and not rows:
        names = list(entries[0][1].name)
        raise BagError(
            messages.path,
            f"{topic} names {shown(names)}, not {list(ROTORS)}: a bag of another robot",
        )
    if not rows:
        messages.notes.append(f"{topic} is missing; no rotor speeds and torques")
    table = np.array(rows, dtype=float).reshape(-1, 5)
    times, first = np.unique(table[:, 0], return_index=True)
    return times, table[first, 1:3], table[first, 3:5]


def read_plans(messages: Messages, robot: str, clock: BagClock) -> tuple[FirstOrderHold, ...]:
    """Return the plans that the controller sent, knot times in the run's time [s].

    Parameters
    ----------
    messages : Messages
        The bag; notes are added on what is missing or ignored.
    robot : str
        Namespace of the robot, without a slash at its end.
    clock : BagClock
        The run's clock.
    """
    topic = f"{robot}/rotor_trajectory"
    entries = messages.decoded.get(topic, [])
    if not entries:
        messages.notes.append(f"{topic} is missing; no plans")
    plans = []
    for received, message in entries:
        names = list(message.joint_names)
        if set(names) != set(ROTORS):
            continue
        start = clock.time_of_message(stamp_of(message), received, latched=True)
        order = [names.index(name) for name in ROTORS]
        offsets = [
            point.time_from_start.sec + 1e-9 * point.time_from_start.nanosec
            for point in message.points
        ]
        speeds = [_select(point.velocities, order) for point in message.points]
        try:
            plans.append(FirstOrderHold(start + np.array(offsets), np.array(speeds)))
        except InvalidInputError:
            continue  # the simulator refuses it as well
    if len(plans) < len(entries):
        count = len(entries) - len(plans)
        messages.notes.append(f"{topic}: {count} invalid trajectories were ignored")
    return tuple(plans)


def _select(values: Sequence[float], order: Sequence[int]) -> list[float]:
    """Return values by index; nan where a message has fewer values than names, see `known`."""
    return [known(values[i]) if i < len(values) else float("nan") for i in order]
