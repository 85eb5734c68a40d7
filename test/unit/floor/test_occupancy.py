# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Grids, and polygons that are entered into them on the safe side."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sphere_nmpc.floor import occupancy
from sphere_nmpc.floor.floor import Floor
from sphere_nmpc.floor.occupancy import (
    Grid,
    InvalidMapError,
    check_polygon,
    grid_of_values,
    touched_runs,
)
from sphere_nmpc.model.state import Vector

LEVEL = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)


def grid(cells: Any, **changes: Any) -> Grid:
    cells = np.array(cells, dtype=np.int8)
    height, width = cells.shape
    arguments = {
        "values": cells.ravel(), "width": width, "height": height, "resolution": 0.1,
        "origin": LEVEL, "occupied_threshold": 0.65, "unknown_is_free": False, **changes,
    }
    return grid_of_values(**arguments)


def occupied_by(free: Grid, polygon: Vector) -> Grid:
    """Return a grid with the cells occupied that a polygon touches."""
    return free.with_runs([touched_runs(free, polygon)])


@pytest.mark.parametrize(
    ("threshold", "first"), [(0.65, 65), (0.64999, 65), (0.651, 66), (1.0, 100), (0.01, 1)]
)
def test_cells_are_occupied_from_the_threshold_on(threshold, first) -> None:
    values = np.arange(-1, 101)[None, :]
    for unknown_is_free in (False, True):
        found = grid(values, occupied_threshold=threshold, unknown_is_free=unknown_is_free)
        expected = values >= first
        expected[0, 0] = not unknown_is_free
        np.testing.assert_array_equal(found.occupied, expected)


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"width": 3}, "given 4 values, expected width x height, 6"),
        ({"height": 0}, "given 2 x 0 cells, expected 1 to 100000000 cells"),
        ({"width": 10**5, "height": 1001}, "given 100000 x 1001 cells, expected 1 to 1000"),
        ({"resolution": -0.1}, "given a resolution of -0.1 m, expected a positive number"),
        ({"resolution": math.inf}, "given a resolution of inf m, expected a positive number"),
        ({"values": np.array([0, 0, 0, 101], np.int8)}, "given a value of 101, expected -1"),
        ({"values": np.array([0, 0, 0, -2], np.int8)}, "given a value of -2, expected -1"),
        ({"origin": (0, 0, 0, 0.1, 0, 0, 1)}, "given an origin with roll or pitch, expected"),
        ({"origin": (0, 0, 0, 1, 0, 0, 0)}, "given an origin with roll or pitch, expected"),
        ({"resolution": 1e-30}, "given a resolution of 1e-30 m, expected a positive number, 0"),
        ({"resolution": 1e300}, "given a corner at 2e+300 m, expected all within 1e+06 m"),
        ({"origin": (0, math.nan, 0, 0, 0, 0, 1)}, "expected finite numbers"),
        ({"origin": (2e6, 0, 0, 0, 0, 0, 1)}, "given a corner at 2000000 m, expected all with"),
        ({"origin": (0, -1e6, 0, 0, 0, 1, 0)}, "given a corner at 1000000 m, expected all with"),
        ({"origin": (0, 0, 0, 0, 0, math.inf, 1)}, "expected finite numbers"),
    ],
)
def test_bad_map_is_refused_with_what_was_given(changes, told) -> None:
    with pytest.raises(InvalidMapError) as caught:
        grid(np.zeros((2, 2)), **changes)
    assert told in str(caught.value)


def test_finest_resolution_and_any_heading_that_a_message_has_are_accepted() -> None:
    finest = grid(np.zeros((2, 2)), resolution=float(np.float32(1e-4)))
    assert finest.occupied.shape == (2, 2)
    turned = grid(np.zeros((2, 2)), origin=(1.0, -2.0, 5.0, 0.0, 0.0, 2.0, 2.0))
    assert turned.origin == pytest.approx((1.0, -2.0, math.pi / 2)), "not a unit quaternion"
    empty = grid(np.zeros((2, 2)), origin=(1.0, -2.0, *[0.0] * 5))
    assert empty.origin == (1.0, -2.0, 0.0), "as of a message that was not filled in"


