# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""State vectors: layout, refused values, and distances to a goal."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sphere_nmpc.errors import InvalidStateError
from sphere_nmpc.model.state import (
    angle_error,
    are_states,
    as_state,
    flipped_sign,
    nearer_sign,
    position_error,
    state_error,
    upright_state,
)

ORIGIN = [0.0, 0.0, 1.0, 0.0, 0.0, 0.0]


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
        ([0, 0, *[np.nan] * 4], "finite"),
        ([2e6, 0, 1, 0, 0, 0], r"position: given .* expected at most 1e\+06 m"),
        ([0, -1e300, 1, 0, 0, 0], "position"),
    ],
)
def test_invalid_state_is_refused_with_the_given_value(
    values: list[float], words: str
) -> None:
    with pytest.raises(InvalidStateError, match=words):
        as_state(values)
    if len(values) == 6:
        assert not are_states(np.array([values], dtype=float))[0]


@pytest.mark.parametrize("norm", [0.981, 1.0, 1.019])
def test_quaternion_of_nearly_unit_norm_is_normalised(norm: float) -> None:
    given = [1.0, 2.0, 0.6 * norm, 0.0, -0.8 * norm, 0.0]
    np.testing.assert_allclose(as_state(given), [1.0, 2.0, 0.6, 0.0, -0.8, 0.0], atol=1e-14)
    assert are_states(np.array([given]))[0]


@pytest.mark.parametrize("part", [0.7, 0.71, 0.707])
def test_quarter_turn_in_two_digits_is_one(part: float) -> None:
    np.testing.assert_allclose(
        as_state([0.5, 0.0, part, 0.0, 0.0, part]), upright_state(0.5, 0.0, np.pi / 2), atol=1e-14
    )


def test_distances_do_not_depend_on_the_sign_of_either_quaternion() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        a, b = (
            as_state(np.concatenate((rng.normal(size=2), q / np.linalg.norm(q))))
            for q in rng.normal(size=(2, 4))
        )
        for distance in (state_error, angle_error, position_error):
            assert distance(a, b) == pytest.approx(distance(flipped_sign(a), b), abs=1e-15)
            assert distance(a, b) == pytest.approx(distance(a, flipped_sign(b)), abs=1e-15)
        assert nearer_sign(b, a)[2:6] @ a[2:6] >= 0.0


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-6, 0.1, 1.0, 3.0, np.pi - 1e-9, np.pi])
def test_angle_error_is_the_angle_of_the_rotation_even_where_it_is_tiny(angle: float) -> None:
    turn = Rotation.from_rotvec(angle * np.array([0.6, 0.0, 0.8])).as_quat()[[3, 0, 1, 2]]
    state = np.concatenate((np.zeros(2), turn))
    # 1e-7 near pi, where the sine has no slope; relative rounding elsewhere.
    expected = pytest.approx(angle, rel=1e-7, abs=1e-15)
    assert angle_error(state, np.array(ORIGIN)) == expected
