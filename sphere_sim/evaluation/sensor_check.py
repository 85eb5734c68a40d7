# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Checks of the sensors of a robot that stands still: conventions, units, stamps and noise."""

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sphere_nmpc.estimation.imu import ImuSettings
from sphere_nmpc.model import rotation
from sphere_nmpc.model.disturbance import GRAVITY
from sphere_nmpc.model.state import QUATERNION, Vector
from sphere_nmpc.quantity import NANOSECONDS
from sphere_sim.evaluation.metrics import angle_errors

PASS, WARN, FAIL = "PASS", "WARN", "FAIL"
_FEWEST = 20
"""Messages below which nothing is evaluated."""
_AHEAD, _LATE = 0.1, 0.5
"""Offsets of stamps that are those of another clock [s]."""
_IRREGULAR, _GAP = 0.3, 5.0
"""Deviation of the steps of stamps, and longest gap, over their median, that are reported [-]."""
_BLOCK = 0.25
"""Time over which readings are averaged, so that vibrations count little [s]."""
_STILL = (2e-3, 0.03)
"""Changes of the means of gyro [rad/s] and accelerometer [m/s^2] that are none, whatever their
noise: in a second the first is a tenth of a degree, the second an inclination by that."""
_SCATTERS = 8.0
"""Standard deviations of the mean by which one may differ at rest [-]; noise that a device filters
is larger in a mean than its readings show."""
_CONVENTIONS = (
    (0.8, 1.2, "in g"), (31.5, 32.9, "in ft/s^2"),
    (950.0, 992.0, "in cm/s^2"), (992.0, 1050.0, "in mg"), (9.4e3, 1.02e4, "in mm/s^2"),
    (18.6, 20.6, "with gravity added twice"),
)
"""Norms of the specific force at rest from and to which it is given in another convention."""
_NO_GRAVITY = 0.8
"""Norm of the specific force at rest [m/s^2] below which gravity has been removed."""
_NOISIER, _MUCH_NOISIER = 3.0, 20.0
"""Noise or bias over what the settings say from which they are corrected, and from which a unit is
wrong [-]: rad are 57 deg."""
_TILTED = math.radians(5.0)
"""Difference of the vertical of accelerometer and pose that is reported [rad]: biases of 50 mg
give 3 degrees."""
_TURNING = 0.1
"""Speed of a rotor that turns [rad/s]."""
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
    found = [*_stream("imu", imu, 100.0), *_inertial(imu, pose, settings)]
    if joints is None:
        found.append(Finding(WARN, "joint_states", "no encoders: rest and turns by the IMU alone"))
    else:
        found += [*_stream("joint_states", joints, 50.0), *_rotors(joints)]
    if pose is not None:
        found += [*_stream("pose", pose, 20.0), *_scatter(pose)]
    return found


def _stream(name: str, sensor: Sensor, least: float) -> Iterator[Finding]:
    """Yield what is found of rate and stamps."""
    number = len(sensor.stamps)
    spans = [float(np.ptp(it)) / NANOSECONDS for it in (sensor.received, sensor.stamps) if number]
    rate = (number - 1) / spans[0] if number > 1 and spans[0] > 0.0 else math.nan
    enough = f"{least:g} Hz or more"
    if number < _FEWEST:
        yield Finding(FAIL, f"{name} rate", f"given {number} messages, expected {enough}: start "
                      f"its driver, or -r {name}:=/its/topic")
        return
    slow = rate < 0.95 * least
    text = f"given {rate:.4g} Hz, expected {enough}" if slow else f"{rate:.4g} Hz"
    yield Finding(WARN if slow else PASS, f"{name} rate", text)
    name = f"{name} stamps"
    age = float(np.median(sensor.received - sensor.stamps)) / NANOSECONDS
    steps = np.diff(sensor.stamps) / NANOSECONDS
    typical, zeros = float(np.median(steps)), int(np.count_nonzero(sensor.stamps == 0))
    back, equal = (int(np.count_nonzero(one)) for one in (steps < 0.0, steps == 0.0))
    if zeros:
        yield Finding(FAIL, name, f"given 0 in {zeros} of {number}, expected the time of "
                      "measurement")
    elif age < -_AHEAD:
        leap = ": GPS time is 18 s ahead of UTC" if abs(age + 18.0) < _LATE else ""
        yield Finding(FAIL, name, f"given {-age:.3g} s ahead of the clock, expected that of the "
                      f"machine that receives them{leap}")
    elif age > _LATE:
        yield Finding(FAIL, name, f"given {age:.3g} s behind the clock, expected that of the "
                      "machine that receives them (use_sim_time of a simulator)")
    elif back:
        yield Finding(FAIL, name, f"given {back} that go back, expected one publisher")
    elif equal:
        verdict = FAIL if 2 * equal > number else WARN
        yield Finding(verdict, name, f"given {equal} of {number} equal to the one before")
    else:
        scatter, longest = float(np.std(steps)), float(np.max(steps))
        uneven = scatter > _IRREGULAR * typical or longest > _GAP * typical
        yield Finding(
            WARN if uneven else PASS, name,
            f"{1e3 * age:.1f} ms old, steps of {1e3 * typical:.3g} +- {1e3 * scatter:.2f} ms, "
            f"longest {1e3 * longest:.3g} ms" + (", expected even ones" if uneven else ""),
        )


