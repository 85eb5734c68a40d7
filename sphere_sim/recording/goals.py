# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Goals of a recorded run and the times from which on they were in force."""

import numpy as np

from sphere_nmpc.model.state import QUATERNION, Vector, are_states
from sphere_sim.recording.bag_clock import BagClock
from sphere_sim.recording.message_fields import stamp_of, state_of
from sphere_sim.recording.messages import Messages

_NO_GOALS = np.empty(0), np.empty((0, 6))


def read_goals(
    messages: Messages, robot: str, clock: BagClock, poses: Vector
) -> tuple[Vector, Vector]:
    """Return the times at which goals came into force [s], ascending, and the goals (g, 6).

    Parameters
    ----------
    messages : Messages
        The bag; notes are added on what is missing or ignored.
    robot : str
        Namespace of the robot, without a slash at its end.
    clock : BagClock
        The run's clock.
    poses : ndarray, shape (n,)
        Times of the poses [s], ascending; goals that were in force at none are ignored.
    """
    notes = messages.notes
    # Goals that the controller accepted are preferred to those that were requested.
    accepted = sorted(
        topic for topic in messages.decoded if topic.startswith(f"{robot}/") and
        topic.endswith("/active_goal")
    )
    topic = accepted[0] if accepted else f"{robot}/goal_pose"
    if topic not in messages.decoded:
        notes.append(f"{robot}/goal_pose and active_goal are missing; no errors can be computed")
        return _NO_GOALS
    if len(accepted) > 1:
        notes.append(f"{', '.join(accepted[1:])}: ignored, goals are those of {topic}")
    if not accepted:
        notes.append("active_goal is missing; goal_pose is used instead")
    entries = []
    for received, message in messages.decoded[topic]:
        state = np.array(state_of(message))
        if not are_states(state[None])[0]:
            continue
        state[QUATERNION] /= np.linalg.norm(state[QUATERNION])
        # The controller stamps a goal when it accepts it; stamps set by users mean nothing.
        time = (
            clock.time_of_message(stamp_of(message), received, latched=True) if accepted
            else clock.time_of_log(received)
        )
        entries.append((time, state))
    if len(entries) < len(messages.decoded[topic]):
        count = len(messages.decoded[topic]) - len(entries)
        notes.append(f"{topic}: {count} invalid goals were ignored")
    entries.sort(key=lambda entry: entry[0])
    # A goal that is sent again while it is in force stays in force from the first time on.
    changes = [
        entry for previous, entry in zip([None, *entries], entries, strict=False)
        if previous is None or not np.array_equal(previous[1], entry[1])
    ]
    return _within_run(changes, topic, poses, notes)


def _within_run(
    entries: list[tuple[float, Vector]], topic: str, poses: Vector, notes: list[str]
) -> tuple[Vector, Vector]:
    """Return the goals that were in force at any pose."""
    end = float(poses[-1])
    late = ", ".join(f"{time:.6g}" for time, _ in entries if time > end)
    entries = [entry for entry in entries if entry[0] <= end]
    if late:
        result = "ignored" if entries else "no goal falls inside the recording, nothing to measure"
        notes.append(f"{topic}: goal at {late} s, poses from 0 to {end:.6g} s: {result}")
    if not entries:
        return _NO_GOALS
    times, goals = np.array([time for time, _ in entries]), np.array([goal for _, goal in entries])
    # The first pose of each goal: where two goals share it, only the second was in force.
    kept = np.diff(np.searchsorted(poses, times), append=len(poses)) > 0
    during = np.count_nonzero(~kept & (times >= 0.0))
    if during:
        notes.append(f"{topic}: {during} goals were replaced before the next pose: ignored")
    return times[kept], goals[kept]
