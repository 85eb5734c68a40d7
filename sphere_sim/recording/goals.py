# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Which goals were in force in a recorded run, and from when on."""

from typing import Any

import numpy as np

from sphere_nmpc.model.state import QUATERNION, QUATERNION_NORM_TOLERANCE, Vector
from sphere_sim.recording.bag_clock import BagClock
from sphere_sim.recording.stamps import stamp_of, state_of

NO_GOALS = np.empty(0), np.empty((0, 6))


def read_goals(
    taken: dict[str, list[tuple[int, Any]]],
    robot: str,
    clock: BagClock,
    end: float,
    notes: list[str],
) -> tuple[Vector, Vector]:
    """Return when goals came into force [s], in order, and the goals (g, 6).

    Parameters
    ----------
    taken : dict of str to list of (int, Any)
        Messages by topic with their log time [ns].
    robot : str
        Namespace of the robot, without a slash at its end.
    clock : BagClock
        The run's clock.
    end : float
        Time of the last pose [s]; a goal that came later is left out.
    notes : list of str
        Takes what is missing or left out.
    """
    # What the controller accepted counts; what was asked for is second best.
    accepted = sorted(
        topic for topic in taken if topic.startswith(f"{robot}/") and
        topic.endswith("/active_goal")
    )
    topic = accepted[0] if accepted else f"{robot}/goal_pose"
    if topic not in taken:
        notes.append(f"{robot}/goal_pose and active_goal are missing; no errors can be told")
        return NO_GOALS
    if len(accepted) > 1:
        notes.append(f"{', '.join(accepted[1:])}: left out, goals are those of {topic}")
    if not accepted:
        notes.append("active_goal is missing; goal_pose is taken instead")
    entries = []
    for received, message in taken[topic]:
        state = np.array(state_of(message))
        norm = float(np.linalg.norm(state[QUATERNION]))
        if not (np.all(np.isfinite(state)) and abs(norm - 1.0) <= QUATERNION_NORM_TOLERANCE):
            continue
        state[QUATERNION] /= norm
        # The controller tells when it took the goal; what a user typed as a stamp does not.
        told = clock.told(stamp_of(message), received, kept=True) if accepted else None
        entries.append((clock.heard(received) if told is None else told, state))
    if len(entries) < len(taken[topic]):
        count = len(taken[topic]) - len(entries)
        notes.append(f"{topic}: {count} goals are no poses and were left out")
    entries.sort(key=lambda entry: entry[0])
    # A goal that is sent again while it is in force is confirmed, and goes on from the first time.
    fresh = [
        entry for before, entry in zip([None, *entries], entries, strict=False)
        if before is None or not np.array_equal(before[1], entry[1])
    ]
    return _inside(fresh, topic, end, notes)


def _inside(
    entries: list[tuple[float, Vector]], topic: str, end: float, notes: list[str]
) -> tuple[Vector, Vector]:
    """Return the goals that were in force at any pose."""
    late = ", ".join(f"{time:.6g}" for time, _ in entries if time > end)
    kept = [entry for entry in entries if entry[0] <= end]
    if late:
        what = "left out" if kept else "no goal falls inside the recording, nothing to measure"
        notes.append(f"{topic}: goal at {late} s, poses from 0 to {end:.6g} s: {what}")
    if not kept:
        return NO_GOALS
    return np.array([time for time, _ in kept]), np.array([state for _, state in kept])
