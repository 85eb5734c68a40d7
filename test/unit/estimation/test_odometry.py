# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The odometry: its derivatives, consistency, rest, faults of sensors, and fixes."""

import math
from dataclasses import replace

import numpy as np
import pytest
from inertial_runs import IMU, ROBOT, SECOND, error_of, followed, random_run
from scipy.stats import chi2

from sphere_nmpc.errors import InvalidInputError, InvalidStateError
from sphere_nmpc.estimation.odometry import Odometry
from sphere_nmpc.estimation.odometry.inertial_filter import InertialFilter
from sphere_nmpc.estimation.odometry.inertial_state import (
    ARM,
    BY_FORCE,
    CONSTANTS,
    FIRST,
    FORCE_BIAS,
    FORCE_MATRIX,
    GYRO_BIAS,
    GYRO_MATRIX,
    MOMENTUM,
    OFFSET,
    PHI,
    POSE_ERROR,
    RADIUS,
    SIZE,
    Belief,
    Samples,
    applied,
)
from sphere_nmpc.estimation.odometry_settings import OdometryNumbers, OdometrySettings
from sphere_nmpc.model import rotation
from sphere_nmpc.model.disturbance import GRAVITY
from sphere_nmpc.model.error_state import apply_error, error_between
from sphere_nmpc.model.rotation import random_quaternion, vertical
from sphere_nmpc.model.state import make_state, upright_state
from sphere_nmpc.reporting.conditions import Kind

NUMBERS = OdometryNumbers()
momentum = slice(MOMENTUM.start - FIRST, MOMENTUM.stop - FIRST)
STARTS = [0, *(part.start for part in (
    PHI, GYRO_BIAS, FORCE_BIAS, GYRO_MATRIX, FORCE_MATRIX, BY_FORCE, ARM, MOMENTUM, CONSTANTS
)), RADIUS, OFFSET]
"""Where the parts of the error begin."""


class Recorded(InertialFilter):
    """Filter that keeps its measurements instead of using them."""

    def _updated(self, belief, by, innovation, noise, largest):
        self.taken.append((by, innovation))
        return belief, 0.0, noise


@pytest.mark.parametrize("still", [False, True])
def test_derivatives_are_those_of_differences(still) -> None:
    rng, recorded = np.random.default_rng(4), Recorded(IMU, ROBOT, NUMBERS)
    pose = np.concatenate((rng.normal(size=2), random_quaternion(rng)))
    numbers = np.zeros(SIZE - FIRST)
    for part, size in (
        (GYRO_BIAS, 0.01), (FORCE_BIAS, 0.1), (GYRO_MATRIX, 0.01), (FORCE_MATRIX, 0.01),
        (BY_FORCE, 1e-3), (ARM, 0.01), (MOMENTUM, 20.0), (CONSTANTS, 0.01),
    ):
        size = size * rng.normal(size=part.stop - part.start)
        numbers[part.start - FIRST : part.stop - FIRST] = size
    rates = np.linspace(rng.normal(size=3), rng.normal(size=3), 6)
    speeds = np.linspace([10.0, -40.0], [60.0, 5.0], 6)
    if still:
        rates, speeds, numbers[momentum] = np.zeros((6, 3)), 0.0 * speeds, 0.0
    samples = Samples(
        [0.01 * k for k in range(6)], list(rates),
        list(np.tile((3.0, -2.0, 9.0), (6, 1))), [True] * 6, speeds, still=still,
    )

    def taken(error):
        recorded.taken = []
        changed = numbers + error[FIRST:]
        changed[momentum] = rotation.matrix(rotation.exponential(error[2:5])) @ changed[momentum]
        begin = Belief(
            applied(pose, error[POSE_ERROR]), changed, np.eye(SIZE), np.zeros(3), np.zeros(3)
        )
        later = samples.speeds + error[OFFSET] * (speeds[-1] - speeds[0]) / samples.duration
        end, _ = recorded.advance(begin, samples._replace(speeds=later))
        return end.pose, recorded.taken

    end, measured = taken(np.zeros(SIZE))
    for _ in range(8):  # so that readings are nearly what is expected, where it is linearised
        to_sensor = (rotation.matrix(end[2:]) @ IMU.turn).T
        for k in range(6):
            samples.forces[k] = samples.forces[k] - to_sensor @ measured[0][1] / 0.05
            samples.rates[k] = samples.rates[k] - IMU.turn.T @ measured[-1][1]
        end, measured = taken(np.zeros(SIZE))
    ends, rows = np.zeros((5, SIZE)), [np.zeros_like(by) for by, _ in measured]
    for k in range(SIZE):
        error = np.zeros(SIZE)
        error[k] = step = 1e-6
        moved, others = taken(error)
        turn = rotation.product(moved[2:], rotation.conjugate(end[2:]))
        ends[:, k] = np.concatenate((moved[:2] - end[:2], rotation.logarithm(turn))) / step
        for row, (_, before), (_, after) in zip(rows, measured, others, strict=True):
            # What is measured less what is expected falls by what is expected more.
            row[:, k] = (before - after) / step
    assert len(measured) == (3 if still else 2)
    for (by, _), row in zip(measured, rows, strict=True):
        # At the end of the interval, of which the pose depends on all of the error at its start.
        rest = np.diag([0.0] * 5 + [1.0] * (SIZE - 5))
        # The error of the momentum is that beside what it turns with the orientation.
        turned = np.eye(3, SIZE, 2) - ends[2:5]
        rest[MOMENTUM] += np.cross(turned, numbers[momentum], axisa=0).T
        expected = by[:, POSE_ERROR] @ ends + by @ rest
        if by_force := by is measured[0][0]:
            row[:, RADIUS] = 0.0  # in the force, which scales of sensors change alike
        # Left out are second orders. Errors of the sensors, of 1e-2, change what is felt; those of
        # the gyro turn the interval within itself, by half its length times 1 rad/s; and errors of
        # the accelerometer are some of the gyro by the sensitivity to force, of 1e-3.
        largest = np.maximum.reduceat(np.abs(by).max(axis=0), STARTS)
        tolerance = 1e-8 + (1e-3 if by_force else 0.04) * np.repeat(
            largest, np.diff([*STARTS, SIZE])
        )
        if not by_force:
            tolerance[FORCE_BIAS] += 3e-3
            tolerance[FORCE_MATRIX] += 3e-3 * GRAVITY
        assert np.all(np.abs(row - expected) < tolerance)


