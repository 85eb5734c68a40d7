# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Lower bound of the time: its identity, motions that attain it, and motions that do not."""

import math
from dataclasses import replace

import numpy as np
import pytest
from robots import HEAVY_ROTORS

from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.rotation import random_quaternion
from sphere_nmpc.model.state import QUATERNION, Vector, angle_error, make_state
from sphere_sim.study.lower_bound import _largest_gain, lower_bound
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


def test_bounds_by_hand(monkeypatch) -> None:
    # Nearby goals need no table.
    monkeypatch.setattr("sphere_sim.study.lower_bound.displacement_table", None)
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


def test_orientations_that_cannot_roll_straight_on_raise_the_bound_of_far_goals() -> None:
    # The body's z axis is horizontal and across the way.
    start = make_state([0.0, 0.0], [DIAGONAL, DIAGONAL, 0.0, 0.0])
    fastest = 0.3 * TABLE_1.lumped.input_gain * math.sqrt(2.0) * 100.0
    lost = []
    for distance in (3.0, 30.0):
        goal = make_state([distance, 0.0], [1.0, 0.0, 0.0, 0.0])
        lost.append(lower_bound(start, goal, TABLE_1) - distance / fastest - 0.25)
    assert lost[0] > 0.02
    assert lost[1] == pytest.approx(lost[0], rel=1e-9)


def test_torque_limit_is_one_of_both_rotors_together() -> None:
    limited = replace(TABLE_1, max_rotor_torque=0.5)
    norm, one = _largest_gain(limited), _largest_gain(limited, of_one=True)
    assert one == pytest.approx(math.sqrt(2.0) * norm)
    assert _largest_gain(replace(limited, max_rotor_torque=100.0), of_one=True) == 400.0
    assert _largest_gain(TABLE_1, of_one=True) == 400.0
