# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Largest displacement in one direction within a time, by orientation: a table that bounds it.

The displacement is that with rotor speeds within the limits and any orientation at the end. It
is computed by dynamic programming, and raised wherever `Supersolution` finds it too small, so that
the table is a bound whatever the size of the grid; proof and units: docs/time_bound.md.
"""

import math

import numpy as np
from orientation_grid import INPUTS, OrientationGrid
from scipy.sparse import csr_matrix
from supersolution import Supersolution

from sphere_nmpc.model.state import Vector
from sphere_sim.study.displacement_table import FASTEST

_STEP = 0.6
"""Step of time over that of the grid; the sphere rotates by up to eight times as much."""
_HELD = (1, 2, 6)
"""Steps of time for which inputs are held."""
_PARTS = 3
"""Steps in which such a motion is integrated."""
_OVERLAP = 6
"""Rows of the grid that belong to the cap as well; more than averages reach."""
_AVERAGES = (1, 2, 2, 2, 2)
"""Strides of the averages that make the spline smooth."""
_CORRECTIONS = 3
"""Corrections in each step."""
_ROUNDING = 1e-9
"""Rounding of the rates that are compared, which are of the order of one to ten."""


class _Moves:
    """Displacement and orientation after inputs that are held, from all nodes."""

    def __init__(self, grid: OrientationGrid, duration: float, to_cap: float) -> None:
        self._grid, self._to_cap = grid, to_cap
        self.moves = [
            self._moved(inputs, sign * duration) for inputs in INPUTS for sign in (1.0, -1.0)
        ]
        """Displacements, and matrices that interpolate values at the nodes and that of the cap."""

    def _moved(self, inputs: tuple[float, float], duration: float) -> tuple[Vector, csr_matrix]:
        # The opposite inputs for a time are these for the opposite time, and reverse everything.
        angles = np.array(self._grid.nodes())
        moved = np.zeros_like(angles[0])
        in_cap = np.zeros(moved.shape, dtype=bool)
        step = duration / _PARTS

        def rates(at: Vector) -> Vector:
            at[0] = np.clip(at[0], -1.5, 1.5)
            return np.array(self._grid.rates(inputs, at))

        for _ in range(_PARTS):
            in_cap |= np.abs(angles[0]) >= self._to_cap
            first = rates(angles.copy())
            second = rates(angles + 0.5 * step * first[1:])
            third = rates(angles + 0.5 * step * second[1:])
            fourth = rates(angles + step * third[1:])
            change = step / 6.0 * (first + 2.0 * (second + third) + fourth)
            change[:, in_cap] = 0.0
            moved += change[0]
            angles += change[1:]
        in_cap |= np.abs(angles[0]) >= self._to_cap
        return moved.ravel(), self._interpolation(angles, in_cap)

    def _interpolation(self, angles: Vector, in_cap: Vector) -> csr_matrix:
        grid = self._grid
        _, longitudes, turns = grid.shape
        angles = np.where(in_cap, 0.0, angles) / grid.step - 0.5
        nodes = np.floor(angles).astype(np.int32)
        shares = angles - nodes
        columns, weights = [], []
        for corner in np.ndindex(2, 2, 2):
            row, longitude, turn = (nodes[axis] + corner[axis] for axis in range(3))
            longitude = np.where(row < 0, -1 - longitude, longitude) % longitudes
            row = np.where(row < 0, -1 - row, row)
            weight = np.ones(grid.shape)
            for axis in range(3):
                weight = weight * (shares[axis] if corner[axis] else 1.0 - shares[axis])
            columns.append((row * longitudes + longitude) * turns + turn % turns)
            weights.append(np.where(in_cap, 0.0, weight))
        columns.append(np.full(grid.shape, grid.size))
        weights.append(in_cap.astype(float))
        matrix = csr_matrix(
            (
                np.stack(weights, -1).ravel(), np.stack(columns, -1).ravel(),
                np.arange(0, 9 * grid.size + 1, 9),
            ),
            shape=(grid.size, grid.size + 1),
        )
        matrix.eliminate_zeros()
        return matrix


class DisplacementSteps:
    """The table of a grid, step by step from zero on.

    Attributes
    ----------
    time : float
        The present time.
    coefficients : ndarray
        Those of the spline, of the grid's shape. The bound is the spline plus `added`.
    cap : float
        The same about the pole, where all orientations have one bound: this plus `added`.
    added : float
        Sum of what is missing in the steps so far.
    excess : ndarray
        What is missing in the rate of the last step, by cell; see `Supersolution.excess`.
    """

    def __init__(self, grid: OrientationGrid) -> None:
        self.grid = grid
        self.step = _STEP * grid.step
        self.check = Supersolution(grid)
        self.time = self.cap = self.added = self._growth = 0.0
        self.coefficients: Vector = np.zeros(grid.shape)
        self.excess: Vector = np.zeros((grid.shape[0] - 1, *grid.shape[1:]))
        # The first of the rows that belong to the cap as well is half a step beyond this latitude.
        self._edge = (grid.shape[0] - _OVERLAP) * grid.step
        self._cap_rate = largest_rate_of_cap(grid, self._edge)
        self._moves = {
            count: _Moves(grid, count * self.step, self._edge).moves for count in _HELD
        }
        self._values: list[Vector] = [np.zeros(grid.size + 1)]
        self._side = self.check.rates(self.coefficients)
        self._remainder = self.check.remainder(self.coefficients)

    def advance(self) -> None:
        """Make a step of time."""
        grid, before = self.grid, self.coefficients
        values = self._values[-1][:-1].copy()
        for count, moves in self._moves.items():
            if count <= len(self._values):
                for moved, interpolation in moves:
                    np.maximum(values, moved + interpolation @ self._values[-count], out=values)
        self.time += self.step
        values = np.minimum(values, FASTEST * self.time).reshape(grid.shape)
        cap = self.cap + self._growth
        for left in reversed(range(_CORRECTIONS + 1)):
            cap, after = self._closed(values, cap)
            side = self.check.rates(after)
            if left in (0, _CORRECTIONS):
                remainder = self.check.remainder(after)
            self.excess = self.check.excess(
                (self._side, side), (self._remainder, remainder), after - before, self.step
            )
            if left:
                missing = np.concatenate((self.excess, self.excess[-1:])).clip(0.0)
                values = values + self.step * grid.smoothed(missing)
        self.added += self.step * (max(0.0, float(np.max(self.excess))) + _ROUNDING)
        self._growth = cap - self.cap
        self.coefficients, self.cap = after, cap
        self._side, self._remainder = side, remainder
        self._values.append(np.append(values.ravel(), cap))
        del self._values[: -max(_HELD)]

    def _closed(self, values: Vector, cap: float) -> tuple[float, Vector]:
        """Return the bound of the cap and the coefficients of the spline.

        Where the cap begins its bound is not below the spline, and where the grid ends it is not
        above. `cap` is the bound as it will presumably be.
        """
        values[-_OVERLAP:] = cap
        after = values
        for stride in _AVERAGES:
            after = self.grid.smoothed(after, stride)
        begins = after[-_OVERLAP - 1 : -_OVERLAP + 1]
        cap = max(self.cap + self.step * self._cap_rate, float(np.max(begins)))
        values[-_OVERLAP:] = cap
        after[-1] = np.maximum(after[-1], 2.0 * cap - after[-2])
        return cap, after


def largest_rate_of_cap(grid: OrientationGrid, latitude: float) -> float:
    """Return a bound of the speed in the direction of interest beyond a latitude.

    It is that of `Rates.displacement`, with its factors at their largest.
    """
    r1, r3 = grid.transverse_ratio, grid.axial_ratio
    ratio = abs(r1 - r3) / (1.0 - max(r1, r3))
    return FASTEST * math.cos(latitude) * (1.0 + ratio)
