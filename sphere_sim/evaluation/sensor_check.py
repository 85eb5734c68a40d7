# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Checks of the sensors of a robot that stands still: conventions, units, stamps and noise."""

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sphere_nmpc.estimation.imu import GRAVITY_REMOVED, ImuSettings, convention_of
from sphere_nmpc.model import rotation
from sphere_nmpc.model.disturbance import GRAVITY
from sphere_nmpc.model.state import QUATERNION, Vector
from sphere_nmpc.quantities import NANOSECONDS, counted
from sphere_sim.evaluation.metrics import angle_errors

PASS, WARN, FAIL = "PASS", "WARN", "FAIL"
_FEWEST = 20
"""Messages below which nothing is evaluated."""
_AHEAD, _LATE = 0.1, 0.5
"""Offsets of stamps that are those of another clock [s]."""
_IRREGULAR, _GAP = 0.3, 5.0
"""Deviation of the steps of stamps, and longest step, over their median, that are reported [-]."""
_BLOCK = 0.25
"""Time over which readings are averaged, so that vibrations count little [s]."""
_STILL = (2e-3, 0.03)
"""Changes of the means of gyro [rad/s] and accelerometer [m/s^2] that are none, whatever their
noise: the first is a tenth of a degree a second, the second an inclination by two."""
_SCATTERS = 8.0
"""Standard deviations of the mean by which one may differ at rest [-]; noise that a device filters
is larger in a mean than its readings show."""
_NOISIER, _MUCH_NOISIER = 3.0, 20.0
"""Noise or bias over what the settings say from which they are corrected, and from which a unit is
wrong [-]: rad are 57 deg."""
_TILTED = 5.0
"""Difference of the verticals of accelerometer and pose that is reported [degree]: a bias of 50 mg
makes 3."""
_TURNING, _SPEED_NOISE = 0.1, 1e-3
"""Speed of a rotor that turns, and noise of one that is reported [rad/s]."""
_FEW_ANGLES, _COUNT = 3, 0.02
"""Angles between which an encoder toggles at rest, and their largest difference [rad]."""


class Sensor(NamedTuple):
    """Messages of a sensor, in their order.

    Attributes
    ----------
    received, stamps : ndarray of int64, shape (n,)
        Times at which they were received and stamps [ns], of one clock.
    values : ndarray, shape (n, k)
        What they hold; nan where that is missing.
    """

    received: NDArray[np.int64]
    stamps: NDArray[np.int64]
    values: Vector

    @classmethod
    def of(cls, entries: Sequence[tuple[int, Any]], values: Callable[[Any], Any]) -> "Sensor":
        """Return the sensor of messages with a stamp, given with the times of receipt [ns]."""
        times = np.array([(at, one.stamp) for at, one in entries], np.int64).reshape(-1, 2)
        rows = np.array([values(one) for _, one in entries], float)
        return cls(times[:, 0], times[:, 1], rows)


class Finding(NamedTuple):
    """Result of one check."""

    verdict: str
    name: str
    text: str
    """What was measured, and what was expected where that is something else."""


def check_sensors(
    imu: Sensor, joints: Sensor | None, pose: Sensor | None, settings: ImuSettings
) -> list[Finding]:
    """Return what is found of the sensors of a robot that has been left alone.

    Parameters
    ----------
    imu : Sensor
        Angular velocity [rad/s] and specific force [m/s^2], shape (n, 6); axes of the sensor.
    joints : Sensor, optional
        Angles [rad] and speeds [rad/s] of the rotors, shape (n, 4).
    pose : Sensor, optional
        States, shape (n, 6).
    settings : ImuSettings
        What is known of the IMU.
    """
    found = list(_stream("imu", imu, 100.0))
    if len(imu.stamps) >= _FEWEST:
        found += _inertial(imu, pose, settings)
    if joints is None:
        found.append(Finding(WARN, "joint_states", "no encoders: rest and turns by the IMU alone"))
    else:
        found += _stream("joint_states", joints, 50.0)
        if len(joints.stamps) >= _FEWEST:
            found += _rotors(joints)
    if pose is not None:
        found += _stream("pose", pose, 20.0)
        place = 1e3 * math.sqrt(float(np.mean(np.var(pose.values[:, :2], axis=0))))
        angles = np.degrees(angle_errors(pose.values, pose.values[-1]))
        angle = math.sqrt(float(np.mean(angles**2)) / 6.0)
        found.append(Finding(PASS, "pose noise", f"{place:.2g} mm and {angle:.2g} deg"))
    return found


