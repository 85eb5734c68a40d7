# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Distances on a floor, the certificate of a path, and the ways to a goal."""

import gc
import math
import pickle
import socket
import weakref
from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage

from sphere_nmpc.floor.floor import Floor, exact_distance
from sphere_nmpc.floor.occupancy import Grid
from sphere_nmpc.floor.route import find_routes, in_sight, plain_routes, route_to
from sphere_nmpc.floor.settings import FloorSettings
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector
from sphere_nmpc.process.channel import Channel, encoded
from sphere_nmpc.strategy.clearance import Margin, Profile, needed_distance, refusal
from sphere_nmpc.strategy.contract import Situation

RADIUS = 0.3
TWO_ROOMS = Path(__file__).parents[3] / "config" / "maps" / "two_rooms.yaml"


def random_grid(seed: int, yaw: float = 0.0) -> Grid:
    rng = np.random.default_rng(seed)
    occupied = rng.random((40, 50)) < 0.03
    return Grid(occupied, 0.05, (-1.2, 0.7, yaw))


def distances_to_squares(grid: Grid, places: Vector) -> Vector:
    """Distances of places to all occupied squares and to the edge, without any shortcut [m]."""
    x, y = (grid.local(places)).T
    height, width = grid.occupied.shape
    least = np.minimum(np.minimum(x, width - x), np.minimum(y, height - y))
    for i, j in zip(*np.nonzero(grid.occupied), strict=True):
        dx = np.maximum(0.0, np.maximum(j - x, x - j - 1))
        dy = np.maximum(0.0, np.maximum(i - y, y - i - 1))
        least = np.minimum(least, np.hypot(dx, dy))
    return np.maximum(0.0, least) * grid.resolution


def places_on(grid: Grid, rng: np.random.Generator, count: int) -> Vector:
    height, width = grid.occupied.shape
    return grid.world(rng.uniform((0, 0), (width, height), (count, 2)))


@pytest.mark.parametrize(("seed", "yaw"), [(0, 0.0), (1, 0.6), (2, -1.1)])
def test_distances_are_lower_bounds_that_miss_less_than_a_cell(seed: int, yaw: float) -> None:
    grid = random_grid(seed, yaw)
    floor = Floor(grid, RADIUS, 0.02)
    places = places_on(grid, np.random.default_rng(seed), 2000)
    right, bound = distances_to_squares(grid, places), floor.distances(places)
    # Corners have distances in single precision.
    assert (bound <= right + 1e-6).all()
    # From a place to the nearest corner of its cell it is 0.71 of a side at most.
    assert (bound >= right - 2.0 * 0.71 * floor.fine.resolution - 1e-6).all()
    for reach in (10.0, 0.1):
        found = [exact_distance(grid, place, reach) for place in places[:500]]
        np.testing.assert_allclose(found, np.minimum(right[:500], reach), atol=1e-12)


def test_places_outside_or_not_finite_have_no_distance() -> None:
    grid = Grid(np.zeros((10, 10), dtype=bool), 0.1)
    floor = Floor(grid, RADIUS, 0.0)
    places = np.array([[-0.01, 0.5], [0.5, 1.01], [1e300, 0.0], [math.nan, 0.5]])
    assert (floor.distances(places) == 0.0).all()
    assert [floor.distance(place) for place in places] == [0.0] * 4
    assert floor.distances(np.array([[0.5, 0.5]]))[0] == pytest.approx(0.5, abs=1e-6)


def test_certificate_holds_between_samples() -> None:
    """Paths of random samples, whatever they do between them within their lengths."""
    rng = np.random.default_rng(4)
    certified = 0
    for seed in range(120):
        grid = random_grid(seed)
        floor = Floor(grid, RADIUS, 0.0)
        start = places_on(grid, rng, 1)
        path = np.vstack((start, start + np.cumsum(rng.normal(0, 0.015, (12, 2)), axis=0)))
        chords = np.linalg.norm(np.diff(path, axis=0), axis=1)
        lengths = chords * rng.uniform(1.0, 1.5, chords.size)
        needed = rng.uniform(0.02, 0.2)
        found = Profile(path, floor.distances(path), lengths).certified(needed, 0.0)
        if math.isnan(found) or floor.distances(start)[0] < needed:
            continue
        certified += 1
        assert found >= needed
        # The farthest that a path of this length gets from its chord: over the corner of an
        # isosceles triangle; others lie in the ellipse through it.
        for a, b, length in zip(path[:-1], path[1:], lengths, strict=True):
            chord = b - a
            normal = np.array((-chord[1], chord[0])) / np.linalg.norm(chord)
            angles = np.linspace(0.0, 2.0 * np.pi, 60)
            half, height = 0.5 * length, 0.5 * math.sqrt(max(0.0, length**2 - chord @ chord))
            ellipse = (
                0.5 * (a + b) + half * np.cos(angles)[:, None] * chord / np.linalg.norm(chord)
                + height * np.sin(angles)[:, None] * normal
            )
            assert distances_to_squares(grid, ellipse).min() >= found - 1e-9
    assert certified > 10


