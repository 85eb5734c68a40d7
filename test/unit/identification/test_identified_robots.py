# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Robots that are drawn, identified from recordings of bench/identify.py."""

import re
from dataclasses import replace

import numpy as np
import pytest
from identify import WITHIN, Drawn, errors

from sphere_nmpc.errors import InvalidInputError
from sphere_nmpc.model.error_state import apply_error
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.solver.roll_out import roll_out
from sphere_sim.evaluation.series import Series
from sphere_sim.identification.identify import Given, Identified, identified
from sphere_sim.identification.rolling import BatchFit

SHORT = 20.0
"""Length of the recordings [s]: a third of the motion, with errors up to twice as large."""
SHORT_TIMES = np.linspace(0.0, SHORT, 2001)


def drawn(seed: int, **options: object) -> Drawn:
    return Drawn(seed, duration=SHORT, **options)  # type: ignore[arg-type]


def of(one: Drawn) -> Identified:
    return identified(one.recorded, Given(one.given))


def row(found: Identified, name: str):
    (one,) = [row for row in found.rows if row.name == name]
    return one


@pytest.fixture(scope="module")
def first() -> Drawn:
    return drawn(1)


def test_constants_lag_limits_and_noise_are_found(first) -> None:
    result = errors(first, of(first))
    assert result.keys() >= WITHIN.keys()
    for name, (size, *ratios) in result.items():
        assert size < 2.0 * WITHIN.get(name, np.inf), name
        assert np.max(np.abs(ratios)) < 5.0, name  # a million times rarer than 2


def test_parameters_of_the_file_move_as_the_true_robot_does(first) -> None:
    found = of(first)
    assert found.robot.lumped.as_array() == pytest.approx(first.robot.lumped.as_array(), rel=2e-3)
    assert found.robot.total_mass == pytest.approx(first.given.total_mass)
    assert found.robot.max_rotor_speed <= 1.001 * first.robot.max_rotor_speed


def test_poses_that_are_late_make_the_controllers_lag_longer(first) -> None:
    found = of(first)
    lag = found.controller["drive_lag"].value
    assert lag == pytest.approx(max(first.lag + first.late, 0.0), abs=1e-3)


@pytest.mark.slow
def test_mounting_of_an_imu_is_found() -> None:
    one = drawn(2, with_imu=True)
    result = errors(one, of(one))
    # Nine elements by which axes cross are 0.4 % each, of which a mounting may be three.
    assert result["imu.position"][0] < 2e-3 and result["imu.orientation"][0] < 0.01
    assert abs(result["offset of IMU stamps"][0]) < 0.5


def test_imu_with_left_handed_axes_is_named_and_the_rest_is_found() -> None:
    one = drawn(2, with_imu=True)
    readings = one.recorded.readings
    assert readings is not None
    said = list[str]()
    mirrored = replace(readings, rates=readings.rates * (-1.0, 1.0, 1.0))
    found = identified(
        replace(one.recorded, readings=mirrored), Given(one.given), progress=said.append
    )
    assert any("given left-handed axes, expected that of the shell" in text for text in said)
    assert row(found, "imu.position").deviation == ()
    assert row(found, "c1").deviation and found.odometry == {}
    degrees = replace(readings, rates=np.degrees(readings.rates))
    identified(replace(one.recorded, readings=degrees), Given(one.given), progress=said.append)
    assert "IMU: angular velocity of the IMU: given 9" in said[-2]


@pytest.mark.slow
def test_imu_and_encoders_alone_show_constants_radius_and_place() -> None:
    one = drawn(3, with_imu=True, inside=True)
    found = identified(one.recorded, Given(one.given, imu=one.known_imu))
    result = errors(one, found)
    # The radius is seen by the scale of the accelerometer and by how its axes cross.
    assert result["robot.shell_radius"][0] < 0.015
    for name in ("c1", "r1", "r3"):
        assert result[name][0] < 0.005, name
    assert result["imu.position"][0] < 2e-3
    unseen = {row.name for row in found.rows if not row.deviation}
    assert unseen == {"imu.orientation", "pose_position_noise", "pose_orientation_noise"}
    assert "half of the bag predicts the angular velocity in the other half" in found.summary


def test_outliers_are_left_out_and_slip_stays_in_its_piece(first) -> None:
    given = first.recorded.poses
    poses = given.values.copy()
    rng = np.random.default_rng(3)
    for k in rng.choice(len(poses), 60, replace=False):
        poses[k] = apply_error(poses[k], np.append(rng.normal(size=2), rng.normal(size=3)))
    poses[1000:, :2] += 0.3  # as by a slip after ten seconds
    found = identified(
        replace(first.recorded, poses=replace(given, values=poses)), Given(first.given)
    )
    result = errors(first, found)
    for name in ("robot.shell_radius", "c1", "r1", "r3"):
        assert result[name][0] < 2.0 * WITHIN[name], name
    assert re.search(r"; (5\d|6\d) of 2001 poses are outliers", found.summary)


def test_what_a_motion_about_one_axis_does_not_show_keeps_its_value() -> None:
    one = drawn(4)
    recorded = one.recorded
    times = recorded.rotor_speeds.times
    # Upright, rotor 1 alone: z and the vertical stay perpendicular to the axis of rotation.
    speeds = np.column_stack((80.0 * np.sin(times), np.zeros_like(times)))
    start = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    states = roll_out(start, speeds, np.diff(times), one.robot.lumped.as_array())
    rng = np.random.default_rng(5)
    poses = np.array([
        apply_error(state[:6], rng.normal(size=5) * np.repeat((2e-3, 5e-3), (2, 3)))
        for state in states
    ])
    found = identified(
        replace(recorded, poses=Series(times, poses), rotor_speeds=Series(times, speeds)),
        Given(one.given),
    )
    for name in ("r1", "r3"):
        assert row(found, name).deviation == ()
        assert row(found, name).value == row(found, name).given
    gain = row(found, "c1")
    assert abs(gain.value[0] - one.robot.lumped.input_gain) < 4.0 * gain.deviation[0]
    assert "not seen, as given: r1, r3, lag of the drives, robot.max_rotor_acc" in found.summary
    assert row(found, "lag of the drives").remark == "rotor speeds do not follow the commands"


def test_half_of_the_bag_checks_the_other_half(first) -> None:
    fit = BatchFit(first.recorded, first.given)
    whole = list(range(len(fit.pieces)))
    half = fit.fitted(whole[::2])
    assert np.all(fit.left(whole[1::2], half) < (2.2e-3, 6.6e-3))
    assert np.all(fit.left(whole[1::2], fit.given) > fit.left(whole[1::2], half))


@pytest.mark.parametrize(("changes", "told"), [
    ({"rotor_speeds": Series(SHORT_TIMES, np.zeros((2001, 2)))},
     "motion: given rotor speeds up to 0 rad/s, expected some"),
    ({"rotor_speeds": Series(values=np.empty((0, 2)))}, "rotor speeds: given none, expect"),
    ({"are_outside": False}, "poses: given none from outside, and no readings of an IMU, expec"),
    ({"poses": Series(SHORT_TIMES / SHORT, np.zeros((2001, 6)))},
     "recording: given 1 pieces of 2 s, expected 4 or mo"),
])
def test_recording_without_what_is_needed_is_refused_in_a_line(first, changes, told) -> None:
    with pytest.raises(InvalidInputError, match=told):
        identified(replace(first.recorded, **changes), Given(RobotParameters()))