def _first(name: str, rows: Sequence[tuple[Any, str, str]], otherwise: str) -> Finding:
    """Return the first finding of rows whose condition holds, or else that all is well."""
    held = (Finding(verdict, name, f"given {text}") for holds, verdict, text in rows if holds)
    return next(held, Finding(PASS, name, otherwise))


def _stream(name: str, sensor: Sensor, least: float) -> Iterator[Finding]:
    """Yield what is found of rate and stamps."""
    number = len(sensor.stamps)
    span = float(np.ptp(sensor.received)) / NANOSECONDS if number else 0.0
    rate = (number - 1) / max(span, 1e-9)
    enough = f"expected {least:g} Hz or more"
    yield _first(f"{name} rate", (
        (number < _FEWEST, FAIL, f"{counted(number, 'message')}, {enough}: start its driver, or "
         f"-r {name}:=/its/topic"),
        (rate < 0.95 * least, WARN, f"{rate:.4g} Hz, {enough}"),
    ), f"{rate:.4g} Hz")
    if number < _FEWEST:
        return
    age = float(np.median(sensor.received - sensor.stamps)) / NANOSECONDS
    steps = np.diff(sensor.stamps) / NANOSECONDS
    typical, scatter, longest = (1e3 * float(of(steps)) for of in (np.median, np.std, np.max))
    zeros, back, equal = (int(np.count_nonzero(one)) for one in
                          (sensor.stamps == 0, steps < 0.0, steps == 0.0))
    own = "expected that of the machine that receives them"
    leap = ": GPS time is 18 s ahead of UTC" if abs(age + 18.0) < _LATE else ""
    text = (f"{1e3 * age:.1f} ms old, steps of {typical:.3g} +- {scatter:.2f} ms, longest "
            f"{longest:.3g} ms")
    yield _first(f"{name} stamps", (
        (zeros, FAIL, f"0 in {zeros} of {number}, expected the time of measurement"),
        (age < -_AHEAD, FAIL, f"{-age:.3g} s ahead of the clock, {own}{leap}"),
        (age > _LATE, FAIL, f"{age:.3g} s behind the clock, {own} (use_sim_time of a simulator)"),
        (back, FAIL, f"{back} that go back, expected one publisher"),
        (equal, FAIL if 2 * equal > number else WARN,
         f"{equal} of {number} equal to the one before, expected each once"),
        (scatter > _IRREGULAR * typical or longest > _GAP * typical, WARN,
         f"{text}, expected even steps"),
    ), text)