def test_errors_are_within_the_covariance_told() -> None:
    squares = []
    for seed in range(20):
        rng = np.random.default_rng(seed + 100)
        run = random_run(seed, 8.0)
        # As uncertain as its settings say.
        robot = replace(ROBOT, shell_radius=ROBOT.shell_radius * (1.0 + 3e-3 * rng.normal()))
        wrong = np.concatenate((1e-3 * rng.normal(size=2), 5e-3 * rng.normal(size=3)))
        given = OdometrySettings(
            initial_state=tuple(apply_error(run.states[0], wrong).tolist()),
            position_deviation=1e-3, orientation_deviation=5e-3,
        )
        odometry = followed(run, given, robot=robot)
        squares.append(error_of(odometry, run.states[10 * SECOND])[1])
        assert odometry.conditions == ()
    # Of 20 runs with 5 degrees of freedom, 99.5 % of the sums are below this. They are smaller on
    # the whole, as what is told allows for vibration and for a slope, of which there is none.
    assert 0.4 * 5 < np.mean(squares) < chi2.ppf(0.995, 5 * 20) / 20


def test_what_cannot_be_seen_from_inside_is_never_learnt() -> None:
    """Position and heading change nothing that is measured: they are not known better than given.

    What has been added by the scale of the gyro may go when that is known.
    """
    run, headings, places = random_run(12, 6.0), [], []

    def watch(odometry: Odometry, stamp: int) -> None:
        within, up = odometry.estimate.covariance, vertical(odometry.estimate.pose[2:])
        headings.append(up @ within[2:, 2:] @ up)
        places.append(np.trace(within[:2, :2]))

    followed(run, watch=watch)
    assert min(headings) > (1.0 - 1e-3) * headings[0] and min(places) > (1.0 - 1e-3) * places[0]
    assert headings[-1] > 1.01 * headings[0] and places[-1] > 1.01 * places[0]


@pytest.mark.parametrize(
    ("plant", "robot"),
    [("rigid_body", ROBOT), ("rolling", replace(ROBOT, shell_mass=1.03, rotor_mass=0.685))],
)
def test_pose_after_some_metres_with_contact_and_with_wrong_masses(plant, robot) -> None:
    if plant == "rigid_body":
        pytest.importorskip("mujoco")
    run = random_run(3, 20.0, plant, robot)
    odometry = followed(run)
    error, _ = error_of(odometry, run.states[22 * SECOND])
    places = np.array([state[:2] for state in run.states.values()])
    way = np.linalg.norm(np.diff(places, axis=0), axis=1).sum()
    assert way > 4.0
    assert math.hypot(*error[:2]) < 3e-3 * way
    assert np.degrees(np.linalg.norm(error[2:])) < 0.5


def test_pose_at_rest_does_not_creep_and_a_calibration_is_told() -> None:
    run = random_run(5, 1.0)
    poses = []

    def watch(odometry: Odometry, stamp: int) -> None:
        poses.append(odometry.estimate.pose)

    odometry = followed(run, watch=watch)
    assert odometry.calibration.endswith("2.0 s at rest")
    still = poses[-150:]
    assert max(math.dist(pose[:2], still[0][:2]) for pose in still) < 1e-4
    assert max(np.linalg.norm(error_between(pose, still[0])[2:]) for pose in still) < 1e-3


