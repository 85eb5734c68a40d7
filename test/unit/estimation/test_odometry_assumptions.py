# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""What the odometry assumes of sensors, starts and clients, and what it does where that is not so.

Errors of tilt are compared with the deviation of an accelerometer with the default bias, 0.9 deg.
"""

import math

import casadi as ca
import numpy as np
import pytest
from inertial_runs import ROBOT, SECOND, error_of, followed, random_run
from scipy.stats import chi2

from sphere_nmpc.estimation.imu import ImuSettings
from sphere_nmpc.estimation.odometry import Odometry
from sphere_nmpc.estimation.odometry.inertial_state import (
    FORCE_MATRIX,
    GYRO_MATRIX,
    MOMENTUM,
    SIZE,
    Belief,
    Samples,
)
from sphere_nmpc.estimation.odometry.rotor_model import RotorModel
from sphere_nmpc.estimation.odometry.rotor_speeds import RotorSpeeds
from sphere_nmpc.estimation.odometry_settings import OdometryNumbers, OdometrySettings
from sphere_nmpc.model import rotation
from sphere_nmpc.model.disturbance import GRAVITY
from sphere_nmpc.model.dynamics import world_rate
from sphere_nmpc.model.state import upright_state
from sphere_nmpc.reporting.conditions import Kind

DEFAULT = ImuSettings()


class Rest:
    """Readings of an IMU that rests, and an odometry that follows them."""

    def __init__(self, seed=0, imu=DEFAULT, settings=None, rotors=True, rate=100.0) -> None:
        self.rng, self.rate, self.rotors = np.random.default_rng(seed), rate, rotors
        self.odometry = Odometry(settings or OdometrySettings(), imu, ROBOT)
        self.noises = np.array([imu.gyro_noise, imu.accelerometer_noise]) * math.sqrt(rate)
        self.bias = np.concatenate((
            imu.gyro_bias * self.rng.normal(size=3),
            imu.accelerometer_bias * self.rng.normal(size=3),
        ))
        self.time, self.told = 0.0, set()

    def reading(self, vertical):
        noise = np.repeat(self.noises, 3) * self.rng.normal(size=6)
        return np.concatenate((np.zeros(3), GRAVITY * vertical)) + self.bias + noise

    def feed(self, duration, vertical, change=lambda time, one: one, speeds=lambda _: np.zeros(2)):
        """Follow readings with a vertical in the body."""
        for _ in range(round(duration * self.rate)):
            self.time += 1.0 / self.rate
            one = change(self.time, self.reading(np.asarray(vertical)))
            self.odometry.observe_imu(self.time, one[:3], one[3:])
            if self.rotors:
                self.odometry.observe_rotors(self.time, speeds(self.time))
            self.odometry.check(self.time)
            self.told |= {one.kind for one in self.odometry.conditions}
        return self

    def tilt_error(self, vertical) -> float:
        """Return the error of the tilt [deg]."""
        found = rotation.vertical(self.odometry.estimate.pose[2:])
        return math.degrees(math.acos(min(1.0, float(found @ vertical))))


UP = np.array([0.0, 0.0, 1.0])
ABOUT_Z = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
BIAS = np.array([0.087, -0.05, 0.02, 0.0, 0.0, 0.0])
"""Of 5 deg/s [rad/s, m/s^2]."""


def turned_up(degrees: float) -> np.ndarray:
    return np.array([math.sin(math.radians(degrees)), 0.0, math.cos(math.radians(degrees))])


@pytest.mark.parametrize("seed", range(4))
def test_tilt_is_that_of_the_rest_and_not_of_what_was_before(seed) -> None:
    shaken = Rest(seed)
    shaken.feed(0.4, turned_up(40.0), lambda _, one: one + shaken.rng.normal(0.0, 2.0, 6))
    shaken.feed(4.0, UP)
    assert shaken.tilt_error(UP) < 3.0  # of a bias of 15 mg in two axes
    spread = np.degrees(np.sqrt(np.diag(shaken.odometry.estimate.covariance)[2:4]))
    assert np.all(spread < 2.0)


@pytest.mark.parametrize("degrees", [10.0, 90.0, 180.0])
def test_a_tilt_that_a_rest_contradicts_is_replaced_and_the_position_is_not_known(degrees) -> None:
    there = turned_up(degrees)
    rest = Rest(1).feed(4.0, UP)
    rest.time += 0.3
    rest.feed(4.0, there)
    assert rest.tilt_error(there) < 3.0 and rest.odometry.faults.is_lost
    assert {Kind.TILT_REPLACED, Kind.POSITION_UNKNOWN} <= rest.told
    rest.odometry.set_pose(rest.time, rest.odometry.estimate.pose, None)
    rest.feed(3.0, there)
    assert not rest.odometry.faults.is_lost and rest.tilt_error(there) < 3.0


def test_a_given_tilt_is_compared_with_what_is_measured_and_not_with_what_is_believed() -> None:
    rest = Rest(2).feed(4.0, UP)
    rest.time += 0.3
    rest.feed(1.2, turned_up(30.0))  # too short for a contradiction that lasts
    turn = rotation.exponential(np.array([0.0, math.radians(-30.0), 0.0]))
    true = np.concatenate((np.zeros(2), turn))
    rest.odometry.set_pose(rest.time, true, None)
    rest.feed(3.0, turned_up(30.0))
    assert rest.tilt_error(turned_up(30.0)) < 1.0
    assert not rest.odometry.faults.is_lost and Kind.TILT_REPLACED not in rest.told


def test_a_start_on_its_side_is_told_until_a_pose_is_given() -> None:
    rest = Rest(3).feed(8.0, turned_up(90.0))
    assert Kind.TILT_REPLACED in {one.kind for one in rest.odometry.conditions}
    rest.odometry.set_pose(rest.time, rest.odometry.estimate.pose, None)
    assert rest.odometry.conditions == ()


@pytest.mark.slow
def test_noise_at_rest_becomes_neither_scale_nor_tilt() -> None:
    rest = Rest(4, rate=20.0).feed(10.0, UP)
    before = rest.odometry._belief
    rest.feed(600.0, UP)
    after = rest.odometry._belief
    for part in (FORCE_MATRIX, GYRO_MATRIX):
        spread = np.sqrt(np.diag(before.covariance)[part])
        assert np.all(np.abs(after.value(part) - before.value(part)) < spread)
    assert rest.tilt_error(UP) < 2.0 and rest.odometry.conditions == ()
    assert np.all(np.linalg.eigvalsh(after.covariance) > -1e-12)


def test_a_gap_in_motion_makes_the_position_unknown() -> None:
    run = random_run(7, 8.0)
    odometry = followed(
        run, change=lambda one: None if 4.0 < one.stamp / SECOND < 5.0 else one,
        rotors=lambda one: None,
    )
    assert odometry.faults.is_lost
    assert Kind.POSITION_UNKNOWN in {one.kind for one in odometry.conditions}


def test_without_an_imu_speeds_are_not_kept() -> None:
    odometry = Odometry(OdometrySettings(), DEFAULT, ROBOT)
    for k in range(5000):
        odometry.observe_rotors(0.01 * k, np.ones(2))
    assert len(odometry._speeds.times) < 50


def test_deviations_that_are_beyond_all_bounds_leave_the_belief_finite() -> None:
    rest = Rest(5).feed(4.0, UP)
    for variance in (1e308, 1e200, 99999.0):
        huge = np.diag([variance] * 5)
        rest.odometry.set_pose(rest.time, upright_state(1.0, 0.0, 0.0), huge)
        rest.feed(0.5, UP)
        rest.odometry.correct(rest.time - 0.2, upright_state(1.0, 0.0, 0.3), huge)
        rest.feed(0.5, UP)
        assert np.isfinite(rest.odometry.estimate.covariance).all()
    rest.odometry.set_pose(rest.time, upright_state(2.0, 1.0, 0.0), None)
    np.testing.assert_allclose(rest.odometry.estimate.pose[:2], [2.0, 1.0])


def test_fixes_of_a_planar_localiser_correct_position_and_heading_alone() -> None:
    run, worst = random_run(9, 8.0), [0.0]
    planar = np.diag([0.01, 0.01, 0.0, 0.0, 0.06])

    def watch(odometry: Odometry, stamp: int) -> None:
        true = run.states[stamp]
        if stamp % (SECOND // 4) == 0:
            # Upright with the heading of the shortest rotation, as AMCL has it.
            vertical = rotation.vertical(true[2:])
            axis = np.cross(vertical, UP)
            angle = math.atan2(float(np.linalg.norm(axis)), vertical[2])
            axis = axis / max(float(np.linalg.norm(axis)), 1e-9)
            q = rotation.product(true[2:], rotation.exponential(-angle * axis))
            odometry.correct(stamp / SECOND, np.concatenate((true[:2], q)), planar)
        worst[0] = max(worst[0], math.dist(odometry.estimate.pose[:2], true[:2]))

    odometry = followed(run, watch=watch)
    error, _ = error_of(odometry, run.states[10 * SECOND])
    assert odometry.fixes_used > 20 and odometry.fixes_left_out == 0
    assert worst[0] < 0.03 and np.degrees(np.linalg.norm(error[2:])) < 2.0


def test_a_fix_that_is_given_again_counts_once() -> None:
    rest = Rest(6).feed(4.0, UP)
    fix = rest.time - 0.2, upright_state(0.01, 0.0, 0.0), np.diag([1e-4] * 5)
    reasons = [rest.odometry.correct(*fix) for _ in range(50)]
    assert reasons[0] is None and all("same fix" in one.text for one in reasons[1:])
    assert rest.odometry.fixes_used == 1


def engine(rng):
    """Return vibrations of an idling engine: 1.3 deg/s and 1.6 m/s^2 rms, most of it at 25 Hz."""
    phases = rng.uniform(0.0, 6.28, 6)
    sizes = math.sqrt(2.0) * np.repeat([0.02, 1.4], 3)

    def change(time, one):
        noise = np.repeat([0.01, 0.7], 3) * rng.normal(size=6)
        return one + sizes * np.sin(2.0 * math.pi * 25.3 * time + phases) + noise

    return change


RESTS = {
    "no encoders": ({"rotors": False}, None, None),
    "noise of the speeds": ({}, None, lambda rng: lambda _: 0.05 * rng.normal(size=2)),
    "an encoder that toggles": ({}, None, lambda rng: lambda _: 0.15 * rng.integers(-1, 2, 2)),
    "an engine": ({"rotors": False}, engine, None),
    "a bias of 5 deg/s": ({}, lambda _: lambda _, one: one + BIAS, None),
    "noise of the gyro": ({}, lambda rng: lambda _, one: one + np.append(
        0.01 * rng.normal(size=3), np.zeros(3)), None),
}


@pytest.mark.parametrize("what", RESTS)
def test_rest_is_found_by_what_does_not_change(what) -> None:
    given, change, speeds = RESTS[what]
    rest = Rest(7, **given)
    more = {"change": change(rest.rng)} if change else {}
    if speeds:
        more["speeds"] = speeds(rest.rng)
    rest.feed(4.0, UP, **more)
    assert rest.odometry.is_calibrated, rest.odometry.conditions
    place = rest.odometry.estimate.pose[:2].copy()
    rest.feed(10.0, UP, **more)
    assert rest.tilt_error(UP) < 3.0 and math.dist(place, rest.odometry.estimate.pose[:2]) < 1e-3
    assert not rest.odometry.faults.is_lost and Kind.ENCODERS_SILENT not in rest.told


@pytest.mark.parametrize(("size", "words"), [(0.0, "removed"), (1.0 / GRAVITY, "in g"), (2.0, "")])
def test_a_force_at_rest_that_is_not_gravity_gives_no_pose(size, words) -> None:
    rest = Rest(8)
    rest.feed(4.0, UP, lambda _, one: np.append(one[:3], size * one[3:]))
    first = rest.odometry.conditions[0]
    assert first.kind is Kind.NO_GRAVITY and words in first.text and "expected 9.81" in first.text
    assert rest.odometry.estimate is None


def test_a_force_of_the_opposite_sign_is_named_and_leaves_the_position_unknown() -> None:
    rest = Rest(8).feed(4.0, UP, lambda _, one: np.append(one[:3], -one[3:]))
    assert rest.odometry.faults.is_lost
    assert any("the opposite sign?" in one.text for one in rest.odometry.conditions)


def test_what_the_calibration_waits_for_is_told() -> None:
    rest = Rest(9)
    rest.feed(3.0, UP, speeds=lambda _: np.array([5.0, 0.0]))
    assert "rotors that turn with 5 rad/s" in rest.odometry.conditions[0].text
    rest = Rest(9).feed(3.0, UP, lambda time, one: one + 0.2 * time * ABOUT_Z)
    assert "a change of the gyro by" in rest.odometry.conditions[0].text
    rest = Rest(9).feed(1.5, UP)
    assert "at rest for 1." in rest.odometry.conditions[0].text


def test_readings_in_degrees_are_told() -> None:
    rest = Rest(10, settings=OdometrySettings())
    rest.feed(4.0, UP, lambda _, one: np.append(np.degrees(one[:3]) / 6.0, one[3:]))
    assert Kind.LARGE_BIAS in {one.kind for one in rest.odometry.conditions}


@pytest.mark.parametrize("sent", [math.nan, 0.0])
def test_speeds_that_are_not_measured_follow_from_the_angles(sent) -> None:
    run = random_run(7, 8.0)
    odometry = followed(run, rotors=lambda one: one._replace(speeds=np.full(2, sent)))
    error, square = error_of(odometry, run.states[10 * SECOND])
    assert math.hypot(*error[:2]) < 0.01 and square < chi2.ppf(0.999, 5)
    silent = {Kind.ENCODERS_STUCK, Kind.ENCODERS_SILENT}
    assert not silent & {one.kind for one in odometry.conditions}


def test_a_jump_of_the_bias_at_rest_is_one_of_the_bias() -> None:
    rest = Rest(11).feed(6.0, UP)
    before = rest.odometry.estimate
    rest.feed(5.0, UP, lambda _, one: one + 0.0087 * ABOUT_Z)
    after = rest.odometry.estimate
    assert rest.tilt_error(rotation.vertical(before.pose[2:])) < 0.1
    heading = np.sqrt(after.covariance[4, 4])
    turn = rotation.product(rotation.conjugate(before.pose[2:]), after.pose[2:])
    assert np.linalg.norm(rotation.logarithm(turn)) < 3.0 * heading


def test_gates_are_quantiles_of_one_probability() -> None:
    numbers = OdometryNumbers()
    for components in range(1, 6):
        assert numbers.improbable(components) == pytest.approx(
            chi2.isf(chi2.sf(25.0, 5), components), abs=0.01
        )


def test_rate_by_the_balance_of_momentum_is_that_of_the_model() -> None:
    rng = np.random.default_rng(3)
    belief = Belief(np.zeros(6), np.zeros(SIZE - 5), np.eye(SIZE), np.zeros(3), np.zeros(3))
    belief.numbers[MOMENTUM.start - 5 : MOMENTUM.stop - 5] = momentum = rng.normal(0.0, 20.0, 3)
    for _ in range(20):
        q, speeds = rotation.random_quaternion(rng), rng.uniform(-100.0, 100.0, 2)
        rate, _ = RotorModel(ROBOT).rate(belief, rotation.matrix(q), speeds)
        lumped = ca.DM(ROBOT.lumped.as_array())
        expected = world_rate(ca.DM(q), ca.DM(momentum), ca.DM(speeds), lumped, ca.DM.zeros(3))
        np.testing.assert_allclose(
            rotation.matrix(q) @ rate, np.array(expected)[:, 0], rtol=1e-9, atol=1e-9
        )


def test_an_interval_is_closed_with_the_speeds_it_needs() -> None:
    rng = np.random.default_rng(5)
    for _ in range(300):
        speeds, step = RotorSpeeds(0.2, ROBOT), 0.01 * rng.uniform(0.8, 1.2)
        for stamp in np.arange(-0.05, 0.2, step) + rng.uniform(0.0, step):
            speeds.append(float(stamp), np.zeros(2))
            samples = Samples([0.0, 0.01, 0.02], [np.zeros(3)] * 3, [np.zeros(3)] * 3, [True] * 3)
            late = rng.uniform(-0.02, 0.02)
            is_known = speeds.added_to(samples, late).speeds is not None
            assert is_known == (speeds.cover(0.02, samples.step, late) and late >= -0.05)
