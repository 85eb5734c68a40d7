# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Walls: the rectangles of a map, exact distances, and how both plants touch them."""

import itertools
import math

import numpy as np
import pytest

from sphere_nmpc.floor.occupancy import Grid
from sphere_nmpc.model.parameters import RobotParameters
from sphere_sim.world.plant.contract import Plant
from sphere_sim.world.plant.factory import make_plant
from sphere_sim.world.settings import PLANTS
from sphere_sim.world.walls import Contact, Walls, touchable_rectangles

ROBOT = RobotParameters()
RADIUS = ROBOT.shell_radius
ORIGIN = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
HALF_SIDE = 1.0
DEEPEST = {"rolling": 0.0, "rigid_body": 2e-3}
"""Largest depth in a wall [m]: 0.9 mm at 0.3 m/s for the soft contact."""
STEP_LENGTH = 5e-3 * ROBOT.shell_radius * 5.0
"""More than the longest way in an integration step of the ideal plant [m]."""


def turned(yaw: float, occupied: np.ndarray | None = None) -> Walls:
    """Return the walls of a square room about the origin that is turned by an angle."""
    corner = HALF_SIDE * np.array([
        -math.cos(yaw) + math.sin(yaw), -math.sin(yaw) - math.cos(yaw)
    ])
    occupied = np.zeros((40, 40), dtype=bool) if occupied is None else occupied
    side = 2.0 * HALF_SIDE / len(occupied)
    return Walls(Grid(occupied, side, (float(corner[0]), float(corner[1]), yaw)))


def plant_in(name: str, walls: Walls | None) -> Plant:
    if name == "rigid_body":
        pytest.importorskip("mujoco")
    return make_plant(name, ROBOT, ORIGIN, walls=walls)


def drive(plant: Plant, speeds: tuple[float, float], seconds: float) -> np.ndarray:
    """Drive with constant rotor speeds [rad/s], and return the clearances [m]."""
    found = []
    for _ in range(round(100 * seconds)):
        plant.advance(np.array(speeds), 0.01)
        found.append(plant.contact.least_clearance(plant.state[None, :2]))
    return np.array(found)


def test_rectangles_cover_all_that_can_be_touched_and_nothing_that_is_free() -> None:
    rng = np.random.default_rng(0)
    for _ in range(200):
        height, width = rng.integers(1, 12, 2)
        occupied = rng.random((height, width)) < rng.random()
        covered = np.zeros(occupied.shape, dtype=int)
        for x0, y0, x1, y1 in touchable_rectangles(occupied):
            covered[y0:y1, x0:x1] += 1
        assert covered.max() <= 1 and not covered[~occupied].any()
        for i, j in np.argwhere(occupied):
            if not occupied[max(0, i - 1) : i + 2, max(0, j - 1) : j + 2].all():
                assert covered[i, j]
    # Long walls and solid areas are few rectangles.
    occupied = np.zeros((300, 400), dtype=bool)
    occupied[:, 200:] = occupied[100:102, 20:150] = occupied[120:280, 50:52] = True
    assert len(touchable_rectangles(occupied)) == 3


def test_distances_are_exact_on_a_turned_grid() -> None:
    rng = np.random.default_rng(1)
    for _ in range(20):
        occupied = rng.random((7, 9)) < 0.2
        walls = Walls(Grid(occupied, 0.3, (1.0, -2.0, rng.uniform(-4.0, 4.0))))
        local = rng.uniform(-1.0, 10.0, (100, 2))
        expected = []
        for x, y in local:
            least = max(0.0, min(x, y, 9 - x, 7 - y))
            for i, j in np.argwhere(occupied):
                away = max(j - x, 0.0, x - j - 1), max(i - y, 0.0, y - i - 1)
                least = min(least, math.hypot(*away))
            expected.append(0.3 * least)
        np.testing.assert_allclose(walls.distances(walls.grid.world(local)), expected, atol=1e-12)
    assert walls.distances(np.array([[math.nan, 0.0]]))[0] == 0.0


@pytest.mark.parametrize("yaw", [0.0, 0.6])
@pytest.mark.parametrize("name", PLANTS)
def test_sphere_stops_at_a_wall_and_leaves_it_again(name, yaw) -> None:
    plant = plant_in(name, turned(yaw))
    needed = (HALF_SIDE - RADIUS) / math.cos(yaw) / 0.315  # at 0.315 m/s
    drive(plant, (0.0, -60.0), 0.9 * needed)
    assert plant.contact.touches == 0 and not plant.contact.is_touching
    clearances = drive(plant, (0.0, -60.0), 0.2 * needed)
    assert -DEEPEST[name] <= clearances.min() < STEP_LENGTH
    assert plant.contact.touches == 1
    clearances = drive(plant, (0.0, 40.0), 1.0)
    assert -DEEPEST[name] <= clearances.min() and clearances[-1] > 0.1
    assert plant.contact.touches == 1 and not plant.contact.is_touching


@pytest.mark.parametrize("name", PLANTS)
def test_sphere_stays_in_a_corner_while_its_rotors_turn_on(name) -> None:
    plant = plant_in(name, turned(0.0))
    clearances = drive(plant, (60.0, -60.0), 3.5)
    assert -DEEPEST[name] <= clearances.min() < STEP_LENGTH
    assert np.all(np.abs(plant.state[:2]) < HALF_SIDE - RADIUS + DEEPEST[name])
    state, angles = plant.state, plant.rotor_angles
    drive(plant, (50.0, -50.0), 0.1)
    assert plant.contact.touches == 1
    assert plant.rotor_angles[1] < angles[1] - 4.0
    if name == "rolling":
        np.testing.assert_array_equal(plant.state, state)
        assert plant.contact.is_touching and not plant.velocity.any() and not plant.body_rate.any()


@pytest.mark.parametrize("name", PLANTS)
def test_walls_that_come_and_go_leave_the_motion(name) -> None:
    plant, other = plant_in(name, None), plant_in(name, None)
    for each in (plant, other):
        each.tilt(0.01, 0.5)
        drive(each, (10.0, -60.0), 1.0)
    plant.surround(turned(0.3))
    for each in (plant, other):
        drive(each, (10.0, -60.0), 0.5)
    np.testing.assert_allclose(plant.state, other.state, atol=1e-12)
    plant.surround(turned(0.0, np.ones((2, 2), dtype=bool)))
    assert plant.contact.touches == 1
    plant.surround(None)
    drive(plant, (0.0, -60.0), 0.5)
    assert plant.contact.touches == 1 and not plant.contact.is_touching
    assert plant.velocity[0] > 0.2


def test_walls_that_cannot_be_made_leave_those_before(monkeypatch) -> None:
    plant = plant_in("rigid_body", turned(0.3))
    before = plant.contact.walls, plant._model
    monkeypatch.setattr("sphere_sim.world.plant.rigid_body.rigid_body_plant.make_mjcf", None)
    with pytest.raises(TypeError):
        plant.surround(None)
    assert (plant.contact.walls, plant._model) == before


def test_contact_that_bounces_is_one() -> None:
    contact = Contact(turned(0.0), RADIUS)
    edge = HALF_SIDE - RADIUS
    places = [edge - 0.002, edge + 1e-4, edge - 5e-4, edge + 1e-5, edge - 0.0025, edge + 1e-4]
    for before, after in itertools.pairwise(places):
        contact.is_into_wall((before, 0.0), (after, 0.0))
    assert contact.touches == 1
    contact.is_into_wall((edge, 0.0), (edge - 0.1, 0.0))
    contact.is_into_wall((edge - 0.1, 0.0), (edge + 1e-4, 0.0))
    assert contact.touches == 2
