# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The certificate that a motion keeps clear, and straight lines, by integrated motions."""

import math
from dataclasses import replace

import numpy as np
import pytest
from floor_plans import CLOSED, RADIUS, floor_of, least_distance, pose, rolled
from sampled_loop import ROBOT, check_hold

from sphere_nmpc.floor.floor import Floor
from sphere_nmpc.floor.occupancy import Grid
from sphere_nmpc.model import rotation
from sphere_nmpc.model.disturbance import GRAVITY, Disturbance
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import LumpedConstants, RobotParameters
from sphere_nmpc.model.plant import PlantEstimate
from sphere_nmpc.model.state import POSITION, QUATERNION, Vector, without_momentum
from sphere_nmpc.solver.half_motions import Side
from sphere_nmpc.solver.roll_out import roll_out
from sphere_nmpc.strategy import clearance
from sphere_nmpc.strategy.clearance import (
    Margin,
    bound_of_speed,
    certified,
    clearance_of,
    end_before_collisions,
    is_clear,
    needed_distance,
    plain_certified,
    profile_of,
    refusal,
    stop_before_contact,
)
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.time_optimal.lines import line_hold, speeds_along
from sphere_nmpc.strategy.time_optimal.search_task import solver_for
from sphere_nmpc.strategy.time_optimal.settings import TimeOptimalSettings

pytestmark = pytest.mark.slow

SOLVER = solver_for(ROBOT, TimeOptimalSettings())
CONSTANTS = ROBOT.lumped.as_array()
STILL = np.zeros(2)


def tilted(z_vertical: float, rng: np.random.Generator) -> Vector:
    """Return an orientation whose body's z axis has this vertical component."""
    turn = rotation.exponential(np.array((math.acos(z_vertical), 0.0, 0.0)))
    about = [rotation.exponential(np.array((0.0, 0.0, a))) for a in rng.uniform(-3.0, 3.0, 2)]
    return rotation.product(about[0], rotation.product(turn, about[1]))


def path_of(state: Vector, hold: FirstOrderHold, count: int = 400) -> Vector:
    """Return the positions along a hold, shape (count, 2)."""
    times = np.linspace(0.0, hold.end, count)
    return roll_out(state, hold.resampled(times).speeds, np.diff(times), CONSTANTS)[:, POSITION]


@pytest.mark.parametrize("vertical", [None, 0.1, 0.0068, -0.004, 0.0])
def test_straight_lines_from_any_orientation(vertical: float | None) -> None:
    """The path of the model leaves the line by 3 mm at the most, and by 1 mm in the median."""
    rng, across = np.random.default_rng(0), []
    for _ in range(40 if vertical is None else 10):
        turn = rotation.random_quaternion(rng) if vertical is None else tilted(vertical, rng)
        state = without_momentum(pose(0.0, 0.0, tuple(turn)))
        target = rng.uniform(-1.5, 1.5, 2)
        hold = line_hold(state, target, ROBOT.lumped, SOLVER)
        assert hold is not None and not hold.speeds[0].any()
        check_hold(hold)
        path, along = path_of(state, hold, 500), target / np.linalg.norm(target)
        across.append(np.abs(path @ np.array((-along[1], along[0]))).max())
        assert np.linalg.norm(path[-1] - target) < 3e-3
    assert max(across) < 3e-3 and np.median(across) < 1e-3


def test_the_constant_of_a_line_is_kept_up_to_the_circle() -> None:
    """That of the motion that the rotor speeds lead to, integrated in finite steps."""
    rng, power = np.random.default_rng(3), 1.0 / (1.0 - ROBOT.lumped.axial_ratio)
    for _ in range(5):
        turn, heading = tilted(0.4, rng), rng.uniform(-3.0, 3.0)
        direction = np.array((math.cos(heading), math.sin(heading)))
        axis = np.array((-direction[1], direction[0], 0.0))
        at, speeds = speeds_along(turn, direction, 3.0, ROBOT.lumped)
        state = without_momentum(pose(0.0, 0.0, tuple(turn)))
        states = roll_out(state, speeds, np.diff(at), CONSTANTS)
        z = np.array([rotation.matrix(q)[:, 2] for q in states[:, QUATERNION]])
        before = np.minimum.accumulate(z[:, 2]) > 0.0
        constant = z[0] @ axis / z[0, 2] ** power
        expected = np.where(before, constant * np.abs(z[:, 2]) ** power, 0.0)
        np.testing.assert_allclose(z @ axis, expected, atol=1e-3)
        np.testing.assert_allclose(states[-1, POSITION], 3.0 * RADIUS * direction, atol=1e-3)


