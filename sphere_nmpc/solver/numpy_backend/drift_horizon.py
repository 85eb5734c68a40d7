# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""States, momenta and sensitivities along a horizon with drift, for the NumPy solver.

Unlike `sphere_nmpc.solver.numpy_backend.horizon` this applies the functions of
`sphere_nmpc.model.integrator` to each step: shorter, and several times slower.
"""

from functools import lru_cache

import casadi as ca
import numpy as np

from sphere_nmpc.model.drift import MOMENTUM, Drift
from sphere_nmpc.model.integrator import drift_step_function, tangent_drift_step_function
from sphere_nmpc.model.state import QUATERNION, Vector
from sphere_nmpc.solver.numpy_backend.rounded_size import rounded_size

_CARRIED = 7
"""Components of a step's start that affect what follows: quaternion and momentum."""

_DIRECTIONS = _CARRIED + 4
"""Those, and the speeds at the start and at the end of the step."""


class DriftHorizon:
    """The intervals of a first-order hold with drift, divided into equal integration steps.

    Parameters
    ----------
    durations : ndarray, shape (N,)
        Interval lengths [s].
    constants : ndarray, shape (4,)
        Lumped constants [Rs, c1, r1, r3].
    max_step : float
        Longest integration step [s].
    drift : ndarray, shape (8,)
        Drift at the start, as an array.

    Attributes
    ----------
    momenta : ndarray, shape (N + 1, 3)
        Momenta at the knots [rad/s; world frame], results of the last call of `states`.
    """

    def __init__(
        self, durations: Vector, constants: Vector, max_step: float, drift: Vector
    ) -> None:
        counts = np.maximum(1.0, np.ceil(durations / max_step - 1e-6)).astype(np.int64)
        self._ends = np.cumsum(counts)
        self._interval = np.repeat(np.arange(durations.size), counts)
        place = np.arange(self._interval.size) - (self._ends - counts)[self._interval]
        self._share_start = place / counts[self._interval]
        self._share_end = (place + 1.0) / counts[self._interval]
        # Steps of no length fill the horizon up to a size for which there is a function.
        self._size = rounded_size(self._interval.size)
        self._h = np.zeros((1, self._size))
        self._h[0, : self._interval.size] = (durations / counts)[self._interval]
        self._parameters = [
            np.tile(column[:, None], self._size) for column in (constants, drift[3:])
        ]
        self._drift = drift
        self._speeds = np.zeros((2, 2, self._size))
        self.momenta: Vector = np.zeros((durations.size + 1, 3))

    def states(self, state: Vector, inputs: Vector) -> Vector:
        """Return the states at the knots, (N + 1, 6), from `state`, (6,), on.

        `inputs` are the knots u_0 ... u_N [rad/s], shape (N + 1, 2).
        """
        first, change = inputs[self._interval], np.diff(inputs, axis=0)[self._interval]
        for speeds, share in zip(
            self._speeds, (self._share_start, self._share_end), strict=True
        ):
            speeds[:, : share.size] = (first + share[:, None] * change).T
        steps = _step_function(self._size)
        momentum = self._drift[MOMENTUM]
        ends = steps(state, momentum, *self._speeds, self._h, *self._parameters)
        along, momenta = (
            np.vstack((start, np.array(end).T))
            for start, end in zip((state, momentum), ends, strict=True)
        )
        self._starts = along[:-1, QUATERNION].T, momenta[:-1].T
        at_knots = np.concatenate(([0], self._ends))
        self.momenta = momenta[at_knots]
        states: Vector = along[at_knots]
        return states

    def sensitivities(self) -> Vector:
        """Return d x_m / d (u_1 ... u_N) per rad/s, (N + 1, 6, 2 N), of the last `states`."""
        n = self._ends.size
        arguments = [*self._starts, *self._speeds, self._h, *self._parameters]
        seeds = np.split(np.tile(np.eye(_DIRECTIONS), self._size), (4, _CARRIED, _CARRIED + 2))
        found = _tangent_function(self._size)(*arguments, *seeds)[3:]
        local = np.vstack([np.array(part) for part in found])
        local = local.reshape(2 + _CARRIED, self._size, _DIRECTIONS).transpose(1, 0, 2)
        by_knots = np.zeros((n + 1, 2 + _CARRIED, 2 * (n + 1)))
        along = by_knots[0].copy()
        for i, m in enumerate(self._interval):
            a, b = self._share_start[i], self._share_end[i]
            start, end = local[i, :, _CARRIED : _CARRIED + 2], local[i, :, _CARRIED + 2 :]
            after = local[i, :, :_CARRIED] @ along[2:]
            after[:2] += along[:2]
            after[:, 2 * m : 2 * m + 2] += (1.0 - a) * start + (1.0 - b) * end
            after[:, 2 * m + 2 : 2 * m + 4] += a * start + b * end
            along = by_knots[m + 1] = after
        # The knot in force is given.
        sensitivities: Vector = by_knots[:, :6, 2:]
        return sensitivities


def roll_out(
    state: Vector, drift: Drift, inputs: Vector, durations: Vector, constants: Vector,
    max_step: float,
) -> tuple[Vector, Vector]:
    """Predict on NumPy; see `sphere_nmpc.solver.roll_out.roll_out_with_momentum`."""
    horizon = DriftHorizon(durations, constants, max_step, drift.as_array())
    return horizon.states(state, inputs), horizon.momenta


@lru_cache(maxsize=64)
def _step_function(steps: int) -> ca.Function:
    """Return S steps of `drift_step_function`, each from the end of the one before."""
    return drift_step_function().mapaccum("steps", steps, 2)


@lru_cache(maxsize=64)
def _tangent_function(steps: int) -> ca.Function:
    return tangent_drift_step_function(_DIRECTIONS).map(steps)
