# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Lower bound of the time, and the table of the largest displacement that it uses."""

import functools
import itertools
import math
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from robots import HEAVY_ROTORS

from sphere_nmpc.model import rotation
from sphere_nmpc.model.dynamics import state_rate
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.rotation import random_quaternion
from sphere_nmpc.model.state import QUATERNION, Vector, angle_error, make_state, without_momentum
from sphere_nmpc.solver.roll_out import roll_out
from sphere_sim.study import displacement_table
from sphere_sim.study.displacement import FASTEST, DisplacementSteps
from sphere_sim.study.displacement_table import DisplacementTable, computed_table
from sphere_sim.study.lower_bound import _largest_gain, lower_bound
from sphere_sim.study.orientation_grid import INPUTS, OrientationGrid, angles_of
from sphere_sim.world.plant import rolling_plant
from sphere_sim.world.plant.rolling_plant import RollingPlant

pytestmark = pytest.mark.slow

TABLE_1 = RobotParameters()
ROBOTS = {
    "heavy rotors": HEAVY_ROTORS,
    # Inertia about the body's z axis is the smaller one, r3 > r1, unlike in the other robots.
    "centred rotors": replace(TABLE_1, rotor_offset=0.0, shell_inertia=0.001),
}
SIZE = 24
"""Of a coarse grid: its table is a bound as any other one."""
ATTAINED = 1e-6
"""Difference of times [s] that the plant's integration causes: in steps of 1 ms less than 1e-8 s
where the shell rotates the fastest."""
DIAGONAL = math.sqrt(0.5)
each_robot = pytest.mark.parametrize("robot", ROBOTS.values(), ids=ROBOTS)
# On a coarse grid the table of the centred rotors is too coarse to be near.
each_table = pytest.mark.parametrize("robot", [TABLE_1, HEAVY_ROTORS], ids=["Table 1", "heavy"])


@pytest.fixture(autouse=True)
def short_steps_and_a_coarse_table(monkeypatch, tmp_path) -> None:
    monkeypatch.setattr(rolling_plant, "MAX_STEP", 1e-3)
    monkeypatch.setattr(displacement_table, "SIZE", SIZE)
    monkeypatch.setattr(displacement_table, "_HORIZON", 1.2)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))


def grid_of(robot: RobotParameters, size: int = SIZE) -> OrientationGrid:
    return OrientationGrid(size, robot.lumped.transverse_ratio, robot.lumped.axial_ratio)


@functools.cache
def table_of(robot: RobotParameters) -> DisplacementTable:
    return computed_table(grid_of(robot), 1.2)


def rate_constants(robot: RobotParameters) -> Vector:
    """Return the model's constants in units of the table: radii, and rotor speeds of one."""
    return np.array([1.0, 1.0, robot.lumped.transverse_ratio, robot.lumped.axial_ratio])


def rate_of(robot: RobotParameters) -> ca.Function:
    """Return the model's dx/dt in units of the table."""
    x, u = ca.SX.sym("x", 6), ca.SX.sym("u", 2)
    return ca.Function("rate", [x, u], [state_rate(x, u, ca.DM(rate_constants(robot)))])


def steps_up_to(grid: OrientationGrid, time: float) -> tuple[float, list[tuple[Vector, float]]]:
    """Return the step, and coefficients and what is added to them at all steps up to a time."""
    steps = DisplacementSteps(grid)
    found = [(steps.coefficients, steps.added)]
    while steps.time < time:
        steps.advance()
        found.append((steps.coefficients, steps.added))
    return steps.step, found


def test_table_is_proven_in_every_cell_and_not_if_it_is_lower_in_one() -> None:
    steps = DisplacementSteps(grid_of(TABLE_1, 12))
    for _ in range(12):
        before, added, cap, check = steps.coefficients, steps.added, steps.cap, steps.check
        steps.advance()
        after, allowed = steps.coefficients, (steps.added - added) / steps.step

        def excess(after: Vector, before: Vector = before, check=check) -> Vector:
            return check.excess(
                (check.rates(before), check.rates(after)),
                (check.remainder(before), check.remainder(after)), after - before, steps.step,
            )

        proven = excess(after)
        assert np.max(proven) <= allowed
        assert np.max(excess(after - 1e-6 - steps.step * (allowed - np.max(proven)))) > allowed
        for cell in itertools.product((2, 4), (3, 5), (3, 9)):
            lower = after.copy()
            lower[cell] -= steps.step * (allowed - proven[cell]) + 1e-6
            assert excess(lower)[cell] > allowed
        # Where cap and grid take over from each other.
        assert np.all(0.5 * (after[-1] + after[-2]) >= steps.cap - 1e-12)
        assert np.max(0.5 * (after[-7] + after[-6])) <= steps.cap
        assert steps.cap > cap