def _inertial(imu: Sensor, pose: Sensor | None, settings: ImuSettings) -> Iterator[Finding]:
    """Yield what is found of the readings of an IMU."""
    number = len(imu.stamps)
    if number < _FEWEST:
        return
    if invalid := int(np.count_nonzero(~np.isfinite(imu.values).all(axis=1))):
        yield Finding(FAIL, "imu readings", f"given {invalid} of {number} that are not finite")
        return
    equal = int(np.count_nonzero((np.diff(imu.values, axis=0) == 0.0).all(axis=1)))
    if equal:
        verdict = FAIL if 2 * equal > number else WARN
        yield Finding(verdict, "imu readings", f"given {equal} of {number} equal to the one "
                      "before, expected noise: stuck, or published faster than measured")
    else:
        yield Finding(PASS, "imu readings", f"{number}, none equal to the one before")
    span = max(float(np.ptp(imu.received)), float(np.ptp(imu.stamps))) / NANOSECONDS
    if all(imu.stamps) and 0.5 < float(np.ptp(imu.stamps)) / float(np.ptp(imu.received)) < 2.0:
        span = float(np.ptp(imu.stamps)) / NANOSECONDS
    step = span / (number - 1)
    size = max(2, round(_BLOCK / step))
    whole = number // size
    blocks = imu.values[: whole * size].reshape(whole, size, 6).mean(axis=1)
    mean = imu.values.mean(axis=0)
    single = np.std(np.diff(imu.values, axis=0), axis=0) / math.sqrt(2.0)
    allowed = np.repeat(_STILL, 3) + _SCATTERS * single / math.sqrt(size)
    moved = np.abs(blocks - np.median(blocks, axis=0)) - allowed
    is_still = whole > 1 and bool(np.all(moved <= 0.0))
    rate, force = (float(np.max(np.ptp(blocks[:, part], axis=0)))
                   for part in (slice(3), slice(3, 6)))
    yield Finding(
        PASS if is_still else FAIL, "imu rest", f"means over {_BLOCK:g} s change by {rate:.2g} "
        f"rad/s and {force:.2g} m/s^2" + ("" if is_still else ", expected a robot left alone"),
    )
    norm = float(np.median(np.linalg.norm(blocks[:, 3:], axis=1)))
    yield _gravity(norm, settings)
    if is_still and norm >= _NO_GRAVITY:
        yield _vertical(mean[3:] / np.linalg.norm(mean[3:]), pose, settings)
    if is_still:
        yield from _errors(mean, blocks, size * step, settings)


def _gravity(norm: float, settings: ImuSettings) -> Finding:
    """Return what is found of the norm of the specific force at rest [m/s^2]."""
    name, expected = "specific force", f"expected {GRAVITY:.2f} m/s^2"
    if norm < _NO_GRAVITY:
        return Finding(FAIL, name, f"given {norm:.2f}, {expected}: gravity removed")
    for least, most, what in _CONVENTIONS:
        if least <= norm < most:
            return Finding(FAIL, name, f"given {norm:.4g}, {expected}: {what}")
    allowed = 4.0 * (settings.accelerometer_bias + GRAVITY * settings.accelerometer_scale)
    if abs(norm - GRAVITY) > allowed:
        verdict = FAIL if abs(norm - GRAVITY) > 0.3 * GRAVITY else WARN
        return Finding(verdict, name, f"given {norm:.4g}, {expected} +- {allowed:.2g} by "
                       "imu.accelerometer_bias and imu.accelerometer_scale")
    return Finding(PASS, name, f"{norm:.3f} m/s^2")


def _vertical(up: Vector, pose: Sensor | None, settings: ImuSettings) -> Finding:
    """Return what is found of the vertical in the axes of the IMU, shape (3,)."""
    body = settings.turn @ up
    shown = ", ".join(f"{one:+.2f}" for one in body)
    text = f"is ({shown}) in the body by imu.orientation, {_axis(up)} of the IMU"
    if pose is None or not len(pose.stamps):
        return Finding(PASS, "up", f"{text}: look whether it is")
    given = rotation.vertical(pose.values[-1, QUATERNION])
    angle = math.acos(float(np.clip(given @ body, -1.0, 1.0)))
    if angle < _TILTED:
        return Finding(PASS, "up", f"{text}, as pose has it")
    why = ": opposite sign, or upside down" if angle > math.radians(150.0) else ""
    return Finding(FAIL, "up", f"{text}, {math.degrees(angle):.1f} deg from that of pose, "
                   f"expected less than {math.degrees(_TILTED):.0f}{why}")


