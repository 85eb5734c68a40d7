# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Angular velocity of the shell by the rotors: the balance of momentum, and its derivatives.

The equations are those of `sphere_nmpc.model.dynamics`, without an imbalance, in the body frame.
"""

import numpy as np

from sphere_nmpc.estimation.odometry.inertial_motion import Motion, cross
from sphere_nmpc.estimation.odometry.inertial_state import (
    CONSTANTS,
    MOMENTUM,
    OFFSET,
    PHI,
    SIZE,
    Belief,
)
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector

_UP = np.array([0.0, 0.0, 1.0])


class RotorModel:
    """Balance of momentum of a robot as built, with the constants and the momentum of a belief."""

    def __init__(self, robot: RobotParameters) -> None:
        self._constants = np.array(robot.lumped.as_array()[1:])

    @property
    def gain(self) -> float:
        """Angular velocity of the shell over the speed of a rotor as built, c1 [-]."""
        return float(self._constants[0])

    def rate(self, belief: Belief, turns: Vector, speeds: Vector) -> tuple[Vector, Vector]:
        """Return the angular velocity by the balance of momentum [rad/s; body frame], (..., 3).

        Also the inverse of its matrix, (..., 3, 3). `turns`, (..., 3, 3), are orientations, body
        to world, `speeds`, (..., 2), those of the rotors [rad/s].
        """
        c1, r1, r3 = self._constants * (1.0 + belief.value(CONSTANTS))
        up = turns[..., 2, :]
        inverse = np.linalg.inv(
            np.diag((1.0, 1.0, r1 / r3)) - r1 * up[..., :, None] * up[..., None, :]
        )
        drive = -belief.value(MOMENTUM) @ turns
        drive[..., :2] += speeds
        return -c1 * (inverse @ drive[..., None])[..., 0], inverse

    def mean_rate(
        self, belief: Belief, motion: Motion, speeds: Vector, is_measured: bool
    ) -> tuple[Vector, Vector]:
        """Return the mean angular velocity by the balance of momentum, and its derivative.

        In rad/s and the body frame, shape (3,), by the error at the end, shape (3, 49);
        `is_measured` where the orientations follow from the gyro.
        """
        shares = motion.weights / motion.weights.sum()
        rates, inverses = self.rate(belief, motion.turns, speeds)
        _, r1, r3 = constants = self._constants * (1.0 + belief.value(CONSTANTS))
        turns, up = motion.turns, motion.turns[:, 2, :, None]
        mean: Vector = np.zeros((3, SIZE))
        inverse = shares[:, None, None] * inverses
        # The vertical in the body changes by -R^T (phi x e3), the momentum in it by its own error.
        tilted = turns.transpose(0, 2, 1) @ cross(_UP)
        along = up.transpose(0, 2, 1) @ rates[:, :, None]
        by = up @ (rates[:, None, :] @ tilted) + along * tilted
        tilts = r1 * inverse @ by
        mean[:, PHI] = tilts.sum(axis=0)
        mean[:, MOMENTUM] = constants[0] * (inverse @ turns.transpose(0, 2, 1)).sum(axis=0)
        axial = r1 / r3 * rates[:, :, None] * _UP[:, None]
        mean[:, CONSTANTS] = np.column_stack((
            shares @ rates, (inverse @ (r1 * along * up - axial)).sum(axis=0),
            (inverse @ axial).sum(axis=0),
        ))
        if is_measured:
            turned = motion.turned
            mean += (tilts @ (turned - turned[-1])).sum(axis=0)
        slope = (speeds[-1] - speeds[0]) / motion.weights.sum()
        mean[:, OFFSET] = -constants[0] * inverse.sum(axis=0) @ np.append(slope, 0.0)
        return shares @ rates, mean