@each_table
def test_spline_satisfies_the_inequality_anywhere_by_the_equations_of_the_model(robot) -> None:
    rng = np.random.default_rng(1)
    grid, rate = grid_of(robot, 12), rate_of(robot)
    step, found = steps_up_to(grid, 0.9)

    def spline(coefficients: Vector, quaternion: Vector) -> float:
        # The table stores the complement, in multiples of its resolution.
        stored = -coefficients[None] / displacement_table._RESOLUTION / FASTEST + 1e6
        table = DisplacementTable(grid, np.zeros(1), np.zeros(1), stored)
        lost = table.lost(quaternion, 0.0)[0]
        return FASTEST * (1e6 * displacement_table._RESOLUTION - lost)

    slack, limit = [], (grid.shape[0] - 1) * grid.step - 0.01
    while len(slack) < 200:
        quaternion = rotation.random_quaternion(rng)
        if angles_of(quaternion, 0.0)[0] > limit:
            continue
        number = int(rng.integers(len(found) - 1))
        (before, added), (after, more) = found[number : number + 2]
        inputs = rng.choice([-1.0, 1.0]) * np.array(INPUTS[rng.integers(2)])
        rates = rate([0.0, 0.0, *quaternion], inputs).full().ravel()
        h = 1e-5
        for coefficients in (before, after):
            ahead, behind = (
                spline(coefficients, quaternion + sign * h * rates[2:]) for sign in (1.0, -1.0)
            )
            right = rates[0] + (ahead - behind) / (2.0 * h)
            left = (spline(after, quaternion) - spline(before, quaternion) + more - added) / step
            slack.append(left - right)
    assert min(slack) > -1e-4
    assert min(slack) < 0.2  # the inequality is near to an equation somewhere


@each_table
def test_no_motion_gets_farther_than_the_table(robot) -> None:
    table, rng = table_of(robot), np.random.default_rng(2)
    constants, shares = rate_constants(robot), []
    for _ in range(80):
        start = np.array([0.0, 0.0, *rotation.random_quaternion(rng)])
        index = int(rng.integers(1, len(table.times)))
        duration, heading = float(table.times[index]), float(rng.uniform(-math.pi, math.pi))
        # The extremes of what is linear in the inputs are at their limits.
        end, left = without_momentum(start), duration
        while left > 0.0:
            held = np.tile(rng.choice([-1.0, 1.0], 2), (2, 1))
            part = min(left, rng.exponential(0.5))
            end = roll_out(end, held, np.array([part]), constants, 0.01)[-1]
            left -= part
        farthest = FASTEST * (duration - table.lost(start[2:], heading)[index])
        way = float(end[:2] @ (math.cos(heading), math.sin(heading)))
        shares.append(way / farthest)
        assert way <= farthest + 1e-9
    assert max(shares) > 0.6  # some are near


def test_best_orientation_loses_nothing_and_the_worst_one_does() -> None:
    table = table_of(TABLE_1)
    # Body (1, 1, 0) is along the axis about which the sphere rolls to x: a turn about z.
    best = table.lost(rotation.exponential(np.array([0.0, 0.0, 0.25 * math.pi])), 0.0)
    assert np.all(best <= 1e-3)
    worst = table.lost(rotation.exponential(np.array([0.5 * math.pi, 0.0, 0.0])), 0.0)
    assert worst[-1] > 0.05
    rng = np.random.default_rng(1)
    lost = np.array([table.lost(rotation.random_quaternion(rng), 1.0) for _ in range(50)])
    assert np.all(np.diff(lost, axis=1) >= 0.0) and np.all(lost >= 0.0)
    assert np.median(lost[:, -1]) > 0.05, "as of most, which are not on an edge of the table"