def seen(run, change=lambda one: one, rotors=lambda one: one) -> tuple[Odometry, set[Kind], float]:
    """Return what was told in a run, and the largest normalised error of the position."""
    told, worst = set(), [0.0]

    def watch(odometry: Odometry, stamp: int) -> None:
        told.update(one.kind for one in odometry.conditions)
        if stamp == 8 * SECOND:
            error, _ = error_of(odometry, run.states[stamp])
            within = odometry.estimate.covariance[:2, :2]
            worst[0] = float(error[:2] @ np.linalg.solve(within, error[:2]))

    odometry = followed(run, change=change, rotors=rotors, watch=watch)
    return odometry, told - {Kind.CALIBRATING}, worst[0]


def between(one, begin: float, end: float) -> bool:
    return begin * SECOND < one.stamp < end * SECOND


def stuck(begin: float, end: float):
    held = []

    def change(one):
        if not between(one, begin, end):
            return one
        held.append(one)
        return held[0]._replace(stamp=one.stamp)

    return change


def lifted(one):
    """Return the reading of a sphere that is lifted by 0.3 m within a second."""
    if not between(one, 4.0, 5.0):
        return one
    after = one.stamp / SECOND - 4.0
    up = 0.15 * math.pi**2 * math.cos(math.pi * after)
    # The direction that gravity has in the sensor, as far as it can be read there.
    return one._replace(force=one.force * (1.0 + up / np.linalg.norm(one.force)))


