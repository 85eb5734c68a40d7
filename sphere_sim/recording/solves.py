# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Solves of a recorded run, from the controller's status messages."""

import numpy as np

from sphere_sim.recording.bag_clock import BagClock
from sphere_sim.recording.controller_status import solve_status
from sphere_sim.recording.messages import Messages
from sphere_sim.recording.run import Solves
from sphere_sim.recording.status_messages import read_statuses

_LONGEST = 1e5
"""Duration that no solve has [s]."""


def read_solves(messages: Messages, robot: str, clock: BagClock) -> Solves:
    """Return the solves of a robot's controller.

    Parameters
    ----------
    messages : Messages
        The bag; a note is added if it has no solves.
    robot : str
        Namespace of the robot, without a slash at its end.
    clock : BagClock
        The run's clock.
    """
    rows: list[tuple[float, float, float, float, str]] = []
    for time, values in read_statuses(messages, robot, clock):
        solve = solve_status(values)
        if "plan" not in values or not 0.0 < solve.duration < _LONGEST:
            continue  # nothing was solved at this sample
        rows.append((time, solve.duration, solve.cost, solve.time_to_go, solve.plan))
    if not rows:
        messages.notes.append("no status of the controller reports a solve; no solve times")
    table = np.array([row[:4] for row in rows], dtype=float).reshape(-1, 4)
    times, durations, costs, to_go = table.T
    return Solves(times, durations, costs, tuple(row[4] for row in rows), to_go)
