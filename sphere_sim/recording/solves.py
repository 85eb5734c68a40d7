# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""What a controller's status messages tell about its solves."""

import math
from typing import Any

import numpy as np

from sphere_sim.recording.bag_clock import BagClock
from sphere_sim.recording.run import Solves
from sphere_sim.recording.stamps import NANOSECONDS

SOLVE_TOPICS = {"status": "diagnostic_msgs/msg/DiagnosticStatus"}


def read_solves(taken: dict[str, list[tuple[int, Any]]], robot: str, clock: BagClock) -> Solves:
    """Return the solves of a robot's controller.

    Parameters
    ----------
    taken : dict of str to list of (int, Any)
        Messages by topic with their log time [ns].
    robot : str
        Namespace of the robot, without a slash at its end.
    clock : BagClock
        The run's clock.
    """
    rows: list[tuple[float, float, float, float, str]] = []
    for topic in sorted(taken):
        if not (topic.startswith(f"{robot}/") and topic.endswith("/status")):
            continue
        for received, message in taken[topic]:
            values = {pair.key: pair.value for pair in message.values}
            duration = _number(values.get("solve_time_s"))
            if "plan" not in values or not duration > 0.0:
                continue  # nothing was solved
            told = _number(values.get("time_s"))
            time = clock.heard(received)
            if math.isfinite(told):
                # Without simulated time the controller counts from its own start.
                time = clock.told(round(told * NANOSECONDS), received)
            rows.append((
                time, duration, _number(values.get("cost")),
                _number(values.get("arrival_s")) - told, values["plan"],
            ))
    table = np.array([row[:4] for row in rows], dtype=float).reshape(-1, 4)
    times, durations, costs, to_go = table.T
    return Solves(times, durations, costs, tuple(row[4] for row in rows), to_go)


def _number(text: str | None) -> float:
    try:
        return float(text) if text is not None else float("nan")
    except ValueError:
        return float("nan")
