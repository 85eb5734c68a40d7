# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Lower bound of the time: its identity, motions that attain it, and motions that do not."""

import math
from dataclasses import replace

import numpy as np
import pytest
from robots import HEAVY_ROTORS

from sphere_nmpc.model import rotation
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.rotation import random_quaternion
from sphere_nmpc.model.state import (
    POSITION,
    QUATERNION,
    Vector,
    angle_error,
    flipped_sign,
    make_state,
    without_momentum,
)
from sphere_sim.scenario.lower_bound import _least_share, _least_share_from, lower_bound
from sphere_sim.scenario.scenarios import draw_scenarios
from sphere_sim.study.best_known import best_known_time
from sphere_sim.study.motion import Motion
from sphere_sim.world.plant import rolling_plant
from sphere_sim.world.plant.rolling_plant import RollingPlant

pytestmark = pytest.mark.slow

TABLE_1 = RobotParameters()
# Inertia about the body's z axis of the last one is the smaller one, r3 > r1.
ROBOTS = [TABLE_1, HEAVY_ROTORS, replace(TABLE_1, rotor_offset=0.0, shell_inertia=0.001)]
NAMES = ["Table 1", "heavy rotors", "centred rotors"]

ATTAINED = 1e-6
"""Difference of times [s] that the plant's integration causes: in steps of 1 ms less than 1e-8 s
where the shell rotates the fastest."""
DIAGONAL = math.sqrt(0.5)


@pytest.fixture(autouse=True)
def short_steps(monkeypatch) -> None:
    monkeypatch.setattr(rolling_plant, "MAX_STEP", 1e-3)


def moved(robot: RobotParameters, start: Vector, knots: list[tuple[float, Vector]]) -> Vector:
    """Return the state after a first-order hold of durations [s] and rotor speeds [rad/s]."""
    plant = RollingPlant(robot, start)
    for duration, speeds in knots:
        if duration > 0.0:
            plant.advance(np.asarray(speeds), duration)
    return plant.state


def largest_torque(robot: RobotParameters, start: Vector, knots) -> float:
    """Return the largest motor torque of the plant along a hold as in `moved` [N m]."""
    plant, speeds, largest, parts = RollingPlant(robot, start), np.zeros(2), 0.0, 50
    for duration, there in knots:
        for part in range(1, parts + 1):
            plant.advance(speeds + part / parts * (there - speeds), duration / parts)
            largest = max(largest, float(np.max(np.abs(plant.rotor_torques))))
        speeds = there
    return largest


def trapezoid(robot: RobotParameters, direction: Vector, steady: float, peak: float = 1.0):
    """Return knots that ramp to a peak [of the speed limit], keep it and ramp back."""
    speeds = peak * robot.max_rotor_speed * np.asarray(direction)
    ramp = peak * robot.max_rotor_speed / robot.max_rotor_acceleration
    return [(ramp, speeds), (steady, speeds), (ramp, 0.0 * speeds)]


@pytest.mark.parametrize("robot", ROBOTS, ids=NAMES)
@pytest.mark.parametrize(
    ("steady", "peak"), [(0.0, 0.3), (0.0, 1.0), (0.7, 1.0), (20.0, 1.0)], ids=str
)
def test_straight_rolling_attains_the_bound(robot, steady, peak) -> None:
    start = make_state([0.3, -0.2], [1.0, 0.0, 0.0, 0.0])
    knots = trapezoid(robot, np.array([1.0, -1.0]), steady, peak)
    goal = moved(robot, start, knots)
    seconds = sum(duration for duration, _ in knots)
    assert lower_bound(start, goal, robot) == pytest.approx(seconds, abs=ATTAINED)


@pytest.mark.parametrize("robot", ROBOTS, ids=NAMES)
@pytest.mark.parametrize("angle", [0.3, 3.1])
def test_turn_about_a_vertical_diagonal_attains_the_bound(robot, angle) -> None:
    # Body (1, 1, 0) is upwards: half a turn about the bisector of it and the z axis.
    start = make_state([0.0, 0.0], [0.0, 0.5, 0.5, DIAGONAL])
    constants = robot.lumped
    fastest = constants.input_gain / (1.0 - constants.transverse_ratio) * math.sqrt(2.0) * 100.0
    knots = trapezoid(
        robot, np.array([1.0, 1.0]), max(0.0, angle / fastest - 0.25),
        min(1.0, math.sqrt(angle / fastest / 0.25)),
    )
    goal = moved(robot, start, knots)
    np.testing.assert_allclose(goal[:2], 0.0, atol=1e-12)
    assert angle_error(start, goal) == pytest.approx(angle, abs=1e-5)
    seconds = sum(duration for duration, _ in knots)
    assert lower_bound(start, goal, robot) == pytest.approx(seconds, abs=ATTAINED)


