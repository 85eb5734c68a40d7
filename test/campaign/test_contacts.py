# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The judge of contacts, and what is put on the floor in the fuzzing."""

import random

import numpy as np
import pytest

pytest.importorskip("rclpy")

from contacts import STOPPING, ContactCheck
from faults import memory_at_ends
from floors import _AWAY, _area, _corners, _map
from hostile import RADIUS
from rclpy.serialization import serialize_message

from sphere_nmpc.errors import SphereNmpcError
from sphere_nmpc.floor.floor import exact_distance
from sphere_nmpc.floor.layers import Layers
from sphere_nmpc.floor.occupancy import Grid, check_polygon
from sphere_nmpc.ros.floor_messages import keepout_of_message, map_of_message


def wall(x: float) -> Grid:
    """Floor of 6 m x 2 m, occupied beyond x [m]."""
    occupied = np.zeros((20, 60), dtype=bool)
    occupied[:, round(10 * x):] = True
    return Grid(occupied, 0.1)


def rolled(check: ContactCheck, start: float, end: float) -> list[str]:
    """Roll along the middle of the floor in steps of 1 cm; return the complaints."""
    found = [check.observe(np.array((x, 1.0))) for x in np.arange(start, end, 0.01)]
    return [text for text in found if text]


def test_rolling_into_what_is_in_force_is_found_once() -> None:
    check = ContactCheck()
    assert rolled(check, 0.5, 5.0) == []
    check.restart()
    rolled(check, 1.0, 1.1)
    check.floor(wall(4.0))
    assert rolled(check, 1.1, 4.0 - RADIUS - 0.01) == []
    (found,) = rolled(check, 4.0 - RADIUS - 0.01, 4.2)
    assert not check.excused
    assert "rolled on in contact" in found
    check.floor(None)
    assert rolled(check, 4.2, 4.5) == []


@pytest.mark.parametrize("x", [0.8, 1.0 + RADIUS, 1.0 + RADIUS + 0.4])
def test_what_comes_too_near_allows_the_way_of_a_stop(x: float) -> None:
    check = ContactCheck()
    rolled(check, 0.9, 1.0)
    check.floor(wall(x))
    end = max(1.0, x - RADIUS) + STOPPING - 0.03
    assert rolled(check, 1.0, end) == []
    assert check.excused
    # The same floor again allows no more.
    check.floor(wall(x))
    assert len(rolled(check, end, end + 0.2)) == 1


def test_what_is_dropped_far_enough_away_allows_no_contact() -> None:
    check = ContactCheck()
    rolled(check, 0.9, 1.0)
    check.floor(wall(2.0))
    assert len(rolled(check, 1.0, 2.0)) == 1


def test_areas_and_maps_are_usable_or_refused_and_leave_room_for_a_stop() -> None:
    rng, place, goal = random.Random(0), np.array((0.3, -0.4)), np.array((1.5, 1.0))
    used = refused = over = 0
    for _ in range(300):
        corners = _corners(rng, place, goal)
        number, given = keepout_of_message(_area(7, corners), "world")
        assert number == 7
        if not given:
            continue
        try:
            polygon = check_polygon("keepout 7", given)
        except SphereNmpcError:
            refused += 1
            continue
        used += 1
        inside = np.linalg.norm(polygon - place, axis=1).min() < _AWAY - 1e-6
        over += inside
    assert min(used, refused, over) > 10
    for _ in range(20):
        grid = map_of_message(bytes(serialize_message(_map(rng, place))), "world")(0.65, False)
        assert exact_distance(grid, place, 3.0) >= _AWAY - 1e-6
        assert Layers(map=grid).grid(RADIUS) is grid


def test_memory_is_compared_in_the_first_and_the_last_quarter() -> None:
    assert memory_at_ends([1.0, 1.0, 5.0, 5.0, 5.0, 5.0, 2.0, 3.0]) == (1.0, 2.5)
    assert memory_at_ends([4.0]) == (4.0, 4.0)
    assert memory_at_ends([]) == (0.0, 0.0)
