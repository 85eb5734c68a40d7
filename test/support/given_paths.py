# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Places of paths, each from the origin on, and the path through them."""

import numpy as np

from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.path import Path
from sphere_nmpc.model.state import Vector

RADIUS, TOLERANCE = RobotParameters().shell_radius, 0.02
_TURN = np.linspace(0.0, 2.0 * np.pi, 400)
LINE, CORNER = np.array([[0.0, 0.0], [2.0, 0.0]]), np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]])
CIRCLE = 0.5 * np.column_stack((np.sin(_TURN), 1.0 - np.cos(_TURN)))
EIGHT = np.column_stack((np.sin(_TURN), np.sin(_TURN) * np.cos(_TURN)))
SHAPES = {"line": LINE, "circle": CIRCLE, "eight": EIGHT, "corner": CORNER}
CUSP = np.array([[0.0, 0.0], [0.8, 0.0], [0.3, 0.2]])  # 158 degrees


def path_of(places: Vector, tolerance: float = TOLERANCE) -> Path:
    """Return the only path through places, shape (P, 2)."""
    (path,) = Path.through(places, tolerance, RADIUS)
    return path