@given(st.tuples(*3 * [st.floats(-10.0, 10.0)]), st.floats(0.01, 1.0))
def test_places_go_to_the_grid_and_back(origin, side) -> None:
    cells = Grid(np.zeros((2, 3), dtype=bool), side, origin)
    places = np.random.default_rng(0).uniform(-5.0, 5.0, (4, 2))
    np.testing.assert_allclose(cells.world(cells.local(places)), places, atol=1e-9)
    corner = cells.world(np.array([1.0, 0.0])) - origin[:2]
    expected = side * np.array([math.cos(origin[2]), math.sin(origin[2])])
    np.testing.assert_allclose(corner, expected, atol=1e-12)


def test_refined_grid_is_the_same_floor() -> None:
    coarse = Grid(np.array([[True, False], [False, False]]), 0.3, (1.0, 2.0, 0.5))
    fine = coarse.refined(3)
    assert fine.occupied.shape == (6, 6) and fine.resolution == pytest.approx(0.1)
    np.testing.assert_array_equal(fine.occupied[1::3, 1::3], coarse.occupied)
    assert fine.occupied.sum() == 9
    assert coarse.refined(1) is coarse


def star(seed: int, corners: int) -> Vector:
    """Return a simple polygon around a place near the middle of the grid, shape (K, 2) [m]."""
    rng = np.random.default_rng(seed)
    angles = np.sort(rng.uniform(0.0, 2.0 * math.pi, corners))
    away = rng.uniform(0.2, 1.5, corners)
    return rng.uniform(-0.5, 0.5, 2) + away[:, None] * np.column_stack(
        (np.cos(angles), np.sin(angles))
    )


def edge_distances(polygon: Vector, places: Vector) -> Vector:
    """Return the distances of places, shape (P, 2), to the edges of a polygon [m]."""
    along = np.roll(polygon, -1, axis=0) - polygon
    away = places[:, None, :] - polygon
    share = np.clip(np.sum(away * along, axis=2) / np.sum(along**2, axis=1), 0.0, 1.0)
    return np.min(np.linalg.norm(away - share[..., None] * along, axis=2), axis=1)


def are_inside(polygon: Vector, places: Vector) -> Any:
    """Return which places are inside a polygon, by the sum of the angles of its edges."""
    away = polygon - places[:, None, :]
    angles = np.arctan2(away[..., 1], away[..., 0])
    turns = np.diff(np.concatenate((angles, angles[:, :1]), axis=1), axis=1)
    return np.abs(np.sum((turns + np.pi) % (2.0 * np.pi) - np.pi, axis=1)) > np.pi


@given(
    st.integers(0, 2**32 - 1), st.integers(3, 9), st.sampled_from([0.02, 0.05, 0.13]),
    st.floats(-3.0, 3.0),
)
def test_distance_is_never_larger_than_that_to_the_polygon(seed, corners, side, yaw) -> None:
    polygon = star(seed, corners)
    middle = np.array([math.cos(yaw) - math.sin(yaw), math.sin(yaw) + math.cos(yaw)])
    low = -2.5 * middle
    count = math.ceil(5.0 / side)
    free = Grid(np.zeros((count, count), dtype=bool), side, (low[0], low[1], yaw))
    places = free.world(np.random.default_rng(seed).uniform(0.0, count, (300, 2)))
    exact, inside = edge_distances(polygon, places), are_inside(polygon, places)
    slack = 2.5 * side  # of the cells, and of the bound from their corners
    for cells, is_free in (
        (occupied_by(free, polygon), ~inside), (free.within(polygon), inside)
    ):
        found = Floor(cells, 0.3, 0.0).distances(places)
        assert np.all(found <= np.where(is_free, exact, 0.0) + 1e-6)
        # Not more than necessary: the walls of the grid count only outside of the polygon.
        local = free.local(places) * side
        walls = np.minimum(local, count * side - local).min(axis=1)
        assert np.all(found >= np.where(is_free, np.minimum(exact, walls), 0.0) - slack)


