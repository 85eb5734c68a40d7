# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Theorem 1, the rank with fourth-order brackets, and the measure of controllability."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sphere_nmpc.model.controllability import (
    bracket_matrix,
    controllability,
    distance_to_circle,
)
from sphere_nmpc.model.dynamics import state_rate
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector, as_state
from sphere_sim.scenario.scenarios import PAPER_CASES

ROBOT = RobotParameters()


def state_at(latitude: float, longitude: float, heading: float) -> Vector:
    """Return a state whose contact point has these angles [rad] on the shell."""
    k = np.array([
        np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude),
        np.sin(latitude),
    ])
    upright, _ = Rotation.align_vectors([[0.0, 0.0, 1.0]], [k])
    turn = Rotation.from_euler("z", heading) * upright
    return as_state(np.concatenate(([0.4, -1.1], turn.as_quat()[[3, 0, 1, 2]])))


@pytest.mark.parametrize("latitude", [1e-3, 0.1, 0.7, 1.5])
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_brackets_of_three_fields_span_everything_off_the_circle(
    latitude: float, side: float
) -> None:
    rng = np.random.default_rng(1)
    for _ in range(20):
        state = state_at(side * latitude, *rng.uniform(-np.pi, np.pi, 2))
        result = controllability(state, ROBOT.lumped)
        # 1e-8: the rounding of a quaternion near a contact point on the axis of the rotors' plane.
        assert result.distance_to_circle == pytest.approx(latitude, abs=1e-8)
        assert result.rank3 == 5
        assert result.rank4 == 5


def test_brackets_of_three_fields_lose_one_direction_on_the_circle_and_four_regain_it() -> None:
    rng = np.random.default_rng(2)
    for _ in range(50):
        state = state_at(0.0, *rng.uniform(-np.pi, np.pi, 2))
        result = controllability(state, ROBOT.lumped)
        assert result.distance_to_circle < 1e-14
        assert result.rank3 == 4
        assert result.rank4 == 5
        # Rounding of numbers of order 20.
        assert result.smallest_singular_value < 1e-13


def test_growth_of_the_span_is_2_3_5_off_the_circle_and_2_3_4_5_on_it() -> None:
    for latitude, growth in ((0.5, (2, 3, 5, 5)), (0.0, (2, 3, 4, 5))):
        brackets = bracket_matrix(state_at(latitude, 0.3, 1.2), ROBOT.lumped)
        ranks = tuple(
            int(np.linalg.matrix_rank(brackets[:, :columns], tol=1e-9))
            for columns in (2, 3, 5, 8)
        )
        assert ranks == growth


def test_first_bracket_agrees_with_a_finite_difference_of_the_fields() -> None:
    p = ROBOT.lumped.as_array()
    rng = np.random.default_rng(3)
    for _ in range(10):
        state = state_at(*rng.uniform(-1.5, 1.5, 3))

        def field(x: Vector, u: list[float]) -> Vector:
            return np.array(state_rate(x, np.array(u), p)).ravel() / p[1]

        g1, g2 = field(state, [1.0, 0.0]), field(state, [0.0, 1.0])
        h = 1e-5
        slope2 = field(state + h * g1, [0.0, 1.0]) - field(state - h * g1, [0.0, 1.0])
        slope1 = field(state + h * g2, [1.0, 0.0]) - field(state - h * g2, [1.0, 0.0])
        bracket = (slope2 - slope1) / (2.0 * h)
        w, v = state[2], state[3:6]
        rotation = 2.0 * (w * bracket[3:6] - v * bracket[2] - np.cross(v, bracket[3:6]))
        expected = np.concatenate((bracket[:2] / p[0], rotation))
        # Central differences: h^2 times a third derivative of order 10, and rounding / h.
        np.testing.assert_allclose(
            bracket_matrix(state, ROBOT.lumped)[:, 2], expected, atol=1e-8
        )


def test_measure_depends_on_the_distance_from_the_circle_alone() -> None:
    rng = np.random.default_rng(4)
    for latitude in (0.01, 0.4, 1.2):
        found = [
            controllability(
                state_at(side * latitude, *rng.uniform(-np.pi, np.pi, 2)), ROBOT.lumped
            ).smallest_singular_value
            for side in (-1.0, 1.0)
            for _ in range(10)
        ]
        # Rounding of a singular value beside one of order 20.
        np.testing.assert_allclose(found, found[0], atol=1e-12)


def test_measure_rises_with_the_distance_at_first_by_the_documented_slope() -> None:
    latitudes = np.linspace(0.0, np.pi / 2, 40)
    values = [
        controllability(state_at(a, 0.2, 0.1), ROBOT.lumped).smallest_singular_value
        for a in latitudes
    ]
    assert np.all(np.diff(values) > 0.0)
    near = controllability(state_at(1e-3, 0.2, 0.1), ROBOT.lumped).smallest_singular_value
    assert near / 1e-3 == pytest.approx(1.13, abs=0.01)


@pytest.mark.parametrize(("case", "goal"), [(1, np.pi / 2), (2, 0.0), (3, np.pi / 2), (4, 0.0)])
def test_goals_of_the_paper_cases_lie_where_the_paper_says(case: int, goal: float) -> None:
    assert distance_to_circle(PAPER_CASES[case].goal) == pytest.approx(goal, abs=1e-12)


@pytest.mark.parametrize(
    ("case", "least", "most"),
    # The starts of cases 2 and 4 are on the circle; case 4 is printed with four digits.
    [(1, 0.1, 1.5), (2, 0.0, 1e-12), (3, 0.1, 1.5), (4, 0.0, 1e-4)],
)
def test_starts_of_the_paper_cases_lie_on_the_circle_or_off_it_as_the_paper_says(
    case: int, least: float, most: float
) -> None:
    assert least <= distance_to_circle(PAPER_CASES[case].start) <= most


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_state_that_is_not_finite_gives_no_number_and_no_error(bad: float) -> None:
    result = controllability(np.full(6, bad), ROBOT.lumped)
    assert np.isnan(result.distance_to_circle)
    assert (result.rank3, result.rank4) == (0, 0)


def test_no_symbolic_expression_is_built_again_for_each_status_message(monkeypatch) -> None:
    first = controllability(PAPER_CASES[1].start, ROBOT.lumped)
    monkeypatch.delattr("casadi.Function")
    monkeypatch.delattr("casadi.SX")
    assert controllability(PAPER_CASES[1].start, ROBOT.lumped) == first
