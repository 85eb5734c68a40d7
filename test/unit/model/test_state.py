# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Rotations against SciPy, states, their errors, and sets of goals."""

import casadi as ca
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sphere_nmpc.errors import InvalidStateError
from sphere_nmpc.model import rotation
from sphere_nmpc.model.error_state import apply_error, error_between
from sphere_nmpc.model.goal import Goal, Orientation, moved
from sphere_nmpc.model.state import (
    POSITION,
    QUATERNION,
    Vector,
    angle_error,
    are_states,
    as_state,
    flipped_sign,
    make_state,
    nearer_sign,
    position_error,
    state_error,
    upright_state,
)
from sphere_nmpc.model.symbolic_rotation import (
    quaternion_exponential,
    quaternion_product,
    rotation_matrix,
)

ROUNDING = 1e-15


def states(seed: int, number: int) -> list[Vector]:
    """Return random poses, shape (6,) each."""
    rng = np.random.default_rng(seed)
    return [make_state(rng.normal(size=2), rotation.random_quaternion(rng)) for _ in range(number)]


def scipy_rotation(q: Vector) -> Rotation:
    return Rotation.from_quat(q[..., [1, 2, 3, 0]])


def test_products_and_matrices_are_those_of_scipy() -> None:
    turns = [state[QUATERNION] for state in states(5, 30)]
    for a, b in zip(turns, turns[::-1], strict=True):
        composed = (scipy_rotation(a) * scipy_rotation(b)).as_matrix()
        for found in (rotation.product(a, b), np.array(quaternion_product(a, b)).ravel()):
            np.testing.assert_allclose(scipy_rotation(found).as_matrix(), composed, atol=ROUNDING)
    for q in turns:
        expected, vector = scipy_rotation(q).as_matrix(), np.array([0.3, -1.2, 0.7])
        for found, right in (
            (rotation.matrix(q), expected),
            (np.array(rotation_matrix(ca.DM(q))), expected),
            (rotation.vertical(q), expected[2]),
            (rotation.to_body(q, vector), expected.T @ vector),
            (rotation.product(q, rotation.conjugate(q)), [1.0, 0.0, 0.0, 0.0]),
            (rotation.nearer_sign(rotation.from_matrix(expected), q), q),
        ):
            np.testing.assert_allclose(found, right, atol=ROUNDING)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-9, 1e-4, 0.3, 2.0, 3.0])
def test_exponential_and_logarithm_agree_with_scipy(angle: float) -> None:
    vector = angle * np.array([0.48, -0.6, 0.64])
    expected = Rotation.from_rotvec(vector).as_quat()[[3, 0, 1, 2]]
    q = rotation.exponential(vector)
    np.testing.assert_allclose(q, expected, atol=ROUNDING)
    for sign in (q, -q):
        np.testing.assert_allclose(rotation.logarithm(sign), vector, rtol=1e-14, atol=1e-23)
    if angle <= 2.0:  # up to which the power series is meant
        series = np.array(quaternion_exponential(ca.DM(vector))).ravel()
        np.testing.assert_allclose(series, expected, atol=2e-16)


@pytest.mark.parametrize("size", [0.0, 1e-12, 1e-9, 1e-3, 0.5, 3.0])
@pytest.mark.parametrize("degrees", [5, 8])
def test_error_between_a_state_and_the_changed_state_is_the_one_applied(
    degrees: int, size: float
) -> None:
    rng = np.random.default_rng(1)
    for pose in states(1, 20):
        state, error = np.append(pose, rng.normal(size=degrees - 5)), rng.normal(size=degrees)
        error *= size / np.linalg.norm(error)
        there = apply_error(state, error)
        assert np.linalg.norm(there[2:6]) == pytest.approx(1.0, abs=1e-14)
        for sign in (1.0, -1.0):  # both quaternions are one orientation
            other = np.concatenate((there[:2], sign * there[2:6], there[6:]))
            np.testing.assert_allclose(error_between(state, other), error, atol=1e-12)
        turned = np.linalg.norm(error[2:5])
        assert angle_error(state, there) == pytest.approx(turned, abs=1e-9)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ([0.0] * 5, r"\(5,\)"),
        ([0.0] * 6, "norm 0"),
        ([0, 0, 2, 0, 0, 0], "expected norm 1 .*, not norm 2"),
        ([np.nan, 0, 1, 0, 0, 0], "finite"),
        ([0, 0, 1, 0, np.nan, 0], "finite"),
        ([0, 0, 0.979, 0, 0, 0], r"expected norm 1 within 0\.02, not norm 0\.979"),
        ([0, 0, 1.021, 0, 0, 0], "not norm 1.021"),
        ([0, 0, 0.5, 0, 0, 0], r"given \[0\.5, 0\.0, 0\.0, 0\.0\], expected norm 1 "),
        ([2e6, 0, 1, 0, 0, 0], r"position: given .* expected at most 1e\+06 m"),
        ([0, -1e300, 1, 0, 0, 0], "position"),
    ],
)
def test_invalid_state_is_refused_with_the_given_value(values: list[float], words: str) -> None:
    with pytest.raises(InvalidStateError, match=words):
        as_state(values)
    if len(values) == 6:
        assert not are_states(np.array([values], dtype=float))[0]