def test_polygon_beyond_the_grid_occupies_what_it_covers_of_it() -> None:
    free = Grid(np.zeros((10, 10), dtype=bool), 0.1)
    huge = np.array([[-1e5, -1e5], [1e5, -1e5], [1e5, 1e5], [-1e5, 1e5]])
    assert occupied_by(free, huge).occupied.all() and not free.within(huge).occupied.any()
    away = huge + 1e6
    assert not occupied_by(free, away).occupied.any() and free.within(away).occupied.all()


@pytest.mark.parametrize(
    ("corners", "told"),
    [
        ([], "given 0 corners, expected three or more, finite, within 1e+06 m"),
        ([(0, 0), (1, 0)], "given 2 corners, expected three or more"),
        ([(0, 0)] * 5001, "given 5001 corners, expected three to 5000"),
        ([(0, 0), (1, 0), (math.nan, 1)], "given 3 corners, expected three or more, finite"),
        ([(0, 0), (1, 0), (0, 2e6)], "given 3 corners, expected three or more, finite, within"),
        ([(0, 0), (1, 1), (3, 3)], "given an area of 0, expected a polygon with an area"),
        ([(0, 0), (1, 1), (1, 0), (0, 1)], "given edges 0 and 2 that cross, expected a simple"),
        ([(0, 0), (2, 0), (2, 2), (1, -1)], "given edges 0 and 2 that cross, expected a simple"),
        ([(0, 0), (4, 0), (4, 4), (2, 0), (0, 4)], "given edges 0 and 2 that cross"),
    ],
)
def test_bad_polygon_is_refused(corners, told) -> None:
    with pytest.raises(InvalidMapError) as caught:
        check_polygon("area", corners)
    assert str(caught.value).startswith("area: ") and told in str(caught.value)


def test_simple_polygon_is_accepted_also_with_its_first_corner_at_the_end() -> None:
    corners = [(0.0, 0.0), (2.0, 0.0), (1.0, 0.5), (2.0, 2.0)]
    for given_ones in (corners, corners[::-1], [*corners, corners[0]]):
        np.testing.assert_array_equal(check_polygon("area", given_ones), given_ones)


def test_polygons_of_many_corners_are_checked_at_once_and_edges_that_cross_are_found() -> None:
    angles = np.linspace(0.0, 2.0 * math.pi, 3000, endpoint=False)
    check_polygon("area", np.column_stack((np.cos(angles), np.sin(angles))).tolist())
    low = np.column_stack((np.arange(1500.0), np.tile((0.0, 1.0), 750)))
    high = low[::-1] + np.array([0.0, 3.0])
    check_polygon("area", np.vstack((low, high)).tolist())
    high[700:702, 1] = -1.0
    crossing = np.vstack((low, high))
    for corners in (crossing, crossing[:, ::-1]):
        with pytest.raises(InvalidMapError, match=r"edges 79[789] and 2[12]\d\d that cross"):
            check_polygon("area", corners.tolist())


def test_polygon_is_entered_alike_in_a_few_rows_at_a_time(monkeypatch) -> None:
    polygon = star(3, 40)
    free = Grid(np.zeros((60, 70), dtype=bool), 0.1, (-3.0, -3.0, 0.2))
    whole = occupied_by(free, polygon).occupied, free.within(polygon).occupied
    monkeypatch.setattr(occupancy, "_BLOCK_SIZE", 50)
    np.testing.assert_array_equal(occupied_by(free, polygon).occupied, whole[0])
    np.testing.assert_array_equal(free.within(polygon).occupied, whole[1])
    assert 0 < np.count_nonzero(whole[0]) < whole[0].size
