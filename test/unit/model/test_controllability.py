# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Theorem 1, the rank with fourth-order brackets, and the measure of controllability."""

import numpy as np
import pytest
from lie_brackets import bracket_matrix
from scipy.spatial.transform import Rotation

from sphere_nmpc.model import rotation
from sphere_nmpc.model.controllability import (
    controllability,
    distance_to_circle,
    third_order_brackets,
)
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import QUATERNION, Vector, as_state

LUMPED = RobotParameters().lumped


def state_at(latitude: float, longitude: float, heading: float) -> Vector:
    """Return a state whose contact point has these angles [rad] on the shell."""
    k = np.array([
        np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude),
        np.sin(latitude),
    ])
    upright, _ = Rotation.align_vectors([[0.0, 0.0, 1.0]], [k])
    turn = Rotation.from_euler("z", heading) * upright
    return as_state(np.concatenate(([0.4, -1.1], turn.as_quat()[[3, 0, 1, 2]])))


def growth(state: Vector) -> tuple[int, ...]:
    """Return the rank of the span of one, two, three and four fields."""
    brackets = bracket_matrix(state, LUMPED)
    return tuple(
        int(np.linalg.matrix_rank(brackets[:, :n], tol=1e-6 * np.linalg.norm(brackets[:, :n], 2)))
        for n in (2, 3, 5, 8)
    )


@pytest.mark.parametrize("latitude", [0.0, 1e-3, -0.1, 0.7, -1.5])
def test_brackets_of_three_fields_lose_one_direction_on_the_circle_and_four_regain_it(
    latitude: float,
) -> None:
    rng, is_on_circle = np.random.default_rng(2), latitude == 0.0
    for _ in range(30):
        state = state_at(latitude, *rng.uniform(-np.pi, np.pi, 2))
        assert growth(state) == ((2, 3, 4, 5) if is_on_circle else (2, 3, 5, 5))
        # 1e-8: the rounding of a quaternion near a contact point on the axis of the rotors' plane.
        assert distance_to_circle(state) == pytest.approx(abs(latitude), abs=1e-8)
        result = controllability(state, LUMPED)
        # Rounding of numbers of order 20.
        assert (result.smallest_singular_value < 1e-13) == is_on_circle
        assert not is_on_circle or result.distance_to_circle < 1e-14


def test_brackets_agree_with_those_that_casadi_differentiates() -> None:
    rng = np.random.default_rng(4)
    for _ in range(30):
        state = state_at(*rng.uniform(-1.5, 1.5, 3))
        mass, radius = rng.uniform((0.5, 0.2), (2.0, 0.6))
        robot = RobotParameters(shell_mass=mass, shell_radius=radius, shell_inertia=0.02)
        turn = rotation.matrix(state[QUATERNION])
        found = third_order_brackets(turn[2], robot.lumped)
        displacement = turn @ found[3:]
        # Rounding of numbers of order 100, in either frame.
        np.testing.assert_allclose(
            np.vstack((displacement[:2], found[:3])), bracket_matrix(state, robot.lumped)[:, :5],
            atol=1e-11,
        )
        np.testing.assert_allclose(displacement[2], 0.0, atol=1e-12)