@pytest.mark.parametrize(
    ("given", "turn"),
    [
        *(([0.6 * norm, 0.0, -0.8 * norm, 0.0], [0.6, 0.0, -0.8, 0.0])
          for norm in (0.981, 1.0, 1.019)),
        # A quarter turn in two digits.
        *(([part, 0.0, 0.0, part], [0.5**0.5, 0.0, 0.0, 0.5**0.5]) for part in (0.7, 0.71, 0.707)),
    ],
)
def test_quaternion_of_nearly_unit_norm_is_normalised(given, turn) -> None:
    np.testing.assert_allclose(as_state([1.0, 2.0, *given]), [1.0, 2.0, *turn], atol=1e-14)
    assert are_states(np.array([[1.0, 2.0, *given]]))[0]


def test_distances_do_not_depend_on_the_sign_of_either_quaternion() -> None:
    for a, b in zip(states(0, 20), states(1, 20), strict=True):
        for distance in (state_error, angle_error, position_error):
            assert distance(a, b) == pytest.approx(distance(flipped_sign(a), b), abs=1e-15)
            assert distance(a, b) == pytest.approx(distance(a, flipped_sign(b)), abs=1e-15)
        assert nearer_sign(b, a)[2:6] @ a[2:6] >= 0.0


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-6, 0.1, 1.0, 3.0, np.pi - 1e-9, np.pi])
def test_angle_error_is_the_angle_of_the_rotation_even_where_it_is_tiny(angle: float) -> None:
    turn = Rotation.from_rotvec(angle * np.array([0.6, 0.0, 0.8])).as_quat()[[3, 0, 1, 2]]
    # 1e-7 near pi, where the sine has no slope; relative rounding elsewhere.
    found = angle_error(make_state((0.0, 0.0), turn), upright_state(0.0, 0.0, 0.0))
    assert found == pytest.approx(angle, rel=1e-7, abs=1e-15)


def is_member(kind: Orientation, pose: Vector, other: Vector) -> bool:
    """Return whether a pose is in the set of another one, by the geometry of what is demanded."""
    one, another = pose[QUATERNION], other[QUATERNION]
    same = {
        Orientation.FULL: rotation.angle_between(one, another) < 1e-7,
        Orientation.ANY_HEADING: np.allclose(
            rotation.vertical(one), rotation.vertical(another), atol=1e-9
        ),
        Orientation.ANY: True,
    }
    return np.array_equal(pose[POSITION], other[POSITION]) and bool(same[kind])


@pytest.mark.parametrize("kind", Orientation)
def test_nearest_member_is_in_the_set_and_no_drawn_one_is_nearer(kind) -> None:
    pose, *others = states(3, 21)
    over = rotation.product(np.array([0.0, 1.0, 0.0, 0.0]), pose[QUATERNION])
    others = np.array([*others, make_state((1.0, 2.0), over)])
    nearest = [kind.nearest(pose, state) for state in others]
    np.testing.assert_allclose(kind.nearest_of(pose, others), nearest, atol=1e-12)
    assert kind.nearest_of(pose, others[:0]).shape == (0, 6)
    members = kind.draw(np.random.default_rng(0), pose, 200).T
    assert len(members) == (1 if kind is Orientation.FULL else 200)
    assert all(is_member(kind, pose, member) for member in (*members, *nearest))
    for state, found in zip(others, nearest, strict=True):
        least = min(state_error(state, member) for member in members)
        assert state_error(state, found) <= least + 1e-12
    assert state_error(members[0], kind.nearest(pose, members[0])) < 1e-9, "itself"


def test_upside_down_all_headings_are_as_near() -> None:
    pose, turned = upright_state(0.0, 0.0, 0.7), make_state((0.0, 0.0), (0.0, 1.0, 0.0, 0.0))
    found = Orientation.ANY_HEADING.nearest(pose, turned)
    assert state_error(turned, found) == pytest.approx(np.sqrt(2.0))


def test_goals_are_equal_in_what_they_demand() -> None:
    (pose, state), anywhere = states(1, 2), Orientation.ANY
    turned = np.concatenate((pose[POSITION], state[QUATERNION]))
    assert Goal(pose, anywhere).equals(Goal(turned, anywhere))
    assert not Goal(pose).equals(Goal(turned))
    assert not Goal(pose).equals(Goal(pose, anywhere))


def test_goal_moves_at_its_rate() -> None:
    (pose,), rate = states(2, 1), np.array([0.3, -0.1, 0.2, -0.4, 0.5])
    later = Goal(pose, rate=rate, since=2.0).at(4.0)
    np.testing.assert_allclose(later[POSITION], pose[POSITION] + 2.0 * rate[:2])
    angle = rotation.angle_between(pose[QUATERNION], later[QUATERNION])
    assert angle == pytest.approx(2.0 * np.linalg.norm(rate[2:]))
    assert state_error(moved(later, rate, -2.0), pose) < 1e-12
