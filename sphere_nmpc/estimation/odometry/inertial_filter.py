# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Error-state Kalman filter of the pose from an IMU in the shell and the speeds of the rotors.

The gyro is the input: it turns the shell, and without slip the sphere rolls by that. The error is

    [p, phi, b_g, s_g, b_a, s_a, h, c, rho, tau]

position [m] and rotation [rad] in the world frame, true minus estimated, R_true = exp(phi) R, with
which the model, which no motion of the plane changes, is linear in the unobservable position and
heading; biases and scales of gyro and accelerometer, in the axes of the sensor; momentum over I1
[rad/s; world frame], which turns with phi as well, h_true = exp(phi) (h + dh); relative errors of
c1, r1, r3 and of the radius; and the time by which the stamps of the rotors' speeds are late [s].

Measured are, over an interval of some hundredths of a second, the specific force, integrated,

    int R f dt = v(t1) - v(t0) + g e3 (t1 - t0),    v = Rs (omega x e3) + omega x r,

at the place r of the IMU, which has the tilt; and the mean angular velocity by the balance of
momentum, (diag(1, 1, r1/r3) - r1 k k^T) omega = -c1 ([u, 0] - R^T h), k the vertical in the body.
"""

import math
from dataclasses import replace

import numpy as np

from sphere_nmpc.estimation.imu import ImuSettings
from sphere_nmpc.estimation.odometry.inertial_state import (
    CONSTANTS,
    FIRST,
    FORCE_BIAS,
    FORCE_SCALE,
    GYRO_BIAS,
    GYRO_SCALE,
    MOMENTUM,
    OFFSET,
    PHI,
    POSE_ERROR,
    RADIUS,
    SIZE,
    Belief,
    Findings,
    P,
    Samples,
    applied,
)
from sphere_nmpc.estimation.odometry_settings import OdometryNumbers
from sphere_nmpc.model import rotation
from sphere_nmpc.model.disturbance import GRAVITY
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import POSITION, QUATERNION, Vector

ROLL = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
"""Velocity over radius of the centre that rolls by an angular velocity, both in the world."""
SATURATED = 0.999
"""Share of its range at which a sensor counts as saturated [-]."""
_UP = np.array([0.0, 0.0, 1.0])


class InertialFilter:
    """Model of sphere and sensors, with the prediction and the updates of a `Belief`.

    `pivoting` is the angular velocity about the vertical at which a sphere may turn unnoticed
    [rad/s].
    """

    def __init__(
        self, imu: ImuSettings, robot: RobotParameters, numbers: OdometryNumbers,
        pivoting: float = 0.0,
    ) -> None:
        self._pivoting = pivoting
        # Below these the errors of the discretisation are larger.
        gyro, accelerometer = numbers.least_noises
        self.imu = imu = replace(
            imu, gyro_noise=max(imu.gyro_noise, gyro),
            accelerometer_noise=max(imu.accelerometer_noise, accelerometer),
        )
        self._numbers = numbers
        self._constants = np.array(robot.lumped.as_array()[1:])
        self.radius = robot.shell_radius
        self._turn, self._place = imu.turn, np.array(imu.position)
        self._lever = float(self._place @ self._place)

    def body_rates(self, belief: Belief, rates: Vector) -> Vector:
        """Return measured rates, shape (n, 3), without their bias and scale, in the body frame."""
        scale = 1.0 + belief.value(GYRO_SCALE)
        found: Vector = ((rates - belief.value(GYRO_BIAS)) / scale) @ self._turn.T
        return found

    def _force(self, belief: Belief, force: Vector) -> Vector:
        """Return a measured specific force, shape (3,), without its bias and scale."""
        found: Vector = (force - belief.value(FORCE_BIAS)) / (1.0 + belief.value(FORCE_SCALE))
        return found

    def rolled(self, belief: Belief) -> float:
        """Return the radius as estimated [m]."""
        return self.radius * (1.0 + float(belief.numbers[RADIUS - FIRST]))

    def moved(self, pose: Vector, turned: Vector, radius: float) -> tuple[Vector, Vector]:
        """Return the pose after a small rotation [rad; body frame] and the mean orientation."""
        q = pose[QUATERNION]
        middle = rotation.matrix(rotation.product(q, rotation.exponential(0.5 * turned)))
        q = rotation.product(q, rotation.exponential(turned))
        by = middle @ turned
        x, y = pose[0] + radius * by[1], pose[1] - radius * by[0]
        return np.concatenate(((x, y), q / math.sqrt(float(q @ q)))), middle

    def model_rate(
        self, belief: Belief, turn: Vector, speeds: Vector
    ) -> tuple[Vector, Vector]:
        """Return the angular velocity by the balance of momentum [rad/s; body frame], (3,).

        Also the inverse of its matrix, (3, 3). `turn` is the orientation, body to world, `speeds`
        are those of the rotors [rad/s].
        """
        c1, r1, r3 = self._constants * (1.0 + belief.value(CONSTANTS))
        up = turn[2]
        inverse = np.linalg.inv(np.diag((1.0, 1.0, r1 / r3)) - r1 * np.outer(up, up))
        drive = np.append(speeds, 0.0) - turn.T @ belief.value(MOMENTUM)
        return -c1 * (inverse @ drive), inverse

    def advance(self, belief: Belief, samples: Samples) -> tuple[Belief, Findings]:
        """Return the belief at the end of an interval, and what it has shown."""
        rates = self._rates(belief, samples)
        radius, turn = self.rolled(belief), self._turn
        start, pose = rotation.matrix(belief.pose[QUATERNION]), belief.pose
        whole = np.zeros((3, 3))  # int R T dt
        scaled = np.zeros((3, 3))  # int R T diag(rate of the sensor) dt
        felt = np.zeros((3, 3))  # int R T diag(specific force of the sensor) dt
        way: Vector = np.zeros(3)
        middles: list[Vector] = []
        for j, (before, after) in enumerate(zip(samples.times, samples.times[1:], strict=False)):
            step = after - before
            mean = 0.5 * (rates[j] + rates[j + 1])
            if samples.speeds is not None and not samples.usable:
                mean = self._by_rotors(belief, pose, samples.speeds[j : j + 2], step)
            turned = 0.0 * mean if samples.still else mean * step
            pose, middle = self.moved(pose, turned, radius)
            middles.append(middle)
            part = middle @ turn * step
            whole += part
            scaled += part * (mean @ turn)
            felt += part * self._force(belief, samples.forces[j + 1])
            way += middle @ turned
        model = None
        if samples.speeds is not None:
            model = self._model(belief, middles, samples.speeds, samples.duration)
        covariance = self._predicted(belief, whole, scaled, way, samples, model)
        unexplained = self._numbers.forgotten * belief.unexplained
        moved = Belief(pose, belief.numbers, covariance, unexplained)
        found, by_force = moved, math.nan
        jump: Vector = np.zeros(3)
        largest = SATURATED * self.imu.accelerometer_range
        if samples.usable and np.max(np.abs(samples.forces[1:])) < largest:
            found, by_force, jump = self._with_force(moved, start, rates, whole, felt, samples)
        by_rate = math.nan
        if by_force > self._numbers.improbable:
            # Where it does not roll, the balance does not hold either.
            found.covariance[MOMENTUM, MOMENTUM] += self._numbers.push**2 * np.eye(3)
        elif model is not None and samples.usable:
            found, by_rate = self._with_rate(found, *model, rates, samples)
        return found, Findings(by_force, by_rate, jump)

    def _rates(self, belief: Belief, samples: Samples) -> Vector:
        """Return the angular velocities by the gyro [rad/s; body frame], zeros without one."""
        if samples.usable:
            return self.body_rates(belief, np.array(samples.rates))
        return np.zeros((len(samples.times), 3))

    def _by_rotors(self, belief: Belief, pose: Vector, speeds: Vector, step: float) -> Vector:
        """Return the mean angular velocity by the rotors [rad/s; body frame], shape (3,)."""
        q, mean = pose[QUATERNION], speeds.mean(axis=0)
        rate, _ = self.model_rate(belief, rotation.matrix(q), speeds[0])
        middle = rotation.product(q, rotation.exponential(0.5 * step * rate))
        return self.model_rate(belief, rotation.matrix(middle), mean)[0]

    def _predicted(
        self, belief: Belief, whole: Vector, scaled: Vector, way: Vector, samples: Samples,
        model: tuple[Vector, Vector] | None,
    ) -> Vector:
        """Return the covariance at the end of an interval."""
        imu, numbers, covariance = self.imu, self._numbers, belief.covariance
        duration = samples.duration
        rolls = self.rolled(belief) * ROLL[:2]
        noise = np.zeros(SIZE)
        noise[GYRO_BIAS] = imu.gyro_bias_walk**2 * duration
        noise[MOMENTUM] = numbers.momentum_walk**2 * duration
        by = np.eye(SIZE)
        density = imu.gyro_noise
        turns: Vector = np.zeros((3, SIZE))
        if samples.usable:
            turns[:, GYRO_BIAS], turns[:, GYRO_SCALE] = -whole, -scaled
        elif model is not None:
            turns, density = whole @ self._turn.T @ model[1], numbers.model_noise
        else:
            density = numbers.blind
        if not samples.still:
            by[PHI] += turns
            by[P, PHI] = -rolls @ _cross(way)
            by[P] += rolls @ turns
            by[P, RADIUS] = rolls @ way
            by[MOMENTUM] += _cross(belief.value(MOMENTUM)) @ turns
        predicted = by @ covariance @ by.T
        if not samples.still:
            turning = np.vstack((rolls, np.eye(3)))
            predicted[POSE_ERROR, POSE_ERROR] += density**2 * duration * (turning @ turning.T)
        # Slip and pivoting go on, so that their ways add up, not their squares.
        slipped = math.sqrt(float(belief.unexplained @ belief.unexplained)) * duration
        noise[P] += slipped * (slipped + 2.0 * np.sqrt(np.diag(covariance)[P].max()))
        if samples.still:
            turned, heading = self._pivoting * duration, PHI.stop - 1
            noise[heading] += turned * (turned + 2.0 * math.sqrt(covariance[heading, heading]))
        if abs(belief.unexplained[2]) > numbers.lift:
            noise[P] += numbers.carried**2 * duration
        predicted[np.diag_indices(SIZE)] += noise
        return predicted

    def _with_force(
        self, belief: Belief, start: Vector, rates: Vector, whole: Vector, felt: Vector,
        samples: Samples,
    ) -> tuple[Belief, float, Vector]:
        """Return the belief with the integrated specific force taken into account."""
        numbers, imu, duration = self._numbers, self.imu, samples.duration
        radius, turn = self.rolled(belief), self._turn
        end = rotation.matrix(belief.pose[QUATERNION])
        force = felt.sum(axis=1)
        first, last = rates[0], rates[-1]
        by = np.zeros((3, SIZE))
        by[:, FORCE_BIAS], by[:, FORCE_SCALE] = whole, felt
        change = lever = np.zeros(3)
        if not samples.still:
            change = end @ last - start @ first
            lever = end @ np.cross(last, self._place) - start @ np.cross(first, self._place)
            arm = _cross(self._place)
            after, before = (
                (radius * ROLL @ place - place @ arm) @ turn for place in (end, start)
            )
            by[:, GYRO_BIAS] = before - after
            by[:, GYRO_SCALE] = before * (first @ turn) - after * (last @ turn)
        expected = radius * (ROLL @ change) + lever + GRAVITY * duration * _UP
        jump = force - expected
        # At what is expected, for which a change of the heading has no effect: with the noise of
        # what is measured the filter would take it for information on the heading.
        by[:, PHI] = _cross(expected) - radius * (ROLL @ _cross(change)) - _cross(lever)
        variance = imu.accelerometer_noise**2 * duration
        # That of the radius counts, but is not estimated: scales of the sensors look the same.
        variance += radius**2 * float(change @ change) * float(belief.covariance[RADIUS, RADIUS])
        if not samples.still:
            variance += 2.0 * (radius**2 + self._lever) * imu.gyro_noise**2 / samples.step
        found, square = self._updated(belief, by, jump, variance * np.eye(3), numbers.improbable)
        if square > numbers.improbable:
            # Or the tilt, or the bias is another one: where that lasts it is learnt anew.
            covariance = belief.covariance.copy()
            for part, size in ((PHI, 1.0), (FORCE_BIAS, GRAVITY)):
                covariance[part, part] += (numbers.doubt * size) ** 2 * np.eye(3)
            unexplained = belief.unexplained + jump
            found = belief._replace(covariance=covariance, unexplained=unexplained)
        return found, square, jump

    def _model(
        self, belief: Belief, middles: list[Vector], speeds: Vector, duration: float
    ) -> tuple[Vector, Vector]:
        """Return the mean angular velocity by the balance of momentum, and its derivative.

        In rad/s and the body frame, shape (3,), by the error, shape (3, 25).
        """
        means = 0.5 * (speeds[:-1] + speeds[1:])
        rates = [
            self.model_rate(belief, middle, mean)
            for middle, mean in zip(middles, means, strict=True)
        ]
        half = len(middles) // 2
        turn, (rate, inverse) = middles[half], rates[half]
        c1, r1, r3 = self._constants * (1.0 + belief.value(CONSTANTS))
        up, by = turn[2], np.zeros((3, SIZE))
        # The vertical in the body changes by -R^T (phi x e3), the momentum in it by its own error.
        tilted = turn.T @ _cross(_UP)
        by[:, PHI] = r1 * inverse @ (np.outer(up, tilted.T @ rate) + (up @ rate) * tilted)
        by[:, MOMENTUM] = c1 * (inverse @ turn.T)
        axial = np.array((0.0, 0.0, r1 / r3 * rate[2]))
        by[:, CONSTANTS] = np.column_stack((
            rate, inverse @ (r1 * (up @ rate) * up - axial), inverse @ axial
        ))
        by[:, OFFSET] = -c1 * (inverse @ np.append((speeds[-1] - speeds[0]) / duration, 0.0))
        return np.mean([found for found, _ in rates], axis=0), by

    def _with_rate(
        self, belief: Belief, model: Vector, by: Vector, rates: Vector, samples: Samples,
    ) -> tuple[Belief, float]:
        """Return the belief with the angular velocity by the balance of momentum."""
        numbers, imu, duration = self._numbers, self.imu, samples.duration
        wanted = np.zeros(3) if samples.still else 0.5 * np.mean(rates[:-1] + rates[1:], axis=0)
        if not samples.still:
            by[:, GYRO_BIAS] = self._turn
            by[:, GYRO_SCALE] = self._turn * (wanted @ self._turn)
        variance = imu.gyro_noise**2 / duration + numbers.model_noise**2 / duration
        # Within a step of speeds the mean of two readings is not theirs.
        variance += (self._constants[0] * samples.bend / (len(samples.times) - 1)) ** 2
        noise = variance * np.eye(3)
        found, square = self._updated(belief, by, wanted - model, noise, numbers.improbable)
        if square > numbers.improbable:
            # A push, or slip: the momentum is another one; or stamps are wrong.
            covariance = belief.covariance.copy()
            covariance[MOMENTUM, MOMENTUM] += numbers.push**2 * np.eye(3)
            covariance[OFFSET, OFFSET] += numbers.offset**2
            belief = belief._replace(covariance=covariance)
            found, _ = self._updated(belief, by, wanted - model, noise, math.inf)
        if samples.still:
            # The rate of the shell is measured as well: it is zero.
            measured = self.body_rates(found, np.array(samples.rates)).mean(axis=0)
            at_rest = np.zeros((3, SIZE))
            at_rest[:, GYRO_BIAS] = self._turn
            found, _ = self._updated(
                found, at_rest, measured, imu.gyro_noise**2 / duration * np.eye(3), math.inf
            )
        return found, square

    def with_pose(
        self, belief: Belief, pose: Vector, covariance: Vector, largest: float
    ) -> tuple[Belief, float]:
        """Return the belief with a measured pose, and the normalised square of its innovation.

        `covariance`, shape (5, 5), is that of the error in the world frame. Beyond `largest` the
        pose is not used.
        """
        turn = rotation.product(pose[QUATERNION], rotation.conjugate(belief.pose[QUATERNION]))
        innovation = np.concatenate((
            pose[POSITION] - belief.pose[POSITION], rotation.logarithm(turn)
        ))
        by = np.eye(5, SIZE)
        return self._updated(belief, by, innovation, covariance, largest)

    def _updated(
        self, belief: Belief, by: Vector, innovation: Vector, noise: Vector, largest: float
    ) -> tuple[Belief, float]:
        """Return the belief updated by a measurement, unless its square is beyond `largest`."""
        across = by @ belief.covariance
        total = across @ by.T + noise
        solved = np.linalg.solve(total, np.column_stack((innovation, across)))
        square = float(innovation @ solved[:, 0])
        if not square <= largest:
            return belief, square
        error = across.T @ solved[:, 0]
        covariance = belief.covariance - across.T @ solved[:, 1:]
        covariance = 0.5 * (covariance + covariance.T)
        numbers = belief.numbers + error[FIRST:]
        momentum = slice(MOMENTUM.start - FIRST, MOMENTUM.stop - FIRST)
        turn = rotation.matrix(rotation.exponential(error[PHI]))
        numbers[momentum] = turn @ numbers[momentum]
        pose = applied(belief.pose, error[POSE_ERROR])
        return Belief(pose, numbers, covariance, belief.unexplained), square


def _cross(vector: Vector) -> Vector:
    """Return the matrix of the cross product with a vector, shape (3, 3)."""
    x, y, z = vector.tolist()
    return np.array(((0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0)))