def both(situation: Situation, hold: FirstOrderHold, needed: float) -> float:
    """Return the distance that is certified, by the compiled certificate as by the plain one."""
    found = certified(situation, hold, needed)
    np.testing.assert_allclose(found, plain_certified(situation, hold, needed), rtol=1e-9)
    return found


def test_the_certificate_bounds_the_clearance_of_the_motion() -> None:
    rng = np.random.default_rng(3)
    walls = floor_of([(2.0, 2.0, 2.5, 2.3), (4.0, 0.5, 4.1, 3.0)])
    turned = Floor(Grid(walls.grid.occupied, 0.05, (0.3, -0.2, 0.4)), RADIUS, 0.02)
    refused, bounded = [], 0
    for k in range(200):
        floor = (walls, turned)[k % 2]
        place = floor.grid.world(rng.uniform((4, 4), (116, 76)))
        state = without_momentum(pose(*place, tuple(rotation.random_quaternion(rng))))
        state[6:] = (0.0, rng.normal())[k % 3 == 0] * rng.normal(size=3)
        times = np.cumsum(rng.uniform(0.05, 0.5, 5)) - 0.05
        hold = FirstOrderHold(times - times[0], rng.uniform(-60.0, 60.0, (5, 2)))
        now = Situation.of(0.0, state, state[:6], STILL, ROBOT.lumped, floor=floor)
        refused.append(math.isnan(both(now, hold, floor.needed)))
        found = clearance_of(now, hold, Margin.FOUND)
        exact = least_distance(floor, path_of(state, hold)) - RADIUS
        if math.isnan(found):
            # Short by no more than the steps of the map and of the samples can explain.
            allowed = floor.clearance + Margin.FOUND.value * RADIUS
            assert exact < allowed + 0.03 or floor.distance(place) - RADIUS < allowed
        elif floor.distance(place) > floor.needed + 0.02:
            bounded += 1
            assert exact >= min(found, 0.69) - 1e-6
            assert found >= floor.clearance
        fine, coarse = (profile_of(now, hold, spacing).places for spacing in (0.005, 0.04))
        np.testing.assert_allclose(coarse[-1], fine[-1], atol=1e-6)
    assert 40 < sum(refused) < 160 and bounded > 20


def test_what_is_certified_with_a_margin_is_with_all_that_are_less() -> None:
    """A start with less than a margin asks less of a motion; such a plan was found, not followed.

    Millimetres from a wall, where the margins differ.
    """
    rng, wall = np.random.default_rng(6), floor_of(CLOSED)
    certified_with = dict.fromkeys(Margin, 0)
    for _ in range(400):
        away = RADIUS + wall.clearance + RADIUS * rng.uniform(0.0, 0.025)
        state = without_momentum(pose(3.0 - away, 2.0, tuple(rotation.random_quaternion(rng))))
        now = Situation.of(0.0, state, pose(1.0, 2.0), STILL, ROBOT.lumped, floor=wall)
        angle = rng.uniform(0.5, 1.5) * math.pi
        target = state[POSITION] + 0.3 * np.array((math.cos(angle), math.sin(angle)))
        hold = line_hold(state, target, ROBOT.lumped, SOLVER)
        clear = [hold is not None and is_clear(now, hold, margin) for margin in Margin]
        assert clear == sorted(clear), (away, clear)
        for margin, one in zip(Margin, clear, strict=True):
            certified_with[margin] += one
    assert 20 < certified_with[Margin.FOUND] < certified_with[Margin.SENT]


@pytest.mark.parametrize("yaw", [0.0, 0.4])
def test_half_motions_end_before_they_collide(monkeypatch, yaw: float) -> None:
    """By the compiled solver as by the plain one, at places inside and outside of the floor."""
    rng, walls = np.random.default_rng(4), floor_of([(2.0, 2.0, 2.5, 2.3)])
    floor = Floor(Grid(walls.grid.occupied, 0.05, (0.3, -0.2, yaw)), RADIUS, 0.02)
    beyond = floor.grid.world(np.array((30.0, 30.0)))
    assert floor.distance(beyond) > floor.needed
    here = pose(*beyond)
    now = Situation.of(0.0, without_momentum(here), here, STILL, ROBOT.lumped, floor=floor)
    states = np.zeros((12, 6, 500), dtype=np.float32)
    states[1:, :2] = np.cumsum(rng.normal(scale=0.3, size=(11, 2, 500)), axis=0)
    found, plain = (Side(pose(0.0, 0.0), states.copy(), *2 * [np.zeros(500)]) for _ in range(2))
    end_before_collisions(now, found, beyond)
    monkeypatch.setattr(clearance, "library", lambda: None)
    end_before_collisions(now, plain, beyond)
    np.testing.assert_array_equal(found.states, plain.states)
    ended = np.isinf(found.states[:, 0]).any(axis=0)
    assert 100 < np.count_nonzero(ended) < 480 and np.isfinite(found.states[0]).all()


