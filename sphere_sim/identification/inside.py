# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Constants of masses and inertias from an IMU and rotor speeds alone.

The odometry gives the vertical k and the angular velocity w in the body. With them the balance of
momentum (`sphere_nmpc.model.dynamics`) is linear in what is sought:

    w + rho z z.w - r1 k k.w + c1 u = g,

rho = r1 / r3 - 1, u the rotor speeds about x and y, and g = c1 h a momentum that is constant in
the world for a while. Neither position nor heading enter. The specific force then shows radius and
place of the IMU, as the centre accelerates in proportion to the radius.
"""

from dataclasses import dataclass, replace

import numpy as np

from sphere_nmpc.errors import Description, InvalidInputError
from sphere_nmpc.estimation.imu import ImuSettings
from sphere_nmpc.estimation.odometry import Odometry
from sphere_nmpc.estimation.odometry_settings import OdometrySettings
from sphere_nmpc.model import rotation
from sphere_nmpc.model.parameters import LumpedConstants, RobotParameters
from sphere_nmpc.model.state import QUATERNION, Vector
from sphere_sim.evaluation.series import Series
from sphere_sim.identification.fitting import fitted
from sphere_sim.identification.inertial import Forces, Readings, Track, Value

_UNCERTAIN = 0.1
"""Relative deviations of constants and radius with which the odometry begins [-]."""
_ITERATIONS = 5
_FEWEST, _LEAST_PARTS = 20, 4
"""Estimates in a part, and parts, that are enough."""
_EDGE = 0.1
"""Time at both ends that may be without rotor speeds [s]."""
_STEP = 1e-3
"""Step of the difference by time [s]."""
_FLOOR = 1e-9
"""Share of the information that keeps unknowns without effect where they are [-]."""
_Z = np.array([0.0, 0.0, 1.0])


def track_of(
    readings: Readings, speeds: Series, robot: RobotParameters, imu: ImuSettings, length: float
) -> Track:
    """Return the motion by the odometry, in parts of `length` [s]; empty without a calibration."""
    settings = OdometrySettings(radius_deviation=_UNCERTAIN, constants_deviation=_UNCERTAIN)
    # Without a delay, pose and rate are those of one reading; the offset that is found has it.
    odometry = Odometry(settings, replace(imu, delay=0.0), robot)
    order = np.argsort(np.concatenate((speeds.times, readings.times)), kind="stable")
    times, quaternions, rates = list[float](), list[Vector](), list[Vector]()
    begin = min(float(speeds.times[0]), float(readings.times[0]))
    for k in order.tolist():
        if k < len(speeds):
            odometry.observe_rotors(speeds.times[k] - begin, speeds.values[k])
            continue
        at = k - len(speeds)
        time = float(readings.times[at]) - begin
        if odometry.observe_imu(time, readings.rates[at], readings.forces[at]):
            found = odometry.estimate
            if found is not None and found.time + begin > (times or [-np.inf])[-1]:
                times.append(found.time + begin)
                quaternions.append(found.pose[QUATERNION])
                rates.append(found.body_rate)
    at = np.array(times)
    parts = np.floor((at - at[:1]) / length).astype(np.intp)
    return Track(at, np.array(quaternions).reshape(-1, 4), np.array(rates).reshape(-1, 3), parts)


@dataclass(frozen=True, eq=False)
class Inside:
    """Constants [c1, r1, r3] with their covariance, and offset of the IMU's stamps [s].

    `track` has the rates by the rotor speeds and these constants, without the noise of the gyro.
    """

    constants: Vector
    covariance: Vector
    offset: tuple[float, float]
    track: Track


class Balance:
    """Balance of momentum along a track, and the constants that fulfil it.

    A scale of the gyro, of deviation `gyro_scale`, cannot be seen beside c1, and to estimate it
    would shrink what is left: its deviation is added to those of the constants.
    """

    def __init__(self, track: Track, speeds: Series, gyro_scale: float) -> None:
        self._track, self._speeds = track, speeds
        self._scale = gyro_scale
        self._up = rotation.vertical(track.quaternions)
        self._turns = np.moveaxis(rotation.matrix(track.quaternions.T), -1, 0)
        first, last = speeds.times[[0, -1]]
        known = (track.times > first + _EDGE) & (track.times < last - _EDGE)
        parts = [np.flatnonzero(known & (track.parts == part)) for part in np.unique(track.parts)]
        self.parts = [one for one in parts if one.size >= _FEWEST]
        """Indices of the estimates in each part."""
        if len(self.parts) < _LEAST_PARTS:
            raise InvalidInputError(
                "motion beside the odometry", Description(f"{len(self.parts)} pieces"),
                f"{_LEAST_PARTS} or more after a rest that calibrates it",
            )

    def left(self, chosen: list[int], given: LumpedConstants) -> float:
        """Return the root mean square of the rates that constants leave [rad/s]."""
        rows = self._rows(_unknowns(given), chosen)
        return float(np.sqrt(np.mean(np.concatenate(rows)[:, -1] ** 2)))

    def fitted(self, chosen: list[int], given: LumpedConstants) -> Inside:
        """Return what some parts show; `given` are constants to begin with."""
        values, track = _unknowns(given), self._track
        for _ in range(_ITERATIONS):
            rows = self._rows(values, chosen)
            squares: Vector = np.sum([part.T @ part for part in rows], axis=0)
            inverse = np.linalg.inv(squares[:4, :4] + np.diag(_FLOOR * np.diag(squares)[:4]))
            values = values - inverse @ squares[:4, -1]
        square = float(squares[-1, -1]) / (sum(map(len, rows)) - 3 * len(rows))
        scores = np.array([part[:, :4].T @ part[:, -1] for part in rows])
        simple, spread = inverse * square, inverse @ scores.T @ scores @ inverse
        larger = np.sqrt(np.maximum(np.diag(spread) / np.diag(simple), 1.0))
        by_scale = self._scale * inverse @ squares[:4, 4:7]
        covariance = simple * np.outer(larger, larger) + by_scale @ by_scale.T
        c1, r1, rho = values[:3].tolist()
        at, up = np.concatenate([self.parts[k] for k in chosen]), self._up
        left = np.concatenate([part[:, -1] for part in rows]).reshape(-1, 3, 1)
        balance = np.eye(3) + rho * np.outer(_Z, _Z) - r1 * up[at, :, None] * up[at, None, :]
        rates = track.rates[at] - np.linalg.solve(balance, left)[:, :, 0]
        by = np.zeros((3, 4))
        by[0, 0] = by[1, 1] = 1.0
        by[2, 1:3] = 1.0 / (1.0 + rho), -r1 / (1.0 + rho) ** 2
        return Inside(
            np.array([c1, r1, r1 / (1.0 + rho)]), by @ covariance @ by.T,
            (float(values[3]), float(np.sqrt(covariance[3, 3]))),
            Track(track.times[at], track.quaternions[at], rates, track.parts[at]),
        )

    def _rows(self, values: Vector, chosen: list[int]) -> list[Vector]:
        """Return derivatives and residual of each part, without what a momentum explains.

        The columns are c1, r1, rho, the offset, the relative scales of the gyro, and the residual.
        """
        rates, up = self._track.rates, self._up
        about, along = rates * _Z, up * np.sum(up * rates, axis=1, keepdims=True)
        times, still = self._track.times - values[3], np.zeros((self._track.times.size, 1))
        u, ahead, behind = (
            np.hstack((self._speeds.interpolated(times + shift), still))
            for shift in (0.0, _STEP, -_STEP)
        )
        residual = rates + values[2] * about - values[1] * along + values[0] * u
        slope = -values[0] * (ahead - behind) / (2.0 * _STEP)
        scales = [
            rates * axis + values[2] * about * axis[2]
            - values[1] * up * np.sum(up * rates * axis, axis=1, keepdims=True)
            for axis in np.eye(3)
        ]
        whole = np.stack((u, -along, about, slope, *scales, residual), axis=-1)
        found = []
        for part in (self.parts[k] for k in chosen):
            rows = whole[part].reshape(-1, whole.shape[-1])
            momentum = self._turns[part].transpose(0, 2, 1).reshape(-1, 3)
            found.append(rows - momentum @ np.linalg.lstsq(momentum, rows, rcond=None)[0])
        return found


def _unknowns(given: LumpedConstants) -> Vector:
    """Return [c1, r1, rho, offset]."""
    ratio = given.transverse_ratio
    return np.array([given.input_gain, ratio, ratio / given.axial_ratio - 1.0, 0.0])


def identified_place(
    readings: Readings, inside: Inside, imu: ImuSettings, gyro_scale: float
) -> tuple[Value, Value]:
    """Return the radius [m], shape (1,), and the place of the IMU [m] by its specific force.

    A force at the IMU is that of the centre, which is proportional to the radius, and what its
    place adds; biases and scales of the accelerometer are found beside them.
    """
    period, track = float(np.median(np.diff(readings.times))), inside.track
    part = track.part_at(readings.times - inside.offset[0], 2.0 * period)
    units = np.array([0.1, *(0.01,) * 6, *(0.1,) * 3])

    def at_scale(scale: Vector) -> tuple[Vector, Vector]:
        scaled = replace(track, rates=track.rates * scale)
        forces = Forces(readings, scaled, part, inside.offset[0], imu.turn)
        found, deviations, _ = fitted(
            lambda values: forces.left(float(values[0]), values[1:4], values[4:7], values[7:]),
            np.zeros(10), units, np.repeat(forces.groups, 3),
        )
        return found[:4], deviations[:4]

    best, deviations = at_scale(np.ones(3))
    moved = [at_scale(1.0 + gyro_scale * axis)[0] - best for axis in np.eye(3)]
    deviations = np.sqrt(deviations**2 + np.sum(np.square(moved), axis=0))
    return (best[:1], deviations[:1]), (best[1:], deviations[1:])