FAULTS = {
    "nothing": (None, None, set()),
    "IMU stuck": (stuck(4.0, 5.0), None, {Kind.IMU_STUCK}),
    "IMU silent": (lambda one: None if between(one, 4.0, 5.0) else one, None, {Kind.IMU_SILENT}),
    "gyro saturated": (
        lambda one: one._replace(rate=np.array([17.5, *one.rate[1:]]))
        if between(one, 4.0, 4.3) else one, None, {Kind.GYRO_SATURATED},
    ),
    "encoders stuck": (None, stuck(4.0, 5.5), {Kind.ENCODERS_STUCK, Kind.PUSHED}),
    "encoders dead": (
        None, lambda one: one._replace(speeds=np.zeros(2), angles=np.zeros(2))
        if between(one, 4.0, 5.5) else one, {Kind.ENCODERS_STUCK, Kind.PUSHED},
    ),
    "encoders silent": (
        None, lambda one: None if between(one, 4.0, 5.5) else one, {Kind.ENCODERS_SILENT}
    ),
    "encoders late": (
        None, lambda one: one._replace(stamp=one.stamp + SECOND // 50), {Kind.ENCODERS_LATE}
    ),
    "encoders early": (
        None, lambda one: one._replace(stamp=one.stamp - SECOND // 50), {Kind.ENCODERS_LATE}
    ),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_of_sensors_are_told_and_bridged(fault) -> None:
    change, rotors, expected = FAULTS[fault]
    run = random_run(7, 8.0)
    odometry, told, square = seen(run, change or (lambda one: one), rotors or (lambda one: one))
    if "late" in fault or "early" in fault:
        told -= {Kind.PUSHED}  # the same, until the acceleration of the rotors changes
    assert told == expected
    # 1 of 1000 of two degrees of freedom, and the heading that is bridged by the rotors.
    assert square < chi2.ppf(0.999, 2)
    error, _ = error_of(odometry, run.states[10 * SECOND])
    assert math.hypot(*error[:2]) < 0.02 and np.degrees(np.linalg.norm(error[2:])) < 1.0


def test_push_slip_and_lift_are_told_apart_and_what_is_not_known_grows() -> None:
    pytest.importorskip("mujoco")
    odometry, told, square = seen(random_run(7, 8.0, "rigid_body", push=0.7))
    assert told == {Kind.PUSHED} and square < chi2.ppf(0.999, 2)
    before = odometry.estimate.covariance
    odometry, told, _ = seen(random_run(7, 8.0), lifted)
    assert Kind.LIFTED in told and Kind.PUSHED not in told
    assert Kind.LIFTED in {one.kind for one in odometry.conditions}
    assert odometry.estimate.covariance[0, 0] > 0.1 > 1e3 * before[0, 0]
    odometry.correct(10.0, upright_state(0.0, 0.0, 0.0), None)
    odometry, told, square = seen(random_run(8, 8.0, "rigid_body", friction=0.15))
    assert Kind.SLIPPED in told and Kind.LIFTED not in told
    assert square < chi2.ppf(0.999, 2) and odometry.estimate.covariance[0, 0] > 20.0 * before[0, 0]


def noisy_fix(rng, state):
    error = np.concatenate((5e-3 * rng.normal(size=2), 8e-3 * rng.normal(size=3)))
    return apply_error(state, error), np.diag([5e-3**2] * 2 + [8e-3**2] * 3)


def test_a_late_fix_counts_as_one_in_time() -> None:
    run, ends = random_run(9, 8.0), []
    for delay in (0, 10, 60):
        rng = np.random.default_rng(1)
        given = {}

        def watch(odometry: Odometry, stamp: int, delay=delay, rng=rng, given=given) -> None:
            if stamp and stamp % (2 * SECOND) == 30_000_000:
                given[stamp + delay * 10_000_000] = stamp, noisy_fix(rng, run.states[stamp])
            if stamp in given:
                measured, fix = given[stamp]
                assert odometry.correct(measured / SECOND, *fix) is None

        odometry = followed(run, watch=watch)
        assert odometry.fixes_used == 5
        ends.append(odometry.estimate.pose)
    # Intervals are cut at other instants, by which their measurements differ in rounding and
    # linearisation.
    np.testing.assert_allclose(ends[1], ends[0], atol=2e-4)
    np.testing.assert_allclose(ends[2], ends[0], atol=2e-4)
    assert math.dist(ends[2][:2], run.states[10 * SECOND][:2]) < 0.012


def test_fixes_that_contradict_are_left_out_until_they_agree() -> None:
    run = random_run(9, 2.0)
    odometry = followed(run)
    time, true = odometry.estimate.time, odometry.estimate.pose
    elsewhere = apply_error(true, np.array([1.0, 0.0, 0.0, 0.0, 0.0]))
    for k in range(4):
        reason = odometry.correct(time - 0.5 + 0.05 * k, elsewhere, None)
        assert reason.kind is Kind.FIX_LEFT_OUT and "1 m from that estimated" in reason.text
    assert odometry.correct(time - 0.2, elsewhere, None) is None
    assert math.dist(odometry.estimate.pose[:2], elsewhere[:2]) < 2e-3
    for wrong in (time - 5.0, time + 5.0):
        assert odometry.correct(wrong, elsewhere, None).kind is Kind.FIX_LEFT_OUT


def test_fixes_show_the_radius() -> None:
    larger = replace(ROBOT, shell_radius=1.003 * ROBOT.shell_radius)
    run = random_run(11, 20.0, robot=larger)
    rng = np.random.default_rng(2)

    def watch(odometry: Odometry, stamp: int) -> None:
        if stamp and stamp % SECOND == 0:
            odometry.correct(stamp / SECOND, *noisy_fix(rng, run.states[stamp]))

    odometry = followed(run, watch=watch)
    assert odometry.radius == pytest.approx(larger.shell_radius, rel=1e-3)


def test_a_pose_of_heading_alone_keeps_the_tilt_that_gravity_shows() -> None:
    run = random_run(9, 2.0)
    odometry = followed(run)
    before = vertical(odometry.estimate.pose[2:])
    flat = np.diag([0.25, 0.25, 0.0, 0.0, 0.0685])
    odometry.set_pose(odometry.estimate.time, upright_state(1.0, 2.0, 0.5), flat)
    found = odometry.estimate
    np.testing.assert_allclose(vertical(found.pose[2:]), before, atol=1e-4)
    np.testing.assert_allclose(found.pose[:2], [1.0, 2.0])
    assert Kind.TILT_REPLACED not in {one.kind for one in odometry.conditions}
    # One that is told with confidence, and contradicts gravity, is replaced and told.
    odometry.set_pose(found.time, upright_state(0.0, 0.0, 0.0), None)
    np.testing.assert_allclose(vertical(odometry.estimate.pose[2:]), before, atol=1e-4)
    assert Kind.TILT_REPLACED in {one.kind for one in odometry.conditions}


def test_input_that_is_not_finite_is_refused() -> None:
    odometry = Odometry(OdometrySettings(), IMU, ROBOT)
    with pytest.raises(InvalidInputError, match=r"IMU: given .*nan.*, expected finite"):
        odometry.observe_imu(0.0, np.array([math.nan, 0.0, 0.0]), np.zeros(3))
    with pytest.raises(InvalidInputError, match="rotor speeds"):
        odometry.observe_rotors(0.0, np.array([math.inf, 0.0]))
    with pytest.raises(InvalidStateError):
        odometry.correct(math.nan, make_state((0.0, 0.0), (1.0, 0.0, 0.0, 0.0)), None)
    assert odometry.estimate is None and odometry.correct(
        0.0, upright_state(0.0, 0.0, 0.0), None
    ).kind is Kind.FIX_LEFT_OUT