def test_bounds_by_hand() -> None:
    upright = make_state([0.0, 0.0], [1.0, 0.0, 0.0, 0.0])
    fastest = 0.3 * TABLE_1.lumped.input_gain * math.sqrt(2.0) * 100.0
    # A triangle of 0.01 m: its peak is a T / 2.
    near = make_state([0.01, 0.0], [1.0, 0.0, 0.0, 0.0])
    triangle = math.sqrt(4.0 * 0.01 / (4.0 * fastest))
    assert lower_bound(upright, near, TABLE_1) == pytest.approx(triangle, rel=1e-12)
    away = make_state([0.3, 0.2], [1.0, 0.0, 0.0, 0.0])
    assert lower_bound(upright, away, TABLE_1) > 0.25
    over = make_state([0.0, 0.0], [0.0, 1.0, 0.0, 0.0])
    rolled = 0.3 * math.pi / fastest + 0.25
    assert lower_bound(upright, over, TABLE_1) == pytest.approx(rolled, rel=1e-9)
    # Along the circle on the shell that is half way between the poles.
    lying = make_state([0.0, 0.0], [DIAGONAL, DIAGONAL, 0.0, 0.0])
    over = make_state([0.0, 0.0], rotation.product(lying[QUATERNION], np.array([0, 0, 0, 1.0])))
    assert lower_bound(lying, over, TABLE_1) == pytest.approx(rolled, rel=1e-9)
    # From 10 degrees of latitude to -10 degrees, with half a turn about the vertical on the way.
    ends = [rotation.exponential(np.radians((tilt, 0.0, 0.0))) for tilt in (80.0, 100.0)]
    start, over = (make_state([0.0, 0.0], end) for end in ends)
    over[QUATERNION] = rotation.product(np.array([0, 0, 0, 1.0]), over[QUATERNION])
    share = (1.0 - TABLE_1.lumped.transverse_ratio) ** 2
    way, turn = math.radians(20.0), angle_error(start, over)
    seconds = 0.3 * math.sqrt((1.0 - share) * way**2 + share * turn**2) / fastest + 0.25
    assert lower_bound(start, over, TABLE_1) == pytest.approx(seconds, rel=1e-9)
    for same in (upright, -upright):  # which has the other sign of the quaternion
        assert lower_bound(upright, same, TABLE_1) == 0.0


@pytest.mark.parametrize("robot", ROBOTS, ids=NAMES)
@pytest.mark.parametrize(("by_torque", "closest"), [(False, 0.9), (True, 0.7)])
def test_no_motion_is_faster_than_the_bound(robot, by_torque, closest) -> None:
    rng = np.random.default_rng(3)
    shares = []
    for _ in range(20):
        start = make_state(rng.uniform(-1.0, 1.0, 2), random_quaternion(rng))
        if rng.random() < 0.5:  # upright, or with a horizontal diagonal
            start[QUATERNION] = [1.0, 0.0, 0.0, 0.0]
        # Triangles and trapezoids from and to rest, at the limits as often as not.
        knots = []
        for _ in range(rng.integers(1, 4)):
            direction = np.clip(rng.uniform(-2.0, 2.0, 2), -1.0, 1.0)
            knots += trapezoid(robot, direction, rng.exponential(0.5), rng.uniform(0.3, 1.0))
        limited = robot
        if by_torque:
            torque = largest_torque(robot, start, knots)
            limited = replace(robot, max_rotor_torque=torque, max_rotor_acceleration=1e6)
        seconds = sum(duration for duration, _ in knots)
        shares.append(lower_bound(start, moved(robot, start, knots), limited) / seconds)
    assert closest < max(shares) < 1.0 + ATTAINED


@pytest.mark.parametrize("robot", ROBOTS[:2], ids=NAMES[:2])
@pytest.mark.parametrize("kind", ["anywhere", "circle", "half_turn", "upright"])
def test_no_motion_that_a_search_finds_is_faster_than_the_bound(robot, kind) -> None:
    ends = [(one.start, one.goal) for one in draw_scenarios(3, 5, kind)]
    found = [
        best_known_time(Motion(without_momentum(start), goal), robot, 0.05).duration
        for start, goal in ends
    ]
    bounds = [lower_bound(start, goal, robot) for start, goal in ends]
    assert np.any(np.isfinite(found))
    assert not np.any(np.greater(bounds, found))


