# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Table of the largest displacement: it is a bound, which is seen cell by cell and by motions."""

import functools
import itertools
import math

import casadi as ca
import numpy as np
import pytest
from displacement import DisplacementSteps
from displacement_table_file import computed
from orientation_grid import INPUTS, OrientationGrid
from robots import HEAVY_ROTORS

from sphere_nmpc.model import rotation
from sphere_nmpc.model.dynamics import state_rate
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector, without_momentum
from sphere_nmpc.solver.roll_out import roll_out
from sphere_sim.study.displacement_table import (
    FASTEST,
    RESOLUTION,
    DisplacementTable,
    angles_of,
    displacement_table,
)

pytestmark = pytest.mark.slow

SIZE = 24
"""Of a coarse grid: its table is a bound as any other one."""
ROBOTS = {"Table 1": RobotParameters(), "heavy rotors": HEAVY_ROTORS}


def grid_of(robot: RobotParameters, size: int = SIZE) -> OrientationGrid:
    return OrientationGrid(size, robot.lumped.transverse_ratio, robot.lumped.axial_ratio)


@functools.cache
def table_of(name: str) -> DisplacementTable:
    """Return the table of the package where there is one."""
    shipped = displacement_table(ROBOTS[name].lumped)
    return shipped or DisplacementTable(*computed(grid_of(ROBOTS[name]), 1.2))


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
    steps = DisplacementSteps(grid_of(ROBOTS["Table 1"], 12))
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


@pytest.mark.parametrize("name", ROBOTS)
def test_spline_satisfies_the_inequality_anywhere_by_the_equations_of_the_model(name) -> None:
    robot, rng = ROBOTS[name], np.random.default_rng(1)
    grid, rate = grid_of(robot, 12), rate_of(robot)
    step, found = steps_up_to(grid, 0.9)

    def spline(coefficients: Vector, quaternion: Vector) -> float:
        # The table stores the complement, in multiples of its resolution.
        stored = -coefficients[None] / RESOLUTION / FASTEST + 1e6
        table = DisplacementTable(np.zeros(1), np.zeros(1), stored)
        lost = table.lost(quaternion, 0.0)[0]
        return FASTEST * (1e6 * RESOLUTION - lost)

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


@pytest.mark.parametrize("name", ROBOTS)
def test_no_motion_gets_farther_than_the_table(name) -> None:
    table, rng = table_of(name), np.random.default_rng(2)
    constants, shares = rate_constants(ROBOTS[name]), []
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
    table = table_of("Table 1")
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
    table, rng = table_of("heavy rotors"), np.random.default_rng(4)
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
    table, rng = table_of("Table 1"), np.random.default_rng(7)
    start, goal = rotation.random_quaternion(rng), rotation.random_quaternion(rng)
    near, far = (table.least_time(way, start, goal, 0.4) for way in (5.0, 500.0))
    assert far - near == pytest.approx(495.0 / FASTEST, rel=1e-12)
    lost = table.lost(start, 0.4)[-1] + table.lost(goal, 0.4 + math.pi)[-1]
    assert near == pytest.approx(5.0 / FASTEST + lost, rel=1e-12)
    assert table.least_time(0.0, start, goal, 0.4) == 0.0
    times = [table.least_time(way, start, goal, 0.4) for way in np.linspace(0.0, 5.0, 50)]
    assert np.all(np.diff(times) > 0.0)


def test_table_of_the_package_is_that_of_the_default_robot_alone() -> None:
    table, rng = displacement_table(RobotParameters().lumped), np.random.default_rng(8)
    assert table is not None
    assert displacement_table(HEAVY_ROTORS.lumped) is None
    # On a coarser grid more is added to the displacement, so that less is lost.
    coarse = DisplacementTable(*computed(grid_of(ROBOTS["Table 1"]), 1.2))
    for _ in range(20):
        quaternion = rotation.random_quaternion(rng)
        lost = np.interp(coarse.times, table.times, table.lost(quaternion, 0.0))
        less = lost - coarse.lost(quaternion, 0.0)
        assert np.min(less) > -0.03 and np.max(less) < 0.2