def test_symmetries_of_the_robot_change_nothing() -> None:
    table, rng = table_of(HEAVY_ROTORS), np.random.default_rng(4)
    turns = [
        rotation.exponential(0.5 * math.pi * np.array(axis))
        for axis in ((0.0, 0.0, 1.0), (2.0, 0.0, 0.0), (math.sqrt(2.0), math.sqrt(2.0), 0.0))
    ]
    vertical = rotation.exponential(np.array([0.0, 0.0, 0.7]))
    for _ in range(20):
        quaternion, heading = rotation.random_quaternion(rng), float(rng.uniform(-3.0, 3.0))
        # A half turn about the horizontal axis across the direction.
        across = math.pi * np.array([-math.sin(heading), math.cos(heading), 0.0])
        equal = [(rotation.product(quaternion, turn), heading) for turn in turns] + [
            (-quaternion, heading), (rotation.product(vertical, quaternion), heading + 0.7),
            (rotation.product(rotation.exponential(across), quaternion), heading),
        ]
        lost = table.lost(quaternion, heading)
        for turned, there in equal:
            np.testing.assert_allclose(table.lost(turned, there), lost, atol=1e-9)


def test_rates_are_those_of_the_model() -> None:
    robot, rng = HEAVY_ROTORS, np.random.default_rng(6)
    grid, rate = grid_of(robot), rate_of(robot)
    for _ in range(20):
        quaternion = rotation.random_quaternion(rng)
        before = angles_of(quaternion, 0.0)
        if not 0.1 < before[0] < 1.3:
            continue
        for inputs in INPUTS:
            # In the mirrored body the second input is the opposite one.
            axis = rotation.matrix(quaternion)[1]
            real = (inputs[0], -inputs[1]) if axis[2] < 0.0 else inputs
            rates = rate([0.0, 0.0, *quaternion], real).full().ravel()
            after = angles_of(quaternion + 1e-6 * rates[2:], 0.0)
            change = (after - before + math.pi) % (2.0 * math.pi) - math.pi
            expected = np.array(grid.rates(inputs, before))
            found = [rates[0], *(change / 1e-6)]
            np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-4)


def test_goal_farther_than_the_table_takes_the_rest_at_full_speed() -> None:
    table, rng = table_of(TABLE_1), np.random.default_rng(7)
    start, goal = rotation.random_quaternion(rng), rotation.random_quaternion(rng)
    near, far = (table.least_time(way, start, goal, 0.4) for way in (5.0, 500.0))
    assert far - near == pytest.approx(495.0 / FASTEST, rel=1e-12)
    lost = table.lost(start, 0.4)[-1] + table.lost(goal, 0.4 + math.pi)[-1]
    assert near == pytest.approx(5.0 / FASTEST + lost, rel=1e-12)
    assert table.least_time(0.0, start, goal, 0.4) == 0.0
    times = [table.least_time(way, start, goal, 0.4) for way in np.linspace(0.0, 5.0, 50)]
    assert np.all(np.diff(times) > 0.0)


def test_table_is_kept(tmp_path, monkeypatch, caplog, capsys) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(displacement_table, "SIZE", 8)
    monkeypatch.setattr(displacement_table, "_HORIZON", 0.5)
    constants, rng = RobotParameters().lumped, np.random.default_rng(8)
    quaternion = rotation.random_quaternion(rng)

    def lost() -> Vector:
        displacement_table._table.cache_clear()
        return displacement_table.displacement_table(constants).lost(quaternion, 0.0)

    first = lost()
    (file,) = (tmp_path / "sphere_nmpc").iterdir()
    with monkeypatch.context() as patched:
        patched.setattr(displacement_table, "computed_table", None)
        np.testing.assert_array_equal(lost(), first)
    for damaged in (b"", file.read_bytes()[:1000], b"PK\x03\x04 no table"):
        file.write_bytes(damaged)
        np.testing.assert_array_equal(lost(), first)
        assert len(file.read_bytes()) > 1000
    assert not caplog.records
    file.unlink()
    file.parent.rmdir()
    file.parent.write_text("no folder")
    np.testing.assert_array_equal(lost(), first)
    assert "cannot be written" in caplog.text
    displacement_table._table.cache_clear()


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


@each_robot
@pytest.mark.parametrize(
    ("steady", "peak"), [(0.0, 0.3), (0.0, 1.0), (0.7, 1.0), (20.0, 1.0)], ids=str
)
def test_straight_rolling_attains_the_bound(robot, steady, peak) -> None:
    start = make_state([0.3, -0.2], [1.0, 0.0, 0.0, 0.0])
    knots = trapezoid(robot, np.array([1.0, -1.0]), steady, peak)
    goal = moved(robot, start, knots)
    seconds = sum(duration for duration, _ in knots)
    assert lower_bound(start, goal, robot) == pytest.approx(seconds, abs=ATTAINED)


@each_robot
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


@each_robot
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