def on_a_line(distance: float) -> Situation:
    """Situation at a distance [m] from the wall of a floor, on a line where bounds are exact."""
    state = without_momentum(pose(3.0 - distance, 2.0))
    return Situation.of(0.0, state, pose(1.0, 2.0), STILL, ROBOT.lumped, floor=floor_of(CLOSED))


@pytest.mark.parametrize("distance", [-0.05, 0.0, 0.4e-3, 0.9e-3])
def test_no_motion_leads_into_or_on_inside_of_what_is_occupied(distance: float) -> None:
    """Also from less than the decrease before it that counts as none."""
    now = on_a_line(distance)
    assert math.isnan(both(now, rolled(0.3), needed_distance(now, Margin.KEPT)))


@pytest.mark.parametrize("beyond", [0.1e-3, 0.6e-3, 1.3e-3])
def test_a_start_without_clearance_is_not_certified_into_a_contact(beyond: float) -> None:
    """A fall of 1 mm counted as none, and where it was short nothing bound the path between."""
    now, toward = on_a_line(RADIUS + beyond), rolled(beyond + 0.2e-3)
    needed = needed_distance(now, Margin.KEPT)
    assert profile_of(now, toward, 1e-3).distances.min() < RADIUS
    assert math.isnan(both(now, toward, needed))
    assert both(now, rolled(-0.02), needed) > RADIUS - 1e-9


SMALL = RobotParameters(
    shell_radius=0.1, rotor_offset=0.05, shell_inertia=0.06 / 9.0, rotor_axial_inertia=0.006,
    counterweight_axial_inertia=0.006,
)


@pytest.mark.parametrize("robot", [ROBOT, SMALL], ids=["It2 > It1", "It2 < It1"])
def test_the_bound_of_the_way_holds_with_momentum_and_imbalance(robot: RobotParameters) -> None:
    assert (robot.axial_inertia < robot.transverse_inertia) is (robot is SMALL)
    rng, constants = np.random.default_rng(5), robot.lumped
    # Of a centre of mass that is beside the centre by 3 per cent of the radius.
    most = 0.03 * GRAVITY * constants.transverse_ratio / (
        constants.input_gain * constants.shell_radius
    )
    closest = 0.0
    for k in range(400):
        state = without_momentum(pose(0.0, 0.0, tuple(rotation.random_quaternion(rng))))
        z = rotation.matrix(state[2:6])[:, 2]
        state[6:] = 60.0 * (z if k % 2 else rng.normal(size=3))
        centre = rng.normal(size=3)
        disturbance = Disturbance(imbalance=most * centre / np.linalg.norm(centre))
        speeds = rng.uniform(-100.0, 100.0, 2) * (k % 3 > 0)
        hold = FirstOrderHold(np.array([0.0, 0.02]), np.vstack((speeds, speeds)))
        now = Situation.of(0.0, state, pose(1.0, 1.0), STILL, constants, disturbance=disturbance)
        path, _, lengths = profile_of(now, hold, 1e-3)
        ways = np.linalg.norm(np.diff(path, axis=0), axis=1)
        assert ways.size == lengths.size and (ways <= lengths + 1e-9).all()
        closest = max(closest, float((ways / lengths).max()))
    assert closest > 0.85


def fastest_rolling(constants: LumpedConstants, b: Vector, count: int, rotors: bool) -> float:
    """Return the largest speed found [Rs c1], with z as first axis, over random orientations."""
    d, r1 = constants.transverse_ratio / constants.axial_ratio, constants.transverse_ratio
    found, z = 0.0, np.diag([1.0, 0.0, 0.0])
    for angle in np.linspace(0.0, 0.5 * np.pi, count):
        for around in np.linspace(0.0, 2.0 * np.pi, 12 if b.any() else 1, endpoint=False):
            side = math.sin(angle)
            e = np.array([math.cos(angle), side * math.cos(around), side * math.sin(around)])
            inertia = np.eye(3) * (1.0 + 2.0 * b @ e) + (d - 1.0) * z - r1 * np.outer(e, e)
            inertia -= np.outer(b, e) + np.outer(e, b)
            rates = (np.eye(3) - np.outer(e, e)) @ np.linalg.inv(inertia)
            found = max(found, float(np.linalg.norm(rates[:, 1:] if rotors else rates, 2)))
    return found