def _axis(up: Vector) -> str:
    """Return the axis that is nearest to a direction."""
    k = int(np.argmax(np.abs(up)))
    return f"near {'+' if up[k] > 0.0 else '-'}{'xyz'[k]}"


def _errors(
    mean: Vector, blocks: Vector, duration: float, settings: ImuSettings
) -> Iterator[Finding]:
    """Yield what is found of bias and noise, by means over a duration [s] at rest."""
    bias = float(np.max(np.abs(mean[:3])))
    of_bias = bias / max(settings.gyro_bias, 1e-6)
    # Of differences of neighbours, which a drift does not enter (the Allan deviation).
    changes = np.diff(blocks, axis=0)
    densities = [
        math.sqrt(0.5 * float(np.mean(changes[:, part] ** 2)) * duration)
        for part in (slice(3), slice(3, 6))
    ]
    of_noise = densities[0] / max(settings.gyro_noise, 1e-5)
    in_degrees = ": in deg/s, expected rad/s" if min(of_bias, of_noise) > _NOISIER else ""
    yield _compared("gyro bias", "imu.gyro_bias", bias, settings.gyro_bias, "rad/s",
                    in_degrees or ": it turns, or is in deg/s")
    yield _compared("gyro noise", "imu.gyro_noise", densities[0], settings.gyro_noise,
                    "rad/s/sqrt(Hz)", in_degrees or ": in deg/s, or a shaken robot")
    yield _compared("accelerometer noise", "imu.accelerometer_noise", densities[1],
                    settings.accelerometer_noise, "m/s^2/sqrt(Hz)", ": a shaken robot")


def _compared(
    name: str, setting: str, value: float, known: float, unit: str, much: str
) -> Finding:
    """Return how a measured size of an error compares with its setting."""
    ratio = value / known if known > 0.0 else math.inf
    text = f"{value:.2g} {unit}, {setting} is {known:.2g}"
    if ratio > _MUCH_NOISIER:
        return Finding(FAIL, name, f"given {text}{much}")
    if ratio > _NOISIER:
        return Finding(WARN, name, f"given {text}, expected it to be set: {value:.2g}")
    return Finding(PASS, name, text)


def _rotors(joints: Sensor) -> Iterator[Finding]:
    """Yield what is found of the angles and speeds of the rotors."""
    number = len(joints.stamps)
    if number < _FEWEST:
        return
    angles, speeds = joints.values[:, :2], joints.values[:, 2:]
    turned = float(np.max(np.ptp(angles, axis=0))) if np.isfinite(angles).all() else math.nan
    lacking = int(np.count_nonzero(~np.isfinite(speeds).all(axis=1)))
    if lacking:
        yield Finding(FAIL, "rotor speeds", f"given {lacking} of {number} with an empty velocity "
                      "or nan, expected rad/s")
    elif not speeds.any() and turned > _COUNT:
        yield Finding(FAIL, "rotor speeds", f"given 0 while the angles change by {turned:.2g} "
                      "rad, expected those of the rotors")
    elif float(np.max(np.abs(speeds.mean(axis=0)))) > _TURNING:
        fastest = float(np.max(np.abs(speeds.mean(axis=0))))
        yield Finding(FAIL, "rotor speeds", f"given {fastest:.2g} rad/s, expected rest")
    else:
        noise = float(np.max(np.std(speeds, axis=0)))
        verdict = WARN if noise > 1e-3 else PASS
        yield Finding(verdict, "rotor speeds", f"noise of {noise:.2g} rad/s at rest")
    if math.isnan(turned):
        yield Finding(WARN, "rotor angles", "given none, expected rad: without them encoders that "
                      "are stuck do not show")
    elif turned > _COUNT:
        yield Finding(FAIL, "rotor angles", f"given a change by {turned:.2g} rad, expected rest")
    else:
        kinds = max(len(np.unique(column)) for column in angles.T)
        toggles = 1 < kinds <= _FEW_ANGLES
        text = f"toggle by {turned:.2g} rad, a count" if toggles else f"within {turned:.2g} rad"
        yield Finding(WARN if toggles else PASS, "rotor angles", text)


def _scatter(pose: Sensor) -> Iterator[Finding]:
    """Yield how much poses scatter."""
    if len(pose.stamps) >= _FEWEST and np.isfinite(pose.values).all():
        place = math.sqrt(float(np.mean(np.var(pose.values[:, :2], axis=0))))
        angles = angle_errors(pose.values, np.median(pose.values, axis=0))
        angle = math.sqrt(float(np.mean(angles**2)) / 3.0)
        yield Finding(PASS, "pose noise", f"{1e3 * place:.2g} mm and {math.degrees(angle):.2g} "
                      "deg")
