# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The simulator: its clock, commands and noise."""

from dataclasses import replace

import numpy as np
import pytest

from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector, angle_error
from sphere_nmpc.quantity import NANOSECONDS
from sphere_sim.world.plant.rolling_plant import RollingPlant
from sphere_sim.world.settings import SimulatorSettings
from sphere_sim.world.simulator import Simulator

ROBOT = RobotParameters()
SETTINGS = SimulatorSettings()
WITHIN_LIMITS = FirstOrderHold(
    np.array([0.0, 0.5, 1.0131, 1.3]), np.array([[0, 0], [90, -70], [-60, 80], [0.0, 0.0]])
)


def simulator(**changes: object) -> Simulator:
    return Simulator(replace(SETTINGS, **changes), ROBOT)


def seconds(time: float) -> int:
    return round(time * NANOSECONDS)


def test_starts_at_rest_at_the_normalised_initial_state() -> None:
    world = simulator()
    assert world.now == 0
    np.testing.assert_allclose(world.plant.state[:2], [2.0, -3.0])
    assert np.linalg.norm(world.plant.state[2:6]) == pytest.approx(1.0, abs=1e-15)
    world.advance_to(seconds(1.0))
    np.testing.assert_allclose(world.plant.state, simulator().plant.state, atol=1e-15)


def test_time_advances_to_the_given_nanosecond() -> None:
    world = simulator()
    for then in (1, 12_345_678, 500_000_000, 500_000_001, 1_700_000_003):
        world.advance_to(then)
        assert world.now == then
    world.advance_to(0)
    assert world.now == 1_700_000_003


def test_trajectory_is_followed_as_the_plant_would_alone() -> None:
    world = simulator()
    world.follower.follow_trajectory(WITHIN_LIMITS)
    world.advance_to(seconds(1.3))
    plant = RollingPlant(ROBOT, simulator().plant.state)
    for start, end, speeds in zip(
        WITHIN_LIMITS.times, WITHIN_LIMITS.times[1:], WITHIN_LIMITS.speeds[1:], strict=False
    ):
        plant.advance(speeds, end - start)
    # Both divide the time into steps of their own: twice the method's error.
    np.testing.assert_allclose(world.plant.state, plant.state, atol=1e-6)


@pytest.mark.parametrize("chunk", [1_000_000, 3_333_333, 10_000_000, 123_456_789])
def test_states_do_not_depend_on_the_chunks_in_which_time_passes(chunk: int) -> None:
    whole, cut = simulator(), simulator()
    for world in (whole, cut):
        world.follower.follow_trajectory(WITHIN_LIMITS)
    whole.advance_to(seconds(1.5))
    while cut.now < whole.now:
        cut.advance_to(min(cut.now + chunk, whole.now))
    np.testing.assert_allclose(cut.plant.state, whole.plant.state, atol=1e-7)


@pytest.mark.parametrize("chunk", [1_000_000, 3_333_333])
def test_command_that_jumps_makes_a_difference_of_at_most_one_evaluation(chunk: int) -> None:
    whole, cut = simulator(), simulator()
    for world in (whole, cut):
        world.follower.follow_speeds(np.array([50.0, -33.0]), 0.0)
    whole.advance_to(seconds(1.0))
    while cut.now < whole.now:
        cut.advance_to(min(cut.now + chunk, whole.now))
    # The command is evaluated every 10 ms; 2e-5 was seen.
    np.testing.assert_allclose(cut.plant.state, whole.plant.state, atol=1e-3)


def test_command_that_stops_coming_ramps_the_rotors_to_rest_within_the_limit() -> None:
    world = simulator(command_timeout=0.2)
    world.follower.follow_speeds(np.array([80.0, -40.0]), 0.0)
    slopes, last = [], np.zeros(2)
    for i in range(60):
        world.advance_to(seconds(0.01 * (i + 1)))
        slopes.append((world.plant.rotor_speeds - last) / 0.01)
        last = world.plant.rotor_speeds
        if i == 19:
            np.testing.assert_allclose(last, [80.0, -40.0])
    assert np.max(np.abs(slopes)) <= ROBOT.max_rotor_acceleration + 1e-9
    np.testing.assert_array_equal(last, [0.0, 0.0])
    # 80 rad/s at 400 rad/s^2 is 0.2 s after the 0.2 s of the timeout.
    assert np.any(np.abs(slopes[38]) > 0.0)
    assert not np.any(slopes[42])


def test_trajectory_that_ends_in_motion_ramps_to_rest() -> None:
    world = simulator()
    world.follower.follow_trajectory(
        FirstOrderHold(np.array([0.0, 0.5]), np.array([[0, 0], [60.0, 60.0]]))
    )
    world.advance_to(seconds(1.0))
    np.testing.assert_array_equal(world.plant.rotor_speeds, [0.0, 0.0])


def disturbances(seed: int, number: int = 400, noise: float = 1e-3) -> Vector:
    """Return what each noise period added to a sphere at rest, shape (number, 6)."""
    world = simulator(process_noise=noise, seed=seed, noise_period=0.01)
    states = [world.plant.state]
    for i in range(number):
        world.advance_to(seconds(0.01 * (i + 1)))
        states.append(world.plant.state)
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


def test_process_noise_comes_once_a_noise_period_and_keeps_the_unit_norm() -> None:
    world = simulator(process_noise=0.1, noise_period=0.5)
    start = world.plant.state
    world.advance_to(seconds(0.499))
    np.testing.assert_array_equal(world.plant.state, start)
    world.advance_to(seconds(0.5))
    moved = world.plant.state
    assert np.linalg.norm(moved - start) > 1e-3
    assert np.linalg.norm(moved[2:6]) == pytest.approx(1.0, abs=1e-15)
    world.advance_to(seconds(0.999))
    np.testing.assert_array_equal(world.plant.state, moved)


def test_same_seed_gives_the_same_noise_and_another_one_other_noise() -> None:
    np.testing.assert_array_equal(disturbances(3, 20), disturbances(3, 20))
    assert not np.any(disturbances(3, 20)[:, 0] == disturbances(4, 20)[:, 0])


def test_reading_the_sensor_does_not_change_the_process_noise() -> None:
    quiet = simulator(process_noise=1e-3, position_noise=1e-2)
    watched = simulator(process_noise=1e-3, position_noise=1e-2)
    for i in range(8):
        for _ in range(5):
            watched.measured_state()
        for world in (quiet, watched):
            world.advance_to(seconds(0.5 * (i + 1)))
    np.testing.assert_array_equal(quiet.plant.state, watched.plant.state)


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


def test_sensor_without_noise_measures_the_state_exactly() -> None:
    world = simulator()
    np.testing.assert_array_equal(world.measured_state(), world.plant.state)


def test_reset_goes_back_to_the_start_at_rest_while_time_goes_on() -> None:
    world = simulator()
    world.follower.follow_trajectory(WITHIN_LIMITS)
    world.advance_to(seconds(0.7))
    world.reset()
    np.testing.assert_array_equal(world.plant.state, simulator().plant.state)
    assert world.now == seconds(0.7)
    world.advance_to(seconds(1.2))
    np.testing.assert_array_equal(world.plant.rotor_speeds, [0.0, 0.0])
    np.testing.assert_allclose(world.plant.state, simulator().plant.state, atol=1e-15)


def test_noise_can_be_switched_while_time_passes() -> None:
    world = simulator()
    world.change(replace(SETTINGS, process_noise=0.1))
    world.advance_to(seconds(0.5))
    assert np.linalg.norm(world.plant.state - simulator().plant.state) > 1e-3
