# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""States, momenta and sensitivities along a horizon with drift, for the NumPy solver.

Unlike `sphere_nmpc.solver.numpy_backend.horizon` this applies the functions of
`sphere_nmpc.model.integrator` to each step: shorter, and several times slower.
"""

from functools import cache, lru_cache
from typing import Any

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
        # Steps of no length fill the horizon up to a size for which there are functions.
        size = rounded_size(self._interval.size)
        self._speeds, self._h = np.zeros((2, size, 2)), np.zeros(size)
        self._h[: self._interval.size] = (durations / counts)[self._interval]
        self._x, self._along = np.zeros((size + 1, 6)), np.zeros((size + 1, 3))
        self._along[0] = drift[MOMENTUM]
        parameters = [np.tile(values, (size, 1)) for values in (constants, drift[3:])]
        given = [*self._speeds, self._h, *parameters]
        self._shoot = _Call(
            _step_function(size), [self._x[0], self._along[0], *given],
            [self._x[1:], self._along[1:]],
        )
        self._given = given
        self._tangents: _Tangents | None = None
        self.momenta: Vector = np.zeros((durations.size + 1, 3))

    def states(self, state: Vector, inputs: Vector) -> Vector:
        """Return the states at the knots, (N + 1, 6), from `state`, (6,), on.

        `inputs` are the knots u_0 ... u_N [rad/s], shape (N + 1, 2).
        """
        first, change = inputs[self._interval], np.diff(inputs, axis=0)[self._interval]
        for speeds, share in zip(
            self._speeds, (self._share_start, self._share_end), strict=True
        ):
            speeds[: share.size] = first + share[:, None] * change
        self._x[0] = state
        self._shoot.run()
        at_knots = np.concatenate(([0], self._ends))
        self.momenta = self._along[at_knots]
        states: Vector = self._x[at_knots]
        return states

    def sensitivities(self) -> Vector:
        """Return d [x_m, h_m] / d (u_1 ... u_N) per rad/s, (N + 1, 9, 2 N), of the last call."""
        n = self._ends.size
        if self._tangents is None:
            self._tangents = _Tangents(self._given)
        local = self._tangents.at(self._x[:-1, QUATERNION], self._along[:-1])
        by_knots = np.zeros((n + 1, 2 + _CARRIED, 2 * (n + 1)))
        along = by_knots[0]
        for i, m in enumerate(self._interval):
            a, b = self._share_start[i], self._share_end[i]
            start, end = local[i, :, _CARRIED : _CARRIED + 2], local[i, :, _CARRIED + 2 :]
            after = local[i, :, :_CARRIED] @ along[2:]
            after[:2] += along[:2]
            after[:, 2 * m : 2 * m + 2] += (1.0 - a) * start + (1.0 - b) * end
            after[:, 2 * m + 2 : 2 * m + 4] += a * start + b * end
            along = by_knots[m + 1] = after
        # The knot in force is given.
        sensitivities: Vector = by_knots[:, :, 2:]
        return sensitivities


class _Tangents:
    """Derivatives of each step by its start, and by the speeds at its start and end."""

    def __init__(self, given: list[Vector]) -> None:
        steps, rows = given[0].shape[0], (2, 4, 3)
        self._starts = [np.zeros((steps, 4)), np.zeros((steps, 3))]
        seeds = [
            np.tile(seed.T, (steps, 1, 1))
            for seed in np.split(np.eye(_DIRECTIONS), (4, _CARRIED, _CARRIED + 2))
        ]
        self._found = [np.zeros((steps, _DIRECTIONS, n)) for n in rows]
        ends = [np.zeros((steps, n)) for n in rows]
        self._call = _Call(
            _tangent_function(steps), [*self._starts, *given, *seeds], [*ends, *self._found]
        )

    def at(self, quaternions: Vector, momenta: Vector) -> Vector:
        """Return the derivatives of [x, y, q, h] at the ends, (S, 9, 11)."""
        self._starts[0][:], self._starts[1][:] = quaternions, momenta
        self._call.run()
        return np.concatenate(self._found, axis=2).swapaxes(1, 2)


class _Call:
    """A function with arrays for its arguments and results, each matrix transposed.

    Without a conversion of arguments, within which CasADi would lose an interrupt by Ctrl-C.
    """

    def __init__(self, function: ca.Function, given: list[Vector], results: list[Vector]) -> None:
        self._arrays = given, results
        self._buffer: Any
        self._buffer, self.run = function.buffer()
        for i, array in enumerate(given):
            self._buffer.set_arg(i, array.data)
        for i, array in enumerate(results):
            self._buffer.set_res(i, array.data)


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
    """Return `_tangent_step` of S steps."""
    return _tangent_step().map(steps)


@cache
def _tangent_step() -> ca.Function:
    """Return `tangent_drift_step_function` with common subexpressions once: a quarter faster."""
    function = tangent_drift_step_function(_DIRECTIONS)
    arguments = function.sx_in()
    return ca.Function(function.name(), arguments, ca.cse(function.call(arguments)))
