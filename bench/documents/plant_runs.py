# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Random input sequences, their runs on a plant, and deviations between runs."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.rotation import random_quaternion
from sphere_sim.evaluation.metrics import angle_errors

ROBOT = RobotParameters()
KNOT_PERIOD = 0.5
KNOTS = 10
STEP = 0.01
"""Step of the simulator between two samples of the command [s]."""


@dataclass(frozen=True, eq=False)
class Sequence:
    """A start at rest, shape (6,), and rotor speeds each half second, shape (KNOTS + 1, 2)."""

    start: np.ndarray
    speeds: np.ndarray


def draw_sequences(number: int, seed: int) -> list[Sequence]:
    """Draw orientations uniform on SO(3) and knots uniform in +-u_max; the first knot is zero."""
    sequences = []
    for i in range(number):
        rng = np.random.default_rng([seed, i])
        start = np.concatenate(([0.0, 0.0], random_quaternion(rng)))
        limit = ROBOT.max_rotor_speed
        knots = rng.uniform(-limit, limit, (KNOTS, 2))
        sequences.append(Sequence(start, np.vstack((np.zeros(2), knots))))
    return sequences


def steps_of(sequence: Sequence) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return the reference at the end of each step and its slope within it."""
    steps = []
    per_knot = round(KNOT_PERIOD / STEP)
    for here, there in zip(sequence.speeds[:-1], sequence.speeds[1:], strict=True):
        for i in range(per_knot):
            share = (i + 1) / per_knot
            steps.append((here + share * (there - here), (there - here) / KNOT_PERIOD))
    return steps


def run(plant: Any, sequence: Sequence) -> np.ndarray:
    """Return the states after each step, shape (steps, 6)."""
    states = []
    for speeds, _ in steps_of(sequence):
        plant.advance(speeds, STEP)
        states.append(plant.state)
    return np.array(states)


def deviation(states: np.ndarray, reference: np.ndarray) -> tuple[float, float]:
    """Return the largest distance [m] and angle [rad] between two runs."""
    distance = np.linalg.norm(states[:, :2] - reference[:, :2], axis=1)
    return float(distance.max()), float(angle_errors(states, reference).max())
