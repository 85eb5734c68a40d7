# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Random input sequences, their runs on a plant, and deviations between runs."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.rotation import random_quaternion
from sphere_sim.world.disturbances import DisturbanceSettings
from sphere_sim.world.plant.rigid_body.rigid_body_plant import RigidBodyPlant
from sphere_sim.world.plant.rigid_body.settings import RigidBodySettings

ROBOT = RobotParameters()
KNOT_PERIOD = 0.5
KNOTS = 10
STEP = 0.01
"""Step of the simulator between two samples of the command [s]."""

SLIPPING = 1e-3
"""Speed of the shell over the floor from which it counts as slipping [m/s]."""


Alteration = Callable[[Any], None]
"""Changes a compiled MuJoCo model in place."""


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


def angles_between(states: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Return the angles between two runs, step by step [rad], shape (steps,)."""
    near = np.linalg.norm(states[:, 2:] - reference[:, 2:], axis=1)
    far = np.linalg.norm(states[:, 2:] + reference[:, 2:], axis=1)
    return 4.0 * np.arcsin(np.minimum(1.0, 0.5 * np.minimum(near, far)))


def deviation(states: np.ndarray, reference: np.ndarray) -> tuple[float, float]:
    """Return the largest distance [m] and angle [rad] between two runs."""
    distance = np.linalg.norm(states[:, :2] - reference[:, :2], axis=1)
    return float(distance.max()), float(angles_between(states, reference).max())


@dataclass(frozen=True)
class Comparison:
    """Deviation of a set of runs from the ideal plant's.

    Attributes
    ----------
    position_median, position_worst : float
        Largest distance within a run [m].
    angle_median, angle_worst : float
        Largest angle within a run [rad].
    slipping : float
        Share of all steps at whose end the shell slipped [-].
    wall : float
        Wall time over simulated time [-].
    """

    position_median: float
    position_worst: float
    angle_median: float
    angle_worst: float
    slipping: float
    wall: float

    def row(self, name: str) -> str:
        """Return a line of a Markdown table."""
        return (
            f"| {name} | {1e3 * self.position_median:.3g} | {1e3 * self.position_worst:.3g} "
            f"| {1e3 * self.angle_median:.3g} | {1e3 * self.angle_worst:.3g} "
            f"| {100 * self.slipping:.1f} | {1e3 * self.wall:.0f} |"
        )


HEADER = (
    "| plant | position, median [mm] | worst | angle, median [mrad] | worst "
    "| slipping [% of time] | cost [ms/s] |\n|---|---|---|---|---|---|---|"
)


def compare(
    sequences: list[Sequence],
    reference: list[np.ndarray],
    settings: RigidBodySettings,
    alter: Alteration | None = None,
    disturbances: DisturbanceSettings | None = None,
) -> Comparison:
    """Compare runs of all sequences on the plant with contact with those of the ideal plant."""
    plant = RigidBodyPlant(ROBOT, sequences[0].start, settings, disturbances)
    if alter is not None:
        alter(plant._model)
    distances, slips, wall = [], [], 0.0
    for sequence, ideal in zip(sequences, reference, strict=True):
        plant.reset(sequence.start)
        states = []
        for speeds, _ in steps_of(sequence):
            began = time.perf_counter()
            plant.advance(speeds, STEP)
            wall += time.perf_counter() - began
            states.append(plant.state)
            slips.append(np.linalg.norm(plant.slip) > SLIPPING)
        distances.append(deviation(np.array(states), ideal))
    position, angle = np.array(distances).T
    return Comparison(
        float(np.median(position)), float(position.max()),
        float(np.median(angle)), float(angle.max()),
        float(np.mean(slips)), wall / (len(sequences) * KNOTS * KNOT_PERIOD),
    )  # fmt: skip