@pytest.mark.parametrize("robot", ROBOTS, ids=NAMES)
def test_rolling_and_turning_share_the_rotor_speeds(robot) -> None:
    constants, rng = robot.lumped, np.random.default_rng(4)
    r1, r3 = constants.transverse_ratio, constants.axial_ratio
    shares = []
    upright = np.array([1.0, 0.0, 0.0, 0.0])
    for quaternion in [upright, *(random_quaternion(rng) for _ in range(50))]:
        speeds = rng.uniform(-100.0, 100.0, 2)
        plant = RollingPlant(robot, make_state([0.0, 0.0], quaternion))
        plant.advance(speeds, 1e-9)
        vertical = rotation.vertical(quaternion)
        rolling = plant.velocity / robot.shell_radius
        turning = float(vertical @ plant.body_rate)
        share = (1.0 - r1) ** 2 - ((r1 - r3) * vertical[2]) ** 2
        of_rotors = constants.input_gain**2 * speeds @ speeds
        assert rolling @ rolling + share * turning**2 == pytest.approx(of_rotors, rel=1e-6)
        latitude = np.arcsin(vertical[2:])
        eta = float(_least_share_from(np.abs(latitude), constants)[0])
        rising = np.cross(vertical, plant.body_rate)[2] / np.cos(latitude[0])
        along = (1.0 - eta) * rising**2 + eta * plant.body_rate @ plant.body_rate
        assert along <= of_rotors * (1.0 + 1e-6)
        shares.append(share)
    assert min(shares) > 0.0
    assert _least_share(constants) == pytest.approx(min(shares), rel=1e-9)


def test_symmetries_of_robot_floor_and_time_change_nothing() -> None:
    rng, turn = np.random.default_rng(4), rotation.exponential
    of_body = [turn(0.5 * math.pi * np.array(axis)) for axis in (
        (0.0, 0.0, 1.0), (2.0, 0.0, 0.0), (math.sqrt(2.0), math.sqrt(2.0), 0.0),
    )]
    heading = 0.7
    on_floor = turn(np.array([0.0, 0.0, heading]))
    for robot in ROBOTS:
        for _ in range(20):
            start, goal = (
                make_state(rng.uniform(-0.3, 0.3, 2), random_quaternion(rng)) for _ in range(2)
            )

            def on_both(change, start=start, goal=goal) -> tuple[Vector, Vector]:
                return change(start), change(goal)

            def turned(state: Vector) -> Vector:
                position = rotation.matrix(on_floor)[:2, :2] @ state[POSITION] + (3.0, -2.0)
                return make_state(position, rotation.product(on_floor, state[QUATERNION]))

            equal = [(goal, start), (start, flipped_sign(goal)), on_both(turned)] + [
                on_both(lambda state, by=by: make_state(
                    state[POSITION], rotation.product(state[QUATERNION], by)
                ))
                for by in of_body
            ]
            bounds = [lower_bound(*ends, robot) for ends in equal]
            np.testing.assert_allclose(bounds, lower_bound(start, goal, robot), rtol=1e-9)


def test_farther_goals_take_longer_and_distant_ones_the_rest_at_the_largest_speed() -> None:
    rng = np.random.default_rng(7)
    start, goal = (make_state([0.0, 0.0], random_quaternion(rng)) for _ in range(2))
    bounds = []
    for distance in np.linspace(0.0, 30.0, 61):
        goal[POSITION] = distance * math.cos(0.4), distance * math.sin(0.4)
        bounds.append(lower_bound(start, goal, TABLE_1))
    assert np.all(np.diff(bounds) >= 0.0)
    fastest = 0.3 * TABLE_1.lumped.input_gain * math.sqrt(2.0) * 100.0
    assert bounds[-1] == pytest.approx(30.0 / fastest + 0.25, rel=1e-9)
    assert bounds[-1] - bounds[20] == pytest.approx(20.0 / fastest, rel=1e-9)


def test_larger_limits_never_raise_the_bound_and_a_torque_limit_counts_where_it_is_lower() -> None:
    upright = make_state([0.0, 0.0], [1.0, 0.0, 0.0, 0.0])
    away = make_state([2.0, 0.0], [0.0, 0.0, 0.0, 1.0])
    for limit, values in {
        "max_rotor_speed": (20.0, 100.0, 500.0), "max_rotor_acceleration": (50.0, 400.0, 4000.0),
        "max_rotor_torque": (0.3, 1.0, 100.0),
    }.items():
        limited = [replace(TABLE_1, **{limit: value}) for value in values]
        bounds = [lower_bound(upright, away, robot) for robot in limited]
        assert bounds == sorted(bounds, reverse=True)
        assert bounds[0] > bounds[1]
    assert bounds[-1] == lower_bound(upright, away, TABLE_1)
