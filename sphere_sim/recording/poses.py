# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Poses of a recorded run, and the clock of its bag."""

import numpy as np

from sphere_nmpc.model.state import QUATERNION, Vector, are_states
from sphere_sim.recording.bag_clock import BagClock, longest_run
from sphere_sim.recording.errors import BagError
from sphere_sim.recording.message_fields import stamp_of, state_of
from sphere_sim.recording.messages import Messages


def read_poses(messages: Messages, robot: str) -> tuple[BagClock, Vector, Vector]:
    """Return the clock, and times [s], ascending, and states (n, 6) of the longest run.

    Parameters
    ----------
    messages : Messages
        The bag. Notes are added on what is ignored, and messages of other runs are removed.
    robot : str
        Namespace of the robot, without a slash at its end.

    Raises
    ------
    BagError
        If there is no valid pose.
    """
    topic = f"{robot}/pose"
    entries = messages.decoded.get(topic, [])
    if not entries:
        reason = f"no message on {topic}"
        reason = messages.incomplete(reason) if messages.notes else f"is empty: {reason}"
        raise BagError(messages.path, reason)
    states = np.array([state_of(message) for _, message in entries])
    valid = are_states(states)
    if not np.any(valid):
        raise BagError(messages.path, f"no message on {topic} holds a valid pose")
    if not np.all(valid):
        messages.notes.append(f"{topic}: {int(np.sum(~valid))} invalid poses were ignored")
    pairs = [
        (log, stamp_of(it)) for (log, it), use in zip(entries, valid, strict=True) if use
    ]
    run = longest_run([stamp for _, stamp in pairs])
    received, stamps = zip(*pairs[run], strict=True)
    if len(stamps) < len(pairs):
        messages.notes.append(
            f"{topic}: time goes back, so the bag holds several runs; only the longest is used, "
            f"{len(stamps)} of {len(pairs)} poses"
        )
        following = [log for log, _ in pairs[run.stop :]]
        _remove_other_runs(messages, received[0], following[0] if following else None)
    clock = BagClock(received, stamps)
    states = states[valid][run]
    states[:, QUATERNION] /= np.linalg.norm(states[:, QUATERNION], axis=1, keepdims=True)
    # While simulated time is paused, the simulator repeats the pose of that instant.
    times, first = np.unique([clock.time_of_stamp(stamp) for stamp in stamps], return_index=True)
    return clock, times, states[first]


def _remove_other_runs(messages: Messages, first: int, following: int | None) -> None:
    """Remove messages logged in other runs, except earlier goals, which may be in force still."""
    for topic, entries in messages.decoded.items():
        is_goal = topic.endswith(("/goal_pose", "/active_goal"))
        messages.decoded[topic] = [
            (log, message) for log, message in entries
            if (is_goal or log >= first) and (following is None or log < following)
        ]
