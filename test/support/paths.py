# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Paths of the ideal sphere without momentum, and how far states are from them."""

from collections.abc import Iterable

import numpy as np

from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector
from sphere_nmpc.solver.roll_out import roll_out

_CONSTANTS = RobotParameters().lumped.as_array()


def moved(
    start: Vector, hold: FirstOrderHold, since: float, until: float, spacing: float
) -> Vector:
    """Return the states from `start`, (9,), on along a hold, at knots and `spacing` [s] apart."""
    knots = np.array(hold.knots_between(since, until))
    times = np.unique(np.concatenate((np.arange(since, until, spacing), knots, [until])))
    return roll_out(start, hold.resampled(times).speeds, np.diff(times), _CONSTANTS, spacing)


def largest_distance(points: Iterable[Vector], path: Vector) -> float:
    """Return the largest distance of points from a path of straight pieces, both in R^n."""
    way = np.diff(path, axis=0)
    length = np.maximum(np.sum(way * way, axis=1), 1e-18)
    largest = 0.0
    for point in points:
        share = np.clip(np.sum((point - path[:-1]) * way, axis=1) / length, 0.0, 1.0)
        near = path[:-1] + share[:, None] * way
        largest = max(largest, float(np.min(np.linalg.norm(near - point, axis=1))))
    return largest
