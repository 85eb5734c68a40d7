# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Proof by evaluation that a spline of the orientation is a bound of the displacement.

A function W(orientation, t) of quadratic B-splines with coefficients at the nodes of the grid
bounds the displacement within t if W_t >= |rate of displacement + rates of the angles . grad W|
for each of `INPUTS` everywhere. Both sides are compared at the centres between nodes, where the
spline is an average of eight coefficients. A bound of the second derivatives of their difference
within each cell, the box of eight centres about a node, covers the rest of it.
"""

import math
from dataclasses import dataclass
from functools import reduce

import numpy as np
from orientation_grid import INPUTS, OrientationGrid

from sphere_nmpc.model.state import Vector

_AXES = range(3)


class Bounds:
    """Bounds of the derivatives of order 0 to 3 of a function, mixed ones included, by row.

    Shape (4, rows). The rules of Leibniz hold for bounds as for derivatives.
    """

    def __init__(self, *orders: float | Vector) -> None:
        self.orders = np.array(np.broadcast_arrays(*map(np.atleast_1d, orders)), dtype=float)

    def __add__(self, other: "Bounds") -> "Bounds":
        return Bounds(*(self.orders + other.orders))

    def __mul__(self, other: "Bounds") -> "Bounds":
        return Bounds(*(
            reduce(np.add, (
                math.comb(order, part) * self.orders[part] * other.orders[order - part]
                for part in range(order + 1)
            ))
            for order in range(4)
        ))

    def times(self, factor: float) -> "Bounds":
        """Return the bounds of a multiple."""
        return Bounds(*(factor * self.orders))


def rate_bounds(grid: OrientationGrid) -> list[Bounds]:
    """Return bounds of the derivatives of the four `Rates` in each row of cells about nodes.

    They hold for both inputs and all longitudes and angles: every factor is a product of sines of
    different angles, a sum of two whose norm is known, or a function of the latitude.
    """
    r1, difference = grid.transverse_ratio, abs(grid.transverse_ratio - grid.axial_ratio)
    # The worst of row i is where it ends, i + 1 steps from the equator.
    cosine = np.cos(grid.step * (np.arange(grid.shape[0] - 1) + 1.0))
    wave = Bounds(*np.ones((4, len(cosine))))
    inputs = wave.times(math.sqrt(2.0))
    # 1 / cos and tan: the derivatives of the latter are less than these multiples of the former.
    inverse = Bounds(1.0 / cosine, 1.0 / cosine**2, 2.0 / cosine**3, 6.0 / cosine**4)
    third = wave
    _, first, second, last = (third * third).times(difference).orders
    floor = 1.0 - max(r1, grid.axial_ratio)
    divisor = Bounds(
        1.0 / floor, first / floor**2, second / floor**2 + 2.0 * first**2 / floor**3,
        last / floor**2 + 6.0 * first * second / floor**3 + 6.0 * first**3 / floor**4,
    )
    turn = inputs * divisor
    about = inputs + (third * wave * turn).times(difference)
    east = inputs + (wave * turn).times(r1)
    north = inputs + (wave.times(r1) + (third * wave).times(difference)) * turn
    return [about, east, north * inverse, about + inverse * north]


@dataclass(frozen=True)
class _Weights:
    """Bounds of the rates with one input in each cell, times h^2 / 8, and 2 for the first ones.

    h^2 / 8 times the sum of the second derivatives along the axes bounds how far a function is
    from the linear interpolation between the corners of a cell.
    """

    own: Vector
    """Sum of the second derivatives of the displacement along the axes."""
    value: list[Vector]
    """By component of the gradient."""
    first: list[list[Vector]]
    """Derivatives, by axis and component."""
    second: list[Vector]
    """Sums of the second derivatives along the axes, by component."""

    @classmethod
    def of(
        cls, grid: OrientationGrid, inputs: tuple[float, float], bounds: list[Bounds]
    ) -> "_Weights":
        """Return those of a grid; see `_cell_bounds`."""
        weight = grid.step**2 / 8.0
        value, first, second = _cell_bounds(grid, inputs, bounds)
        return cls(
            weight * np.sum(second[:, 0], axis=0),
            [weight * value[1 + part] for part in _AXES],
            [[2.0 * weight * first[axis, 1 + part] for part in _AXES] for axis in _AXES],
            [weight * np.sum(second[:, 1 + part], axis=0) for part in _AXES],
        )


_PARTS = 2
"""Points along each axis at which derivatives are taken in a cell."""


def _cell_bounds(
    grid: OrientationGrid, inputs: tuple[float, float], bounds: list[Bounds]
) -> tuple[Vector, Vector, Vector]:
    """Return bounds of the four rates in each cell about a node, without the last row.

    Those of the values, and of first and second derivatives by axis: shapes (4, cells), (3, 4,
    cells) and (3, 4, cells). A cell is divided into parts; in each of them a bound is the
    difference about its centre, and the most that the derivative of the next order adds.
    """
    part = grid.step / _PARTS
    third = np.array([bound.orders[3] for bound in bounds])[:, :, None, None]
    nodes = np.array([each[:-1] for each in grid.nodes()])
    shape = (4, *nodes.shape[1:])
    value, first, second = np.zeros(shape), np.zeros((3, *shape)), np.zeros((3, *shape))
    offset = np.eye(3)
    for place in np.ndindex(*(3 * (_PARTS,))):
        centre = np.array(place) + 0.5 - 0.5 * _PARTS

        def at(shift: Vector, centre: Vector = centre) -> Vector:
            """Return the rates at points of all cells, given in parts from the centre of one."""
            angles = nodes + part * (centre + shift).reshape(3, 1, 1, 1)
            return np.array(grid.rates(inputs, angles))

        middle = at(np.zeros(3))
        ends = [(at(0.5 * each), at(-0.5 * each)) for each in offset]
        # The difference of third order is that of the second derivatives at two points of a part:
        # they are less than a part away along this axis, and half of one along the others.
        along = [np.abs(a - 2.0 * middle + b) / (0.5 * part) ** 2 for a, b in ends]
        across = {}
        for one, other in ((0, 1), (0, 2), (1, 2)):
            plus, minus = 0.5 * (offset[one] + offset[other]), 0.5 * (offset[one] - offset[other])
            change = np.abs(at(plus) + at(-plus) - at(minus) - at(-minus))
            across[one, other] = across[other, one] = change / part**2
        slopes = []
        for axis, (a, b) in enumerate(ends):
            np.maximum(second[axis], along[axis] + 2.0 * part * third, out=second[axis])
            bends = along[axis] + sum(across[axis, other] for other in _AXES if other != axis)
            slopes.append(np.abs(a - b) / part + 0.5 * part * bends + 4.0 * part**2 * third)
            np.maximum(first[axis], slopes[-1], out=first[axis])
        np.maximum(value, np.abs(middle) + 0.5 * part * sum(slopes), out=value)
    return value, first, second


class Supersolution:
    """Comparison of both sides for splines on a grid."""

    def __init__(self, grid: OrientationGrid) -> None:
        self._grid = grid
        self._rates = [grid.rates(inputs, grid.centres()) for inputs in INPUTS]
        bounds = rate_bounds(grid)
        self._weights = [_Weights.of(grid, inputs, bounds) for inputs in INPUTS]

    def at_centres(self, coefficients: Vector) -> Vector:
        """Return the spline at the centres; both of the grid's shape."""
        values = self._grid.mirrored(coefficients)
        for axis in _AXES:
            values = _mean(values, axis)
        return values

    def rates(self, coefficients: Vector) -> Vector:
        """Return the right-hand side with each input at the centres, shape (2, grid's shape)."""
        values = self._grid.mirrored(coefficients)
        level, turned = _mean(values, 0), _mean(values, 2)
        gradient = (
            _mean(_change(turned, 0), 1), _change(_mean(turned, 0), 1),
            _change(_mean(level, 1), 2),
        )
        sides = []
        for rates in self._rates:
            side = rates[0].copy()
            for part in _AXES:
                side += rates[1 + part] * (gradient[part] / self._grid.step)
            sides.append(np.abs(side))
        return np.array(sides)

    def _about_nodes(self, values: Vector) -> Vector:
        """Return the largest of values at the centres about each node, but for the last row."""
        values = np.maximum(values, np.roll(values, 1, 1))
        values = np.maximum(values, np.roll(values, 1, 2))
        return np.maximum(values[:-1], values[1:])

    def remainder(self, coefficients: Vector) -> Vector:
        """Return how much the right-hand side may exceed its centres in each cell about a node.

        The shape is (2, grid's shape without the last row); see `rates`.
        """
        values = self._grid.mirrored(coefficients)

        def derivative(*axes: int) -> Vector:
            """Return the largest derivative along these axes, times h^3 over h^order."""
            scale = self._grid.step ** -len(axes)
            return scale * _largest(values, tuple(axes.count(axis) for axis in _AXES))

        slopes = [derivative(axis) for axis in _AXES]
        bends = {
            (axis, part): derivative(*sorted((axis, part))) for axis in _AXES for part in _AXES
        }
        twists = {
            (axis, part): derivative(axis, axis, part)
            for axis in _AXES for part in _AXES if axis != part
        }
        totals = []
        for weights in self._weights:
            total = weights.own.copy()
            for part in _AXES:
                total += weights.second[part] * slopes[part]
                for axis in _AXES:
                    total += weights.first[axis][part] * bends[axis, part]
                    if axis != part:
                        total += weights.value[part] * twists[axis, part]
            totals.append(total)
        return np.array(totals)

    def bend(self, coefficients: Vector) -> Vector:
        """Return how much a spline may be below its centres in each cell about a node."""
        values = self._grid.mirrored(coefficients)
        parts = (
            _largest(values, tuple(2 * (axis == each) for each in _AXES)) for axis in _AXES
        )
        return reduce(np.add, parts) / 8.0

    def excess(
        self, sides: tuple[Vector, Vector], remainders: tuple[Vector, Vector], change: Vector,
        duration: float,
    ) -> Vector:
        """Return a bound of the right-hand side over the left in each cell during a step.

        Sides and remainders are those at its start and at its end, as of `rates` and `remainder`;
        `change` is that of the coefficients during `duration`. The shape is that of the grid
        without the last row.
        """
        left = self.at_centres(change) / duration
        excesses = [
            self._about_nodes(np.maximum(before, after) - left) + np.maximum(*remainder)
            for before, after, *remainder in zip(*sides, *remainders, strict=True)
        ]
        worst: Vector = np.maximum(*excesses) + self.bend(change) / duration
        return worst


def _mean(values: Vector, axis: int) -> Vector:
    """Return the means of neighbours along an axis; all but the first one are periodic."""
    if axis == 0:
        return 0.5 * (values[1:] + values[:-1])
    return 0.5 * (values + np.roll(values, -1, axis))


def _change(values: Vector, axis: int) -> Vector:
    """Return the differences of neighbours along an axis; all but the first one are periodic."""
    if axis == 0:
        return values[1:] - values[:-1]
    return np.roll(values, -1, axis) - values


def _largest(values: Vector, orders: tuple[int, ...]) -> Vector:
    """Return the largest difference of these orders among the coefficients of each cell.

    `values` has the row beyond the equator; the last row has no cells.
    """
    for axis, order in enumerate(orders):
        for _ in range(order):
            values = _change(values, axis)
    values = np.abs(values)
    for axis, order in enumerate(orders):
        # A cell takes coefficients from three nodes, differences of two pairs, or of three nodes.
        if axis == 0:
            count = values.shape[0] + order - 2
            values = reduce(np.maximum, (values[i : i + count] for i in range(3 - order)))
        else:
            values = reduce(np.maximum, (np.roll(values, 1 - i, axis) for i in range(3 - order)))
    return values
