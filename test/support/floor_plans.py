# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Floors with walls, and the least distance along a path there."""

import numpy as np

from sphere_nmpc.floor.floor import Floor, exact_distance
from sphere_nmpc.floor.occupancy import Grid
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector

RADIUS = RobotParameters().shell_radius
DOORWAY = [(3.0, 0.0, 3.1, 1.6), (3.0, 2.3, 3.1, 4.0)]
"""A wall with a doorway of twice the radius and 0.1 m."""
CLOSED = [(3.0, 0.0, 3.1, 4.0)]
LEVEL, SIDEWAYS = (1.0, 0.0, 0.0, 0.0), (0.5**0.5, 0.5**0.5, 0.0, 0.0)


def pose(x: float, y: float, turn: tuple[float, ...] = LEVEL) -> Vector:
    """Return a pose, shape (6,)."""
    return np.array([x, y, *turn])


def floor_of(walls: list[tuple[float, float, float, float]], clearance: float = 0.02) -> Floor:
    """Floor of 6 m by 4 m with walls (x0, y0, x1, y1) on the lines of its cells of 5 cm."""
    occupied = np.zeros((80, 120), dtype=bool)
    for wall in walls:
        x0, y0, x1, y1 = (round(value / 0.05) for value in wall)
        occupied[y0:y1, x0:x1] = True
    return Floor(Grid(occupied, 0.05), RADIUS, clearance)


def rolled(way: float) -> FirstOrderHold:
    """Hold that rolls the upright sphere by a way along x [m], to rest."""
    rate = RADIUS * RobotParameters().lumped.input_gain
    step = max(0.1, abs(way) / (80.0 * rate))
    return FirstOrderHold(step * np.arange(3), np.outer([0.0, -way / (step * rate), 0.0], [0, 1]))


def least_distance(floor: Floor, places: Vector) -> float:
    """Return the least distance of places, shape (P, 2), to what is occupied [m], 1 at most."""
    return min(exact_distance(floor.grid, place, 1.0) for place in places)
