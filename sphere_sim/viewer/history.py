# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Time series of the last seconds of a run, for the plots."""

from collections import deque

import numpy as np

from sphere_nmpc.model.state import Vector, angle_error, position_error
from sphere_sim.viewer.frame import Frame

NAMES = (
    "time", "distance", "angle", "speed_1", "speed_2", "torque_1", "torque_2", "cost", "to_go",
    "solve_ms", "momentum_x", "momentum_y", "momentum_z",
)


class History:
    """Time series of at most `limit` points, thinned from the frames of a run.

    Parameters
    ----------
    window : float, optional
        Length of the series [s].
    limit : int, optional
        Most points of a series.
    """

    def __init__(self, window: float = 30.0, limit: int = 400) -> None:
        self._window = window
        self._spacing = window / limit
        self._rows: deque[tuple[float, ...]] = deque()

    def add(self, frame: Frame) -> None:
        """Add a frame; one of a restarted run deletes the series first."""
        if frame.restarted:
            self._rows.clear()
        if frame.state is None or (
            self._rows and frame.time < self._rows[-1][0] + self._spacing
        ):
            return
        goal = frame.goal
        self._rows.append((
            frame.time,
            np.nan if goal is None else position_error(frame.state, goal),
            np.nan if goal is None else angle_error(frame.state, goal),
            *map(float, frame.rotor_speeds), *map(float, frame.rotor_torques),
            frame.cost, frame.to_go, 1e3 * frame.solve_time,
            *map(float, frame.momentum),
        ))
        while self._rows[0][0] < frame.time - self._window:
            self._rows.popleft()

    def series(self) -> dict[str, Vector]:
        """Return the series by name, all of one length; nan where a value is unknown."""
        table = np.array(self._rows, dtype=float).reshape(-1, len(NAMES))
        return dict(zip(NAMES, table.T, strict=True))
