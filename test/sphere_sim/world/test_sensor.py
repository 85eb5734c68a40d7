# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The pose sensor: sampling, latency, losses, and the same for the same seed."""

import numpy as np

from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector
from sphere_nmpc.quantity import NANOSECONDS
from sphere_sim.world.settings import SimulatorSettings
from sphere_sim.world.simulator import Simulator

MILLISECOND = NANOSECONDS // 1000


def world(**changes: float) -> Simulator:
    made = Simulator(SimulatorSettings(**changes), RobotParameters())
    ramp = FirstOrderHold(np.array([0.0, 1.0]), np.array([[0.0, 0.0], [60.0, -40.0]]))
    made.follower.follow_trajectory(ramp)
    return made


def poses(made: Simulator, step: int, end: int = NANOSECONDS) -> list[tuple[int, int, Vector]]:
    """Return time of delivery, stamp and pose of each measurement."""
    found = [(0, *seen) for seen in made.poses()]
    for now in range(step, end + 1, step):
        made.advance_to(now)
        found += [(now, *seen) for seen in made.poses()]
    return found


def test_plain_sensor_measures_at_each_call() -> None:
    made = world()
    seen = poses(made, 10 * MILLISECOND)
    assert [now for now, _, _ in seen] == [stamp for _, stamp, _ in seen]
    assert len(seen) == 101
    np.testing.assert_array_equal(seen[-1][2], made.plant.state)


def test_rate_latency_and_stamp_are_those_of_the_settings() -> None:
    seen = poses(world(sensor_rate=20.0, sensor_latency=0.03), 10 * MILLISECOND)
    assert [stamp for _, stamp, _ in seen] == [50 * MILLISECOND * i for i in range(20)]
    assert all(now - stamp == 30 * MILLISECOND for now, stamp, _ in seen)


def test_pose_is_the_state_at_its_stamp() -> None:
    late, truth = world(sensor_rate=20.0, sensor_latency=0.2), world()
    # The two take their steps at other instants: the plant's integrator makes a small difference.
    for _, stamp, pose in poses(late, 10 * MILLISECOND):
        truth.advance_to(stamp)
        np.testing.assert_allclose(pose, truth.plant.state, atol=1e-9)


def test_measurements_do_not_depend_on_when_poses_are_read() -> None:
    settings = dict(
        sensor_rate=20.0, sensor_latency=0.05, sensor_dropout=0.3, position_noise=0.01,
        orientation_noise=0.02, seed=4,
    )
    often, rarely = (
        poses(world(**settings), step) for step in (10 * MILLISECOND, 250 * MILLISECOND)
    )
    for (_, stamp, pose), (_, other_stamp, other_pose) in zip(often, rarely, strict=True):
        assert stamp == other_stamp
        np.testing.assert_array_equal(pose, other_pose)


def test_sensor_without_a_rate_measures_at_the_pose_rate_whenever_poses_are_read() -> None:
    settings = dict(sensor_latency=0.03, sensor_dropout=0.3, pose_rate=50.0, seed=4)
    often, rarely = (
        poses(world(**settings), step) for step in (10 * MILLISECOND, 250 * MILLISECOND)
    )
    assert {stamp % (20 * MILLISECOND) for _, stamp, _ in often} == {0}
    assert [stamp for _, stamp, _ in often] == [stamp for _, stamp, _ in rarely]


def test_losses_have_the_given_share_and_do_not_change_other_poses() -> None:
    noisy = dict(sensor_rate=1000.0, position_noise=0.01, seed=2)
    whole = {stamp: pose for _, stamp, pose in poses(world(**noisy), 10 * MILLISECOND)}
    seen = poses(world(**noisy, sensor_dropout=0.2), 10 * MILLISECOND)
    # Five standard deviations of 1000 draws.
    assert abs(len(seen) / len(whole) - 0.8) < 0.065
    for _, stamp, pose in seen:
        np.testing.assert_array_equal(pose, whole[stamp])