def test_no_robot_rolls_faster_than_the_bound_of_speed_and_some_nearly_as_fast() -> None:
    """Also with ratios that no body has, but a robot that is learnt may."""
    rng = np.random.default_rng(8)
    given = [ROBOT.lumped, LumpedConstants(0.1, 0.02, 0.93, 0.87)]
    given += [LumpedConstants(0.1, 0.02, *rng.uniform(0.2, 0.98, 2)) for _ in range(40)]
    for k, constants in enumerate(given):
        state = without_momentum(pose(0.0, 0.0))
        unit = constants.shell_radius * constants.input_gain
        resting = Situation.of(0.0, state, state[:6], STILL, constants)
        moved = replace(resting, state=np.concatenate((state[:6], [1.0, 0.0, 0.0])))
        for now, rotors in ((resting, True), (moved, False)):
            factor = bound_of_speed(now) / unit
            exact = fastest_rolling(constants, np.zeros(3), 600, rotors)
            assert exact <= factor * (1.0 + 1e-9) and factor < exact * (1.0 + 1e-3)
        if k < 2:
            assert factor == pytest.approx((1.0, 1.0293079)[k], abs=1e-6)
        beside = rng.normal(size=3)
        beside *= rng.uniform(0.0, 0.03) / np.linalg.norm(beside)
        imbalance = Disturbance(imbalance=beside * GRAVITY / unit)
        factor = bound_of_speed(replace(moved, disturbance=imbalance)) / unit
        if factor < 3.0:  # the bound of a centre of mass that leaves some inertia
            assert fastest_rolling(constants, np.roll(beside, 1), 60, False) <= factor


def test_what_is_told_of_a_start_without_clearance_bounds_the_clearance_of_the_motion() -> None:
    rng, lines = np.random.default_rng(4), 0
    for _ in range(200):
        distance = RADIUS + float(rng.uniform(1e-4, 0.02))
        now = on_a_line(distance)
        state = now.state.copy()
        state[2:6] = rotation.random_quaternion(rng)
        now = replace(now, state=state)
        hold = FirstOrderHold(0.1 * np.arange(5), rng.uniform(-100.0, 100.0, (5, 2)))
        found = both(now, hold, needed_distance(now, Margin.KEPT))
        if not math.isnan(found):
            lines += 1
            assert least_distance(now.floor, path_of(state, hold)) >= found - 1e-6
    assert lines > 8


def test_one_radius_is_asked_for_everywhere() -> None:
    now = on_a_line(0.8)
    larger, smaller = (
        replace(now, plant=PlantEstimate(replace(ROBOT.lumped, shell_radius=radius)))
        for radius in (0.36, 0.2)
    )
    assert (larger.radius, smaller.radius) == (0.36, RADIUS)
    assert (larger.least_distance, smaller.least_distance) == (0.36, now.floor.needed)
    assert needed_distance(larger, Margin.SENT) == 0.36
    still = FirstOrderHold(np.array([0.0, 1.0]), np.zeros((2, 2)))
    apart = clearance_of(now, still, Margin.KEPT) - clearance_of(larger, still, Margin.KEPT)
    assert apart == pytest.approx(0.06)
    touching = 0.8 - 0.33
    assert not stop_before_contact(now, rolled(touching))
    assert stop_before_contact(larger, rolled(touching * RADIUS / 0.36))


@pytest.mark.parametrize("clearance", [0.0, 0.03])
def test_a_goal_at_just_the_distance_is_not_refused_as_the_learnt_radius_varies(
    clearance: float,
) -> None:
    floor = floor_of([], clearance)
    start, goal = without_momentum(pose(3.0, 2.0)), pose(floor.needed, 2.0)
    for learnt in RADIUS + 1e-3 * np.linspace(-0.5, 0.5, 11):
        constants = replace(ROBOT.lumped, shell_radius=float(learnt))
        now = Situation.of(0.0, start, goal, STILL, constants, floor=floor)
        assert refusal(now, floor) is None
