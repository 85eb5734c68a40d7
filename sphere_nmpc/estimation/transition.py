# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Transition: two measured poses and the rotor speeds sent in between."""

from dataclasses import dataclass

import numpy as np

from sphere_nmpc.model.state import Vector

_SHORTEST_PIECE = 1e-9
"""Shortest piece of the rotor speeds [s]."""


@dataclass(frozen=True, eq=False)
class Transition:
    """Measured states before and after a motion, and the rotor speeds that caused it.

    Attributes
    ----------
    start, end : ndarray, shape (6,)
        Measured states before and after.
    durations : ndarray, shape (K,)
        Lengths of the straight pieces of the rotor speeds [s].
    inputs : ndarray, shape (K + 1, 2)
        Rotor speeds at their ends [rad/s].
    lead : float
        Time from the start of the pieces to the first state [s]; without it the lag is not
        estimated.
    """

    start: Vector
    end: Vector
    durations: Vector
    inputs: Vector
    lead: float = 0.0

    @property
    def duration(self) -> float:
        """Time between the states [s]."""
        return float(np.sum(self.durations)) - self.lead

    def window(self, lag: float) -> tuple[Vector, Vector]:
        """Return durations (K,) and speeds (K + 1, 2) that moved the sphere at this lag [s]."""
        given = np.concatenate(([0.0], np.cumsum(self.durations)))
        begin = self.lead - min(lag, self.lead)
        end = begin + given[-1] - self.lead
        inside = (given > begin + _SHORTEST_PIECE) & (given < end - _SHORTEST_PIECE)
        times = np.concatenate(([begin], given[inside], [end]))
        speeds = [np.interp(times, given, column) for column in self.inputs.T]
        return np.diff(times), np.column_stack(speeds)
