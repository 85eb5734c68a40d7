# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The simulator: its clock, commands and process noise, and its pose sensor."""

import math
from dataclasses import replace

import numpy as np
import pytest

from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector, angle_error, as_state
from sphere_nmpc.ros.settings import OdometryNodeSettings
from sphere_sim.scenario.scenarios import PAPER_CASES
from sphere_sim.world.clock import SimulatedClock
from sphere_sim.world.settings import SimulatorSettings
from sphere_sim.world.simulator import Simulator

MS = 1_000_000
POSE, SAMPLE = 10 * MS, 500 * MS


def clock_at_zero(**settings) -> SimulatedClock:
    clock = SimulatedClock(POSE, SAMPLE, **settings)
    clock.restart(0, 0.0)
    return clock


def run(clock: SimulatedClock, until: int, wall: float, cost: float = 0.0) -> float:
    """Advance as a node would, each instant at a price of `cost` [s]; return the wall time."""
    now = 0
    while now < until:
        wall += clock.wait(now, wall)
        now = clock.upcoming(now)
        clock.advanced(now, wall)
        wall += cost
    return wall


@pytest.mark.parametrize(("factor", "wall"), [(0.5, 4.0), (1.0, 2.0), (20.0, 0.1), (0.0, 0.0)])
def test_pace_is_kept(factor, wall) -> None:
    assert run(clock_at_zero(real_time_factor=factor), 2000 * MS, 0.0) == pytest.approx(wall)
    changed = clock_at_zero()
    changed.set_pace(factor, 0, 0.0)
    assert run(changed, 2000 * MS, 0.0) == pytest.approx(wall)


def test_time_lost_to_a_slow_machine_is_given_up() -> None:
    clock = clock_at_zero()
    wall = run(clock, 1000 * MS, 0.0, cost=0.020)
    assert wall == pytest.approx(2.0, rel=0.05)
    assert clock.lost == pytest.approx(1.0, abs=0.15)
    assert clock.achieved(1000 * MS, wall) == pytest.approx(0.5, rel=0.05)


def test_lockstep_steps_to_a_sample_and_waits_for_the_command_of_its_instant() -> None:
    stepped, clock = (
        clock_at_zero(lockstep=True, real_time_factor=0.0, paused=True) for _ in range(2)
    )
    assert stepped.step(0, 0.0) == SAMPLE
    stepped.command_received(0, 0.0)
    stepped.set_sample_period(400 * MS, 0.0)
    now = 0
    while stepped.wait(now, 1.0) == 0.0:
        now = stepped.upcoming(now)
        stepped.advanced(now, 1.0)
    assert now == 400 * MS and stepped.paused
    clock.command_received(0, 0.0)
    clock.resume(0, 0.0)
    assert clock.wait(0, 1.0) == pytest.approx(4.0), "for one sent after the pause"
    clock.command_received(SAMPLE, 1.0)
    assert clock.wait(0, 1.0) > 0.0
    clock.command_received(0, 1.0)
    assert clock.wait(0, 1.0) == 0.0
    clock.advanced(POSE, 1.0)
    assert clock.wait(POSE, 1.0) == 0.0
    clock.advanced(SAMPLE, 1.0)
    assert clock.awaited == SAMPLE


def test_wait_in_lockstep_ends_after_its_timeout_but_never_without_a_controller() -> None:
    clock = clock_at_zero(lockstep=True, lockstep_timeout=2.0)
    clock.resume(0, 0.0)
    assert clock.wait(0, 100.0, controller_found=False) == math.inf
    assert clock.wait(0, 200.0) == pytest.approx(2.0) and clock.timeouts == 0
    clock.wait(0, 202.0)
    assert clock.timeouts == 1 and clock.awaited is None


def test_simulation_on_the_system_clock_catches_up_after_a_standstill() -> None:
    clocks = [SimulatedClock(10 * MS, 250 * MS, keeps_up=keeps_up) for keeps_up in (True, False)]
    for clock in clocks:
        clock.restart(0, 100.0)
        assert clock.due(0, 100.0) == 10 * MS
    assert clocks[1].due(10 * MS, 103.456) == 20 * MS, "one instant at a time"
    clock = clocks[0]
    assert clock.due(10 * MS, 103.456) == 3450 * MS, "the newest instant that has passed"
    clock.advanced(3450 * MS, 103.457)
    assert clock.lost == 0.0
    assert clock.wait(3450 * MS, 103.457) == pytest.approx(0.003)


SECOND, MILLISECOND = 1_000_000_000, 1_000_000
WITHIN_LIMITS = FirstOrderHold(
    np.array([0.0, 0.5, 1.0131, 1.3]), np.array([[0, 0], [90, -70], [-60, 80], [0.0, 0.0]])
)


def simulator(hold: FirstOrderHold | None = None, **changes: object) -> Simulator:
    made = Simulator(replace(SimulatorSettings(), **changes), RobotParameters())
    if hold is not None:
        made.follower.follow_trajectory(hold)
    return made


def test_odometry_and_case_1_begin_where_the_simulator_does() -> None:
    start = SimulatorSettings().initial_state
    assert OdometryNodeSettings().initial_state == start
    np.testing.assert_array_equal(as_state(start), PAPER_CASES[1].start)