def test_certificate_of_a_start_without_clearance() -> None:
    def certified(distances: list[float]) -> float:
        places = np.empty((len(distances), 2))
        steps = np.full(len(distances) - 1, 0.02)
        return Profile(places, np.array(distances), steps).certified(0.25, 0.2)

    assert certified([0.24, 0.241, 0.2495, 0.265, 0.27]) == pytest.approx(0.2305)
    assert math.isnan(certified([0.23, 0.24, 0.235, 0.255, 0.27]))
    # Once it has enough it must keep that.
    assert math.isnan(certified([0.24, 0.25, 0.26, 0.248, 0.26]))
    assert certified([0.1]) == pytest.approx(0.1)


def test_the_empty_floor_is_clear_everywhere_and_the_same_object_in_another_process() -> None:
    empty, places = Floor.EMPTY, np.array([[0.0, 0.0], [1e6, -1e6]])
    assert pickle.loads(pickle.dumps(empty)) is empty and empty.lasting is empty
    assert empty.distances(places).tolist() == [math.inf, math.inf]
    assert not empty.is_occupied(places[1]) and math.isinf(empty.distance(places[1]))
    assert not empty.collided(places[:, None], 1.0).any()


def test_a_floor_reaches_another_process_as_shared_memory() -> None:
    here, there = (Channel(end) for end in socket.socketpair())
    for yaw in (0.3, -0.2):  # another one each time
        floor = Floor(random_grid(2, yaw), RADIUS, 0.05).prepared()
        message = encoded(floor)
        assert len(message.content) < 1000
        here.send(message)
        copy = there.receive()
        places = places_on(floor.grid, np.random.default_rng(0), 200)
        np.testing.assert_array_equal(copy.distances(places), floor.distances(places))
        assert (copy.radius, copy.clearance, copy.needed) == (RADIUS, 0.05, floor.needed)
        np.testing.assert_allclose(
            [copy.distance(place) for place in places],
            [floor.distance(place) for place in places], atol=1e-9,
        )
        here.send(encoded(floor))
        assert there.receive() is copy  # which has the ways that were found
    here.close()
    there.close()


def test_a_floor_is_freed_with_all_that_was_kept_with_it() -> None:
    """At once, and not when garbage is collected, which may take minutes in a worker."""
    gc.disable()
    try:
        floor = Floor(random_grid(1), RADIUS, 0.02).prepared()
        goal = np.array([0.3, 1.2])
        situation = Situation.of(0.0, np.append(goal, (1, 0, 0, 0)), np.append(goal, (1, 0, 0, 0)),
                                 np.zeros(2), RobotParameters().lumped, floor=floor)
        assert route_to(floor, goal) is route_to(floor, goal)
        refusal(situation, floor)
        needed_distance(situation, Margin.FOUND)
        assert len(floor.kept) == 3
        freed = weakref.ref(floor)
        del floor, situation
        assert freed() is None
    finally:
        gc.enable()


def test_compiled_ways_are_those_of_the_plain_search() -> None:
    rng = np.random.default_rng(3)
    cost = rng.uniform(0.5, 2.0, (60, 45)).astype(np.float32)
    cost[rng.random(cost.shape) < 0.25] = np.inf
    goal = 20 * 45 + 30
    cost.flat[goal] = 1.0
    found, twin = (np.full(cost.shape, np.inf, np.float32) for _ in range(2))
    after, after_twin = (np.full(cost.shape, -1, np.int32) for _ in range(2))
    find_routes(cost, goal, found, after)
    plain_routes(cost, goal, twin, after_twin)
    np.testing.assert_allclose(found, twin, rtol=1e-5)
    assert ((after < 0) == (after_twin < 0)).all()
    assert 100 < np.isfinite(found).sum() < cost.size


