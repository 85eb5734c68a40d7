# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Integration steps of a horizon and the states along it, for the NumPy solver."""

import threading
from typing import Any

import numpy as np

from sphere_nmpc.model.drift import Drift
from sphere_nmpc.model.state import POSITION, QUATERNION, Vector
from sphere_nmpc.solver.numpy_backend import drift_horizon
from sphere_nmpc.solver.numpy_backend.rounded_size import rounded_size
from sphere_nmpc.solver.numpy_backend.shooting import (
    BY_KNOTS,
    COLUMN,
    SENSITIVITY,
    shooting_function,
)

_MEMORY = threading.local()


def roll_out(
    state: Vector, drift: Drift, inputs: Vector, durations: Vector, constants: Vector,
    max_step: float,
) -> tuple[Vector, Vector]:
    """Predict on NumPy; see `sphere_nmpc.solver.roll_out.roll_out_with_momentum`."""
    if not drift.is_zero:
        return drift_horizon.roll_out(state, drift, inputs, durations, constants, max_step)
    states = Horizon(durations, constants, max_step).states(state, inputs)
    return states, np.zeros((durations.size + 1, 3))


class Horizon:
    """The intervals of a first-order hold, each divided into equal integration steps.

    Parameters
    ----------
    durations : ndarray, shape (N,)
        Interval lengths [s].
    constants : ndarray, shape (4,)
        Lumped constants [Rs, c1, r1, r3].
    max_step : float
        Longest integration step [s].
    scales : ndarray, shape (N,), optional
        Factors of the displacement of each interval.

    Attributes
    ----------
    begins, last : ndarray of int, shape (N,)
        Indices of the first and the last step of each interval.
    steps : int
        S, the number of all steps.
    columns : ndarray, shape (S, COLUMN)
        What `shooting_function` is given for each step.
    shooting : Shooting
        Results of the last call of `states`; shared by the horizons of a thread whose numbers of
        steps have the same `rounded_size`.
    """

    def __init__(
        self, durations: Vector, constants: Vector, max_step: float, scales: Vector | None = None
    ) -> None:
        counts = np.maximum(1.0, np.ceil(durations / max_step - 1e-6))
        steps = counts.astype(np.int64)
        ends = np.cumsum(steps)
        self.begins, self.last = ends - steps, ends - 1
        interval = np.repeat(np.arange(durations.size), steps)
        self.steps = int(ends[-1])
        self.shooting = _shooting_of(rounded_size(self.steps))
        radius, c1, r1, r3 = constants
        place = np.arange(self.steps) - self.begins[interval]
        columns = self.shooting.columns
        columns[:] = 0.0
        self.columns = columns[: self.steps]
        self.columns[:, 4] = (durations / counts)[interval]
        self.columns[:, 5:8] = r1, r3, radius
        if scales is not None:
            self.columns[:, 7] *= scales[interval]
        self.columns[:, 8] = place / counts[interval]
        self.columns[:, 9] = (place + 1.0) / counts[interval]
        # Where the knots of each step are among all numbers of all knots.
        self._knots_of_step = 2 * interval[:, None] + np.arange(4)
        self._to_free = -c1

    def states(self, state: Vector, inputs: Vector) -> Vector:
        """Return the states at the knots, (N + 1, 6), from `state`, (6,), on.

        `inputs` are the knots u_0 ... u_N [rad/s], shape (N + 1, 2).
        """
        shooting = self.shooting
        self.columns[:, :4] = (self._to_free * inputs).take(self._knots_of_step)
        shooting.q[:] = state[QUATERNION]
        shooting.run()
        states: Vector = np.empty((self.last.size + 1, 6))
        states[0] = state
        displacement = shooting.moved.cumsum(axis=1)[:, self.last]
        states[1:, POSITION] = displacement.T + state[POSITION]
        states[1:, QUATERNION] = shooting.q_end[self.last]
        return states


class Shooting:
    """Arguments and results of `shooting_function` for a number of steps; for one thread."""

    def __init__(self, steps: int) -> None:
        self.q, self.columns = np.zeros(4), np.zeros((steps, COLUMN))
        self.q_end, self.moved = np.zeros((steps, 4)), np.zeros((2, steps))
        self.by_knots = np.zeros((BY_KNOTS, steps))
        self.sensitivities = np.zeros((SENSITIVITY, steps))
        # Addresses are passed once: converting arguments would take longer than many steps.
        self._buffer: Any
        self._buffer, self.run = shooting_function(steps).buffer()
        for i, given in enumerate((self.q, self.columns)):
            self._buffer.set_arg(i, given.data)
        for i, result in enumerate((self.q_end, self.moved, self.by_knots, self.sensitivities)):
            self._buffer.set_res(i, result.data)


def _shooting_of(steps: int) -> Shooting:
    kept: dict[Any, Any] = _MEMORY.__dict__
    if steps not in kept:
        kept[steps] = Shooting(steps)
    found: Shooting = kept[steps]
    return found
