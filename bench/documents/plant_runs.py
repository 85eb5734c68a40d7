# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Runs of a plant on rotor speeds that ramp between knots, and deviations between runs."""

from typing import Any

import numpy as np

from sphere_nmpc.model.state import POSITION, Vector
from sphere_sim.evaluation.metrics import angle_errors

STEP = 0.01
"""Step of the simulator between two samples of the command [s]."""
KNOT_PERIOD = 0.5
"""Length of a ramp, where it is not said [s]."""


def ramped(knots: Vector, steps: int = round(KNOT_PERIOD / STEP)) -> Vector:
    """Return the speeds at the start and after each step of ramps from rest to knots, (K, 2)."""
    knots = np.vstack((np.zeros(2), knots))
    shares = (np.arange(steps) + 1.0)[:, None] / steps
    ends = knots[:-1, None] + shares * np.diff(knots, axis=0)[:, None]
    return np.vstack((np.zeros(2), ends.reshape(-1, 2)))


def run(plant: Any, speeds: Vector, step: float = STEP) -> Vector:
    """Return the states of a plant after each step of `ramped` speeds, shape (steps, 6)."""
    states = []
    for there in speeds[1:]:
        plant.advance(there, step)
        states.append(plant.state)
    return np.array(states)


def deviation(states: Vector, reference: Vector) -> tuple[float, float]:
    """Return the largest distance [m] and angle [rad] between two runs."""
    distance = np.linalg.norm(states[:, POSITION] - reference[:, POSITION], axis=1)
    return float(distance.max()), float(angle_errors(states, reference).max())
