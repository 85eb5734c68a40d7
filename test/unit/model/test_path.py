# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Paths through places, and the courses that follow them."""

import numpy as np
import pytest
from given_paths import CIRCLE, CORNER, CUSP, EIGHT, LINE, RADIUS, SHAPES, TOLERANCE, path_of

from sphere_nmpc.errors import InvalidStateError
from sphere_nmpc.model.course import Course
from sphere_nmpc.model.goal import Goal
from sphere_nmpc.model.path import Path
from sphere_nmpc.model.state import POSITION, upright_state

ROUNDING = 1e-9
"""Of running sums over some thousand places."""


@pytest.mark.parametrize("shape", SHAPES)
def test_curve_goes_from_end_to_end_at_equal_lengths(shape) -> None:
    path, places = path_of(SHAPES[shape]), SHAPES[shape]
    np.testing.assert_allclose(path.places[[0, -1]], places[[0, -1]], atol=ROUNDING)
    steps = np.linalg.norm(np.diff(path.places, axis=0), axis=1)
    # A chord is shorter than its arc by (spacing x curvature)^2 / 24, here at most 1 %.
    np.testing.assert_allclose(steps, path.spacing, rtol=0.01)
    assert path.spacing == pytest.approx(RADIUS / 60.0, rel=0.01)
    whole = np.sum(np.linalg.norm(np.diff(places, axis=0), axis=1))
    assert path.length == pytest.approx(whole, abs=TOLERANCE)


def test_straight_line_stays_straight() -> None:
    curve = path_of(np.linspace((0.0, 0.0), (3.0, 4.0), 7)).curve
    np.testing.assert_allclose(curve[:, 1], curve[:, 0] * 4.0 / 3.0, atol=ROUNDING)
    np.testing.assert_allclose(curve[:, 2], np.arctan2(4.0, 3.0), atol=1e-6)
    np.testing.assert_allclose(curve[:, 3], 0.0, atol=1e-3)  # rounding over the spacing twice


@pytest.mark.parametrize("tolerance", [0.02, 0.002])
def test_circle_is_kept_with_its_curvature(tolerance) -> None:
    curve = path_of(CIRCLE, tolerance).curve
    off = np.hypot(curve[:, 0], curve[:, 1] - 0.5) - 0.5
    # A mean over n places to either side: n (n + 1) spacing^2 / 6 r = 0.17 mm; the sides: 0.02 mm.
    assert np.max(np.abs(off)) < 2.2e-4
    np.testing.assert_allclose(curve[16:-16, 3], 2.0, rtol=0.05)  # beyond the mean at the ends
    assert curve[-1, 2] - curve[0, 2] == pytest.approx(2.0 * np.pi, abs=0.1), "not wrapped"


@pytest.mark.parametrize("turn", np.radians([20.0, 60.0, 90.0, 134.0]))
@pytest.mark.parametrize("tolerance", [0.1, 0.02, 0.002])
def test_corner_is_cut_by_less_than_the_tolerance(turn, tolerance) -> None:
    ahead = np.array([np.cos(turn), np.sin(turn)])
    places = path_of(np.array([[-1.0, 0.0], [0.0, 0.0], ahead]), tolerance).places
    assert np.min(np.linalg.norm(places, axis=1)) < tolerance
    along = np.maximum(places @ ahead, 0.0)[:, None] * ahead
    beside = np.minimum(np.linalg.norm(places - along, axis=1), np.abs(places[:, 1]))
    assert np.max(beside) < tolerance


def test_path_ends_where_it_goes_back() -> None:
    there, back = Path.through(CUSP, TOLERANCE, RADIUS)
    np.testing.assert_allclose(there.places[[0, -1]], CUSP[:2], atol=ROUNDING)
    np.testing.assert_allclose(back.places[[0, -1]], CUSP[1:], atol=ROUNDING)
    course = Course.along(there, back, end=Goal(upright_state(0.0, 0.0, 1.0)))
    assert [leg.follows for leg in course.legs] == [there, back, None] and len(course.paths) == 2
    np.testing.assert_allclose(course.goals[1].pose[POSITION], CUSP[2], atol=ROUNDING)


def test_places_that_repeat_count_once_and_too_many_are_refused() -> None:
    assert path_of(np.repeat(CORNER, 3, axis=0)).equals(path_of(CORNER))
    assert Path.through(np.tile(LINE[0], (4, 1)), TOLERANCE, RADIUS) == ()
    with pytest.raises(InvalidStateError, match="length of the path"):
        Path.through(1e6 * LINE, TOLERANCE, RADIUS)


def test_nearest_place_of_a_figure_eight_is_on_the_branch_of_the_window() -> None:
    path, place = path_of(EIGHT), EIGHT[0] + (0.003, 0.004)
    for way in (0.0, 0.5 * path.length, path.length):
        found = path.nearest(place, way - RADIUS, way + RADIUS)
        assert abs(found - way) < 0.01
        assert np.linalg.norm(place - path.at(found)[:2]) <= 0.005 + ROUNDING


def test_legs_are_the_same_along_the_same_path() -> None:
    course, other = Course.along(path_of(CIRCLE)), Course.along(path_of(EIGHT))  # both end at 0, 0
    assert course.is_listed_in(Course.along(path_of(CIRCLE)))
    assert not course.is_listed_in(other) and not other.is_listed_in(course)
    assert not course.is_listed_in(Course.of(course.goals[0]))