def test_a_way_is_found_exactly_where_there_is_one() -> None:
    """Against the connected parts of the places with enough distance at a hundredth of a metre.

    Where they differ the narrowest place of the way misses what is needed by less than the
    resolution of the nodes, and that the sphere may not get through is left to the plans.
    """
    rng = np.random.default_rng(8)
    missing = unsure = 0
    for _ in range(8):
        occupied = rng.random((60, 60)) < rng.uniform(0.004, 0.02)
        floor = Floor(Grid(occupied, 0.05), 0.15, 0.02)
        spacing = 0.01
        at = np.arange(0.0, 3.0, spacing)
        places = np.stack(np.meshgrid(at, at), axis=-1).reshape(-1, 2)
        free = (distances_to_squares(floor.grid, places) >= floor.needed).reshape(at.size, -1)
        parts, _ = ndimage.label(free, np.ones((3, 3)))
        inside = places[free.ravel()]
        for goal, start in inside[rng.integers(len(inside), size=(8, 2))]:
            same = len({int(parts[round(y / spacing), round(x / spacing)])
                        for x, y in (goal, start)}) == 1
            path = route_to(floor, goal).path(start)
            if same:
                missing += int(len(path) == 0)
                np.testing.assert_array_equal(path[-1], goal)
            elif len(path):
                unsure += 1
                # Between its nodes it may have less, by half of their distance.
                assert floor.distances(path).min() < floor.needed + 0.028
    assert missing == 0
    assert unsure < 20


START, GOAL = np.array([1.0, 1.0]), np.array([3.0, 1.0])


def walled(rows: int) -> Floor:
    """Return a floor of 4 m by 4 m with a wall between `START` and `GOAL`."""
    occupied = np.zeros((80, 80), dtype=bool)
    occupied[:rows, 40] = True
    return Floor(Grid(occupied, 0.05), RADIUS, 0.02)


def test_a_way_around_a_wall_is_about_as_long_as_the_shortest() -> None:
    floor = walled(50)
    way = route_to(floor, GOAL)
    # Around the circle of the needed distance about the end of the wall, twice a tangent.
    shortest = 0.05
    for place, corner in ((START, (2.0, 2.5)), (GOAL, (2.05, 2.5))):
        away = math.dist(place, corner)
        turn = math.pi / 2 + math.atan2(corner[1] - place[1], abs(corner[0] - place[0]))
        turn -= math.acos(floor.needed / away)
        shortest += math.sqrt(away**2 - floor.needed**2) + floor.needed * max(0.0, turn)
    path = way.path(START)
    length = np.sum(np.linalg.norm(np.diff(path, axis=0), axis=1))
    # Sixteen directions are 2.7 per cent longer at the worst, and it keeps away from the wall.
    assert shortest - 0.03 < length < 1.15 * shortest
    assert floor.distances(path).min() > floor.needed
    assert way.length(START) >= length - 0.03
    # It is not dearer to begin in another place on it.
    assert way.length(path[len(path) // 2]) < 0.7 * way.length(START)


def test_no_way_out_of_a_closed_room_into_a_wall_or_off_the_floor() -> None:
    floor = walled(80)
    assert route_to(floor, GOAL).length(START) == math.inf
    assert len(route_to(floor, GOAL).path(START)) == 0
    for goal in ([2.0, 1.0], [9.0, 1.0]):
        assert len(route_to(floor, np.array(goal)).path(GOAL)) == 0


def test_map_of_the_documents_has_a_way_that_is_not_straight_to_its_goal() -> None:
    settings, start, goal = FloorSettings(map_file=str(TWO_ROOMS)), [2.0, -3.0], np.zeros(2)
    floor = settings.whole(RADIUS)
    assert floor.distances(np.array([start, goal, [1.0, 2.0]])).min() > 1.0
    assert not in_sight(floor, np.array(start), goal[None], floor.needed)[0]
    assert 4.0 < route_to(floor, goal).length(np.array(start)) < 6.0
    # The doorway is 1.2 m wide.
    assert np.isinf(route_to(settings.whole(0.7), goal).length(np.array(start)))