def _inertial(imu: Sensor, pose: Sensor | None, settings: ImuSettings) -> Iterator[Finding]:
    """Yield what is found of the readings of an IMU."""
    number, readings = len(imu.stamps), imu.values
    invalid = int(np.count_nonzero(~np.isfinite(readings).all(axis=1)))
    changes = np.diff(readings, axis=0)
    equal = int(np.count_nonzero((changes == 0.0).all(axis=1)))
    yield _first("imu readings", (
        (invalid, FAIL, f"{invalid} of {number} that are not finite"),
        (equal, FAIL if 2 * equal > number else WARN, f"{equal} of {number} equal to the one "
         "before, expected noise: stuck, or published faster than measured"),
    ), f"{number}, none equal to the one before")
    if invalid:
        return
    # By the stamps, where they have a time; a recorder may have logged several at once.
    step = float(np.median(np.diff(imu.stamps))) or float(np.ptp(imu.received)) / (number - 1)
    size = max(2, round(_BLOCK * NANOSECONDS / max(step, 1.0)))
    size = min(size, number // 2)
    blocks = readings[: number // size * size].reshape(-1, size, 6).mean(axis=1)
    scatter = np.std(changes, axis=0) / math.sqrt(2.0 * size)
    moved = np.abs(blocks - np.median(blocks, axis=0)) > np.repeat(_STILL, 3) + (
        _SCATTERS * scatter
    )
    ranges = np.ptp(blocks, axis=0)
    text = (f"means over {_BLOCK:g} s change by {np.max(ranges[:3]):.2g} rad/s and "
            f"{np.max(ranges[3:]):.2g} m/s^2")
    yield _first("imu rest", ((moved.any(), FAIL, f"{text}, expected a robot left alone"),), text)
    norm = float(np.median(np.linalg.norm(blocks[:, 3:], axis=1)))
    yield _gravity(norm, settings)
    if not moved.any():
        mean = readings.mean(axis=0)
        if convention_of(norm) != GRAVITY_REMOVED:
            yield _vertical(settings.turn @ mean[3:] / np.linalg.norm(mean[3:]), pose)
        yield from _errors(mean, blocks, settings)


def _gravity(norm: float, settings: ImuSettings) -> Finding:
    """Return what is found of the norm of the specific force at rest [m/s^2]."""
    off = abs(norm - GRAVITY)
    allowed = 4.0 * (settings.accelerometer_bias + GRAVITY * settings.accelerometer_scale)
    given = f"{norm:.4g}, expected {GRAVITY:.2f} m/s^2"
    other = convention_of(norm)
    return _first("specific force", (
        (bool(other), FAIL, f"{given}: {other}"),
        (off > allowed, FAIL if off > 0.3 * GRAVITY else WARN, f"{given} +- {allowed:.2g} by "
         "imu.accelerometer_bias and imu.accelerometer_scale"),
    ), f"{norm:.3f} m/s^2")


def _vertical(up: Vector, pose: Sensor | None) -> Finding:
    """Return what is found of the vertical that the accelerometer shows [body frame]."""
    text = f"({', '.join(f'{one:+.2f}' for one in up)}) in the body, with imu.orientation"
    if pose is None:
        return Finding(PASS, "up", f"{text}: look whether it is")
    given = rotation.vertical(pose.values[-1, QUATERNION])
    angle = math.degrees(math.acos(float(np.clip(given @ up, -1.0, 1.0))))
    why = ": opposite sign, or upside down" if angle > 150.0 else ""
    return _first("up", (
        (not angle < _TILTED, FAIL, f"{text}, {angle:.1f} deg from that of pose{why}"),
    ), f"{text}, as pose has it")


def _errors(mean: Vector, blocks: Vector, settings: ImuSettings) -> Iterator[Finding]:
    """Yield how bias and noise compare with the settings, by means over `_BLOCK` at rest."""
    # Of differences of neighbours, which a drift does not enter (the Allan deviation).
    changes = np.diff(blocks, axis=0)
    gyro, force = (math.sqrt(0.5 * _BLOCK * float(np.mean(changes[:, part] ** 2)))
                   for part in (slice(3), slice(3, 6)))
    for name, value, unit, why in (
        ("gyro_bias", float(np.max(np.abs(mean[:3]))), "rad/s", "it turns, or is in deg/s"),
        ("gyro_noise", gyro, "rad/s/sqrt(Hz)", "it is shaken, or in deg/s"),
        ("accelerometer_noise", force, "m/s^2/sqrt(Hz)", "it is shaken"),
    ):
        known = getattr(settings, name)
        text = f"{value:.2g} {unit}"
        yield _first(name.replace("_", " "), (
            (value > _MUCH_NOISIER * known, FAIL, f"{text}, expected {known:.2g}: {why}"),
            (value > _NOISIER * known, WARN, f"{text}, expected imu.{name}: {value:.2g} to be "
             f"set, not {known:.2g}"),
        ), f"{text}, imu.{name} is {known:.2g}")


def _rotors(joints: Sensor) -> Iterator[Finding]:
    """Yield what is found of the angles and speeds of the rotors."""
    angles, speeds = joints.values[:, :2], joints.values[:, 2:]
    number, turned = len(angles), float(np.max(np.ptp(angles, axis=0)))  # or nan
    lacking = int(np.count_nonzero(~np.isfinite(speeds).all(axis=1)))
    fastest = float(np.max(np.abs(speeds.mean(axis=0))))
    noise = float(np.max(np.std(speeds, axis=0)))
    kinds = max(len(np.unique(column)) for column in angles.T)
    yield _first("rotor speeds", (
        (lacking, FAIL, f"{lacking} of {number} with an empty velocity or nan, expected rad/s"),
        (not speeds.any() and turned > _COUNT, FAIL,
         f"0 while the angles change by {turned:.2g} rad, expected those of the rotors"),
        (fastest > _TURNING, FAIL, f"{fastest:.2g} rad/s, expected rest"),
        (noise > _SPEED_NOISE, WARN, f"noise of {noise:.2g} rad/s, expected less at rest"),
    ), f"noise of {noise:.2g} rad/s")
    yield _first("rotor angles", (
        (math.isnan(turned), WARN, "none, expected rad: without them stuck encoders do not show"),
        (turned > _COUNT, FAIL, f"a change by {turned:.2g} rad, expected rest"),
        (1 < kinds <= _FEW_ANGLES, WARN, f"angles that toggle by {turned:.2g} rad, a count"),
    ), f"within {turned:.2g} rad")
