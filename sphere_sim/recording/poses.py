# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Poses of a recorded run, and its clock: what of their stamps can be used."""

import numpy as np
from numpy.typing import NDArray

from sphere_nmpc.model.state import POSE_SIZE, QUATERNION, Vector, are_states
from sphere_nmpc.quantities import NANOSECONDS
from sphere_sim.evaluation.series import Series
from sphere_sim.recording.bag_clock import (
    OTHER_CLOCK,
    TOLERANCE,
    BagClock,
    longest_run,
    stand_still,
)
from sphere_sim.recording.bag_files import BagError
from sphere_sim.recording.messages import Messages

_Stamps = NDArray[np.int64]
_TOLERANCE = round(TOLERANCE * NANOSECONDS)


def read_poses(messages: Messages, topic: str) -> tuple[BagClock, Series]:
    """Return the clock, and the poses of the longest run.

    Messages of other runs are removed.
    """
    entries = messages.decoded.get(topic, [])
    given = [message.state for _, message in entries]
    states: Vector = np.array(given, dtype=float).reshape(-1, POSE_SIZE)
    valid = are_states(states)
    if not np.any(valid):
        reason = f"no message on {topic}" + (" holds a valid pose" if entries else "")
        if messages.notes:
            reason = messages.incomplete(reason)
        elif not entries:
            reason = f"is empty: {reason}"
        raise BagError(messages.path, reason)
    if not np.all(valid):
        messages.notes.append(f"{topic}: {int(np.sum(~valid))} invalid poses were ignored")
    run, stamps = read_series(messages, topic, states, valid, "poses")
    states = states[run]
    clock = BagClock([entries[i][0] for i in run], stamps)
    states[:, QUATERNION] /= np.linalg.norm(states[:, QUATERNION], axis=1, keepdims=True)
    # While simulated time is paused, the simulator repeats the pose of that instant.
    times = np.array([clock.time_of_stamp(stamp) for stamp in stamps])
    return clock, Series.of_numbers(times, states)


def read_series(
    messages: Messages, topic: str, values: Vector, valid: NDArray[np.bool_], noun: str
) -> tuple[list[int], list[int]]:
    """Return which messages of a topic are of its longest run and have a time, and the times [ns].

    `values` is what the messages hold, shape (n, k), of which those that are `valid` can be used;
    `noun` is how notes call them. Messages of other runs are removed, of all topics.
    """
    entries = messages.decoded.get(topic, [])
    used = np.flatnonzero(valid)
    logs, stamps = np.array(
        [(entries[i][0], entries[i][1].stamp) for i in used], dtype=np.int64
    ).reshape(-1, 2).T
    kept, stamps = _usable(messages, topic, logs, stamps, values[used], noun)
    used, logs, stamps = used[kept], logs[kept], stamps[kept]
    run = longest_run(stamps)
    if run.stop - run.start < len(stamps):
        messages.notes.append(
            f"{topic}: time goes back, so the bag holds several runs; only the longest is used, "
            f"{run.stop - run.start} of {len(stamps)} {noun}"
        )
        following = int(logs[run.stop]) if run.stop < len(logs) else None
        _remove_other_runs(messages, int(logs[run.start]), following)
    return used[run].tolist(), stamps[run].tolist()


def _usable(
    messages: Messages, topic: str, logs: _Stamps, stamps: _Stamps, values: Vector, noun: str
) -> tuple[NDArray[np.bool_], _Stamps]:
    """Return which messages have a usable time, and the times of all [ns]."""
    lacking = _without_stamp(stamps)
    count, number = len(stamps), int(np.sum(lacking))
    why = f"{number} of {count} {noun} have the stamp 0" if 2 * number >= count else ""
    if not why and stand_still(logs[~lacking], stamps[~lacking], values[~lacking]):
        why = f"the stamps of the {noun} do not advance as a time does"
    if why:
        if count > 1 and logs.min() == logs.max():
            reason = f"{topic}: none of the {noun} has a stamp or a log time of its own"
            raise BagError(messages.path, reason)
        messages.notes.append(
            f"{topic}: {why}, so that their log times are used, which are later by the time that "
            "they took to the recorder"
        )
        return np.ones(count, dtype=bool), logs
    if number:
        messages.notes.append(f"{topic}: {number} {noun} with the stamp 0 were ignored")
    usable = ~lacking
    usable[usable] = np.abs(stamps[usable] - np.median(stamps[usable])) < OTHER_CLOCK * NANOSECONDS
    # A stamp that jumps away from its neighbours, in the same direction ...
    rest = np.flatnonzero(usable)
    jumps = _jumps(logs[rest], stamps[rest])
    usable[rest[1:-1][jumps[:-1] * jumps[1:] < 0]] = False
    # ... or at an end, where it would make the run as much longer.
    rest = np.flatnonzero(usable)
    jumps = _jumps(logs[rest], stamps[rest])
    if len(rest) > 2:
        usable[rest[0]] = not (jumps[0] and not jumps[1])
        usable[rest[-1]] = not (jumps[-1] and not jumps[-2])
    if other := count - number - int(np.sum(usable)):
        messages.notes.append(
            f"{topic}: {other} {noun} were ignored, whose stamps are far from those around them"
        )
    return usable, stamps


def _jumps(logs: _Stamps, stamps: _Stamps) -> NDArray[np.int64]:
    """Return the direction of each step of the stamps that no gap in the recording explains."""
    steps = np.diff(stamps)
    found: NDArray[np.int64] = np.sign(steps) * (np.abs(steps) > _TOLERANCE + np.diff(logs))
    return found


def _without_stamp(stamps: _Stamps) -> NDArray[np.bool_]:
    """Return which stamps of 0 are not the beginning of simulated time."""
    present = np.flatnonzero(stamps)
    if not present.size:
        return np.ones(len(stamps), dtype=bool)
    following = np.searchsorted(present, np.arange(len(stamps))).clip(max=present.size - 1)
    found: NDArray[np.bool_] = (stamps == 0) & (stamps[present[following]] > _TOLERANCE)
    return found


def _remove_other_runs(messages: Messages, first: int, following: int | None) -> None:
    """Remove messages of other runs, except earlier goals and floors, which may be in force."""
    for topic, entries in messages.decoded.items():
        stays = topic.endswith(("/goal_pose", "/active_goal", "/floor"))
        messages.decoded[topic] = [
            (log, message) for log, message in entries
            if (stays or log >= first) and (following is None or log < following)
        ]