def test_starts_at_rest_at_the_normalised_initial_state_and_goes_back_there() -> None:
    world, start = simulator(), simulator().plant.state
    np.testing.assert_allclose(start[:2], [2.0, -3.0])
    assert np.linalg.norm(start[2:6]) == pytest.approx(1.0, abs=1e-15)
    for then in (1, 12_345_678, 500_000_000, 500_000_001, 1_700_000_003):
        world.advance_to(then)
        assert world.now == then
    np.testing.assert_allclose(world.plant.state, start, atol=1e-15)
    world.follower.follow_trajectory(WITHIN_LIMITS.delayed(world.time))
    world.advance_to(2400 * MILLISECOND)
    assert np.linalg.norm(world.plant.state - start) > 0.01
    world.reset()
    world.advance_to(2900 * MILLISECOND)
    np.testing.assert_array_equal(world.plant.rotor_speeds, [0.0, 0.0])
    np.testing.assert_allclose(world.plant.state, start, atol=1e-15)


# A command that jumps is evaluated every 10 ms; 2e-5 was seen.
@pytest.mark.parametrize(("jumps", "tolerance"), [(False, 1e-7), (True, 1e-3)])
@pytest.mark.parametrize("chunk", [3_333_333, 123_456_789])
def test_states_do_not_depend_on_the_chunks_in_which_time_passes(chunk, jumps, tolerance) -> None:
    whole, cut = (simulator(None if jumps else WITHIN_LIMITS) for _ in range(2))
    if jumps:
        for world in (whole, cut):
            world.follower.follow_speeds(np.array([50.0, -33.0]), 0.0)
    whole.advance_to(SECOND)
    while cut.now < whole.now:
        cut.advance_to(min(cut.now + chunk, whole.now))
    np.testing.assert_allclose(cut.plant.state, whole.plant.state, atol=tolerance)


def disturbances(seed: int, number: int = 400, measured: bool = True) -> Vector:
    """Return what each noise period added to a sphere at rest, shape (number, 6)."""
    world = simulator(process_noise=1e-3, seed=seed, noise_period=0.01, position_noise=1e-2)
    states = [world.plant.state]
    for i in range(number):
        world.advance_to(10 * MILLISECOND * (i + 1))
        states.append(world.plant.state)
        if measured:
            world.measured_state()
    return np.diff(np.array(states), axis=0)


def test_process_noise_has_the_given_deviation_in_all_directions() -> None:
    added = disturbances(seed=5)
    # 400 draws: the deviation of a deviation is 1 / sqrt(800) = 3.5 %; four of these.
    np.testing.assert_allclose(np.std(added[:, :2], axis=0), 1e-3, rtol=0.15)
    assert np.all(np.abs(np.mean(added, axis=0)) < 4e-3 / np.sqrt(400))
    # One of the four directions of the quaternion is taken back by its unit norm.
    squares = np.mean(np.sum(added[:, 2:] ** 2, axis=1))
    assert squares == pytest.approx(3e-6, rel=0.2)
    assert abs(np.corrcoef(added[:-1, 0], added[1:, 0])[0, 1]) < 0.2  # white
    np.testing.assert_array_equal(disturbances(5, 20, measured=False), added[:20])
    assert not np.any(disturbances(4, 20)[:, 0] == added[:20, 0])


def test_sensor_noise_has_the_deviations_asked_for_and_leaves_the_plant_alone() -> None:
    world = simulator(position_noise=0.02, orientation_noise=0.05)
    true = world.plant.state
    seen = np.array([world.measured_state() for _ in range(500)])
    np.testing.assert_array_equal(world.plant.state, true)
    np.testing.assert_allclose(np.std(seen[:, :2] - true[:2], axis=0), 0.02, rtol=0.15)
    np.testing.assert_allclose(np.linalg.norm(seen[:, 2:], axis=1), 1.0, atol=1e-14)
    angles = np.array([angle_error(s, true) for s in seen])
    # Three axes of 0.05 rad each.
    assert np.mean(angles**2) == pytest.approx(3 * 0.05**2, rel=0.15)


def poses(step: int = 10, **changes: object) -> list[tuple[int, int, Vector]]:
    """Return time of delivery, stamp and pose of each measurement, read every `step` [ms]."""
    made = simulator(WITHIN_LIMITS, **changes)
    found = [(0, *seen) for seen in made.poses()]
    for now in range(step * MILLISECOND, SECOND + 1, step * MILLISECOND):
        made.advance_to(now)
        found += [(now, *seen) for seen in made.poses()]
    return found


def test_pose_is_the_state_at_its_stamp_and_comes_with_the_rate_and_latency_asked_for() -> None:
    plain, late = poses(), poses(sensor_rate=20.0, sensor_latency=0.03)
    assert [now for now, _, _ in plain] == [stamp for _, stamp, _ in plain]
    assert [stamp for _, stamp, _ in late] == [50 * MILLISECOND * i for i in range(20)]
    assert all(now - stamp == 30 * MILLISECOND for now, stamp, _ in late)
    # The two take their steps at other instants: the plant's integrator makes a small difference.
    truth = simulator(WITHIN_LIMITS)
    for _, stamp, pose in late:
        truth.advance_to(stamp)
        np.testing.assert_allclose(pose, truth.plant.state, atol=1e-9)
    settings = dict(
        sensor_latency=0.05, sensor_dropout=0.3, position_noise=0.01, seed=4, sensor_rate=20.0
    )
    often, rarely = (poses(step, **settings) for step in (10, 250))
    assert 0 < len(often) < 20
    for (_, *seen), (_, *later) in zip(often, rarely, strict=True):
        np.testing.assert_equal(seen, later, "they do not depend on when they are read")
