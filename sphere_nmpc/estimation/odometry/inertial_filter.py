# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Error-state Kalman filter of the pose from an IMU in the shell and the speeds of the rotors.

The gyro is the input: it turns the shell, and without slip the sphere rolls by that. Measured are,
over an interval of some hundredths of a second, the specific force, integrated,

    int R f dt = v(t1) - v(t0) + g e3 (t1 - t0),    v = Rs (omega x e3) + omega x r,

which has the tilt; and the mean angular velocity by the balance of momentum,
(diag(1, 1, r1/r3) - r1 k k^T) omega = -c1 ([u, 0] - R^T h), k the vertical in the body. Both are
linearised at what is expected and not at what is measured: the noise of that would else be taken
for information. Symbols are those of `sphere_nmpc.estimation.odometry.inertial_state`.
"""

import math
from dataclasses import replace

import numpy as np

from sphere_nmpc.estimation.imu import ImuSettings
from sphere_nmpc.estimation.odometry.inertial_motion import (
    Motion,
    SensorMap,
    cross,
    crosses,
    sensor_map,
)
from sphere_nmpc.estimation.odometry.inertial_state import (
    ARM,
    FIRST,
    FORCE_BIAS,
    FORCE_MATRIX,
    GYRO_BIAS,
    MOMENTUM,
    OFFSET,
    PHI,
    RADIUS,
    SIZE,
    Belief,
    Findings,
    P,
    Samples,
    applied,
)
from sphere_nmpc.estimation.odometry.rotor_model import RotorModel
from sphere_nmpc.estimation.odometry_settings import OdometryNumbers
from sphere_nmpc.model import rotation
from sphere_nmpc.model.disturbance import GRAVITY
from sphere_nmpc.model.error_state import POSE_ERROR
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
        self.imu, self._numbers, self._pivoting = imu, numbers, pivoting
        """Settings of the IMU, with noises that may have been raised."""
        # Below these the errors of the discretisation are larger.
        self.raise_noises(*numbers.least_noises)
        self.rotors = RotorModel(robot)
        """How the shell turns by the rotors."""
        self.radius = robot.shell_radius
        self.turn, self._place = imu.turn, np.array(imu.position)

    def raise_noises(self, gyro: float, accelerometer: float) -> None:
        """Raise the noise densities to these, as they were seen at rest, where they are larger."""
        self.imu = replace(
            self.imu, gyro_noise=max(self.imu.gyro_noise, gyro),
            accelerometer_noise=max(self.imu.accelerometer_noise, accelerometer),
        )

    def rolled(self, belief: Belief) -> float:
        """Return the radius as estimated [m]."""
        return self.radius * (1.0 + float(belief.numbers[RADIUS - FIRST]))

    def sensor(self, belief: Belief) -> SensorMap:
        """Return how readings are corrected."""
        return sensor_map(belief, self.turn)

    def moved(self, pose: Vector, rates: Vector, step: float, radius: float) -> Vector:
        """Return the pose after a step [s] with body rates [rad/s] at its ends, shape (2, 3)."""
        before, after = rates
        q, turn = pose[QUATERNION], rotation.matrix(pose[QUATERNION])
        # Of a rate that is linear in time, to the fourth order.
        turned = 0.5 * step * (before + after) + step**2 / 12.0 * (cross(before) @ after)
        q = rotation.product(q, rotation.exponential(turned))
        q = q / math.sqrt(float(q @ q))
        by = 0.5 * step * (turn @ before + rotation.matrix(q) @ after)
        return np.concatenate(((pose[0] + radius * by[1], pose[1] - radius * by[0]), q))

    def advance(self, belief: Belief, samples: Samples) -> tuple[Belief, Findings]:
        """Return the belief at the end of an interval, and what it has shown."""
        numbers, motion = self._numbers, self._motion(belief, samples)
        model = None
        if samples.speeds is not None:
            by_gyro = samples.usable and not samples.still
            model = self.rotors.mean_rate(belief, motion, samples.speeds, by_gyro)
        found = belief._replace(
            pose=motion.pose, covariance=self._predicted(belief, motion, samples, model),
            unexplained=numbers.forgotten * belief.unexplained,
            height=numbers.settled * belief.height,
        )
        by_force = by_rate = math.nan
        jump: Vector = np.zeros(3)
        largest = SATURATED * self.imu.accelerometer_range
        if samples.usable and np.max(np.abs(samples.forces)) < largest:
            found, by_force, jump = self._with_force(found, motion, samples)
        if by_force > numbers.improbable(3):
            # Where it does not roll, the balance does not hold either.
            found.covariance[MOMENTUM, MOMENTUM] += numbers.push**2 * np.eye(3)
        elif samples.usable and (model is not None or samples.still):
            found, by_rate = self._with_rate(found, motion, model, samples)
        return found, Findings(by_force, by_rate, jump)

    def _motion(self, belief: Belief, samples: Samples) -> Motion:
        """Return how the shell has moved: by the gyro, else the rotors; not at all at rest."""
        number, pose = len(samples.times), belief.pose
        sensor = self.sensor(belief)
        forces = np.array(samples.forces)
        rates: Vector = np.zeros((number, 3))
        if samples.usable and not samples.still:
            rates = sensor.rates(np.array(samples.rates), forces)
        turns = [rotation.matrix(pose[QUATERNION])] * number
        radius = self.rolled(belief)
        for j in range(0 if samples.still else number - 1):
            pair, step = rates[j : j + 2], samples.times[j + 1] - samples.times[j]
            if samples.speeds is not None and not samples.usable:
                rates[j] = self.rotors.rate(belief, turns[j], samples.speeds[j])[0]
                ahead = self.moved(pose, np.array([rates[j]] * 2), step, radius)
                turn = rotation.matrix(ahead[QUATERNION])
                rates[j + 1] = self.rotors.rate(belief, turn, samples.speeds[j + 1])[0]
            pose = self.moved(pose, pair, step, radius)
            turns[j + 1] = rotation.matrix(pose[QUATERNION])
        forces = sensor.forces(forces)
        times = np.array(samples.times)
        return Motion(pose, np.array(turns), rates, forces, times, samples.weights, sensor)

    def _predicted(
        self, belief: Belief, motion: Motion, samples: Samples,
        model: tuple[Vector, Vector] | None,
    ) -> Vector:
        """Return the covariance at the end of an interval."""
        imu, numbers, covariance = self.imu, self._numbers, belief.covariance
        duration = samples.duration
        noise = np.zeros(SIZE)
        noise[GYRO_BIAS] = imu.gyro_bias_walk**2 * duration
        noise[FORCE_BIAS] = imu.accelerometer_bias_walk**2 * duration
        noise[MOMENTUM] = numbers.momentum_walk**2 * duration
        predicted = covariance.copy()
        if samples.still:
            turned, heading = self._pivoting * duration, PHI.stop - 1
            noise[heading] += turned * (turned + 2.0 * math.sqrt(covariance[heading, heading]))
        else:
            rolls = self.rolled(belief) * ROLL[:2]
            density = imu.gyro_noise
            weighted = motion.weights[:, None, None] * motion.turns
            way = (weighted @ motion.rates[:, :, None]).sum(axis=0)[:, 0]
            within: Vector = np.zeros((2, SIZE))
            if samples.usable:
                errors = motion.turned
                turns = errors[-1]
                spins = crosses(weighted @ motion.rates[:, :, None])
                within = -rolls @ (spins @ errors).sum(axis=0)
            elif model is not None:
                turns = weighted.sum(axis=0) @ model[1]
                density = numbers.model_noise
            else:
                turns, density = np.zeros((3, SIZE)), numbers.blind
            by = np.eye(SIZE)
            by[PHI] += turns
            by[P, PHI] = -rolls @ cross(way)
            by[P] += rolls @ turns + within
            by[P, RADIUS] = rolls @ way
            by[MOMENTUM] += cross(belief.value(MOMENTUM)) @ turns
            predicted = by @ covariance @ by.T
            turning = np.vstack((rolls, np.eye(3)))
            predicted[POSE_ERROR, POSE_ERROR] += density**2 * duration * (turning @ turning.T)
        # Slip goes on, so that its ways add up, not their squares.
        slipped = math.sqrt(float(belief.unexplained @ belief.unexplained)) * duration
        noise[P] += slipped * (slipped + 2.0 * np.sqrt(np.diag(covariance)[P].max()))
        if numbers.is_lifted(belief.height, belief.slipping):
            noise[P] += numbers.carried**2 * duration
        predicted[np.diag_indices(SIZE)] += noise
        return predicted

    def _with_force(
        self, belief: Belief, motion: Motion, samples: Samples
    ) -> tuple[Belief, float, Vector]:
        """Return the belief with the integrated specific force taken into account."""
        numbers, imu, duration = self._numbers, self.imu, samples.duration
        radius = self.rolled(belief)
        place = self._place + belief.value(ARM)
        ends = [0, -1]
        turns, rates = motion.turns[ends], motion.rates[ends]
        rolling = radius * ROLL @ turns - turns @ cross(place)
        weighted = motion.weights[:, None, None] * (motion.turns @ self.turn)
        force = (weighted @ motion.forces[:, :, None]).sum(axis=0)[:, 0]
        before, after = (rolling @ rates[:, :, None])[:, :, 0]
        expected = after - before + GRAVITY * duration * _UP
        jump = force - expected
        # What is expected at each reading is what is measured without the mean innovation.
        forces = motion.forces - (jump / duration) @ (motion.turns @ self.turn)
        by: Vector = np.zeros((3, SIZE))
        turned: Vector = np.zeros((len(forces), 3, SIZE))
        if not samples.still:
            at_ends = rolling @ motion.rate_errors(forces)[ends]
            by += at_ends[1] - at_ends[0]
            turned = motion.turned - motion.turned[-1]  # less than at the end
        corrected = weighted @ motion.sensor.force
        by[:, FORCE_BIAS] += corrected.sum(axis=0)
        by[:, FORCE_MATRIX] += np.einsum("kai,kj->aij", corrected, forces).reshape(3, 9)
        # By the error of the orientation at each reading: what is felt turns, and the velocities.
        turns_by = crosses(weighted @ forces[:, :, None])
        for end, sign in ((0, 1.0), (-1, -1.0)):
            spin = turns[end] @ rates[end]
            lever = turns[end] @ (cross(rates[end]) @ place)
            turns_by[end] += sign * (radius * ROLL @ cross(spin) + cross(lever))
            by[:, ARM] -= sign * cross(spin) @ turns[end]
        by[:, PHI] = turns_by.sum(axis=0)
        by += (turns_by @ turned).sum(axis=0)
        change = turns[1] @ rates[1] - turns[0] @ rates[0]
        variance = imu.accelerometer_noise**2 * duration + belief.vibration
        # That of the radius counts, but is not estimated: scales of the sensors look the same.
        variance += radius**2 * float(change @ change) * float(belief.covariance[RADIUS, RADIUS])
        if not samples.still:
            arm = radius**2 + float(place @ place)
            variance += 2.0 * arm * imu.gyro_noise**2 / samples.step
            # Where the force steps within a reading at an end, its integral is off by an eighth.
            felt = (motion.turns @ self.turn @ motion.forces[:, :, None])[:, :, 0]
            steps = felt[[1, -1]] - felt[[0, -2]]
            variance += (samples.step / 8.0) ** 2 * (steps**2).sum(axis=0)
        largest = numbers.improbable(3)
        found, square, total = self._updated(belief, by, jump, np.diag(variance), largest)
        # Less what an event adds that is none of a vibration.
        excess = np.minimum(jump**2 - np.diag(total), numbers.clipped * np.diag(total))
        share = min(1.0, duration / numbers.vibrates)
        vibration = np.maximum(0.0, belief.vibration + share * excess)
        if square > largest:
            # Or the tilt, or the bias is another one: where that lasts it is learnt anew.
            covariance = belief.covariance.copy()
            for part, size in ((PHI, 1.0), (FORCE_BIAS, GRAVITY)):
                covariance[part, part] += (numbers.doubt * size) ** 2 * np.eye(3)
            unexplained = belief.unexplained + jump
            found = belief._replace(covariance=covariance, unexplained=unexplained)
        height = found.height + float(found.unexplained[2]) * duration
        slipping = belief.slipping + 1 if square > largest else 0
        found = found._replace(vibration=vibration, height=height, slipping=slipping)
        return found, square, jump

    def _with_rate(
        self, belief: Belief, motion: Motion, model: tuple[Vector, Vector] | None,
        samples: Samples,
    ) -> tuple[Belief, float]:
        """Return the belief with the rate by the balance of momentum, and with that of rest."""
        numbers, imu, duration = self._numbers, self.imu, samples.duration
        largest, square, found = numbers.improbable(3), math.nan, belief
        if model is not None:
            expected, by = model
            innovation = -expected
            if not samples.still:
                innovation = motion.weights @ motion.rates / duration - expected
                rates = np.tile(expected, (len(motion.rates), 1))
                errors = replace(motion, rates=rates).rate_errors(motion.forces)
                by = by - np.tensordot(motion.weights / duration, errors, 1)
            variance = imu.gyro_noise**2 / duration + numbers.model_noise**2 / duration
            # Within a step of speeds the mean of two readings is not theirs.
            variance += (self.rotors.gain * samples.bend / (len(samples.times) - 1)) ** 2
            noise = variance * np.eye(3)
            found, square, _ = self._updated(belief, by, innovation, noise, largest)
            if square > largest:
                # A push, or slip: the momentum is another one; or stamps are wrong.
                covariance = belief.covariance.copy()
                covariance[MOMENTUM, MOMENTUM] += numbers.push**2 * np.eye(3)
                covariance[OFFSET, OFFSET] += numbers.offset**2
                belief = belief._replace(covariance=covariance)
                found, _, _ = self._updated(belief, by, innovation, noise, math.inf)
        if samples.still:
            measured = self._rate_at_rest(found, motion, samples)
            found, _, _ = self._updated(found, *measured, largest)
        return found, square

    def rest_square(self, belief: Belief, samples: Samples) -> float:
        """Return the normalised square of the angular velocity of a shell at rest."""
        measured = self._rate_at_rest(belief, self._motion(belief, samples), samples)
        return self._updated(belief, *measured, 0.0)[1]

    def tilt_square(self, belief: Belief, samples: Samples) -> tuple[float, float]:
        """Return the normalised square of the force on a shell at rest, and the angle it shows.

        The angle is that between the verticals by force and by the belief [rad].
        """
        motion = self._motion(belief, samples)
        force = motion.turns[0] @ self.turn @ motion.forces[0]
        between = math.atan2(math.hypot(force[0], force[1]), force[2])
        return self._with_force(belief, motion, samples)[1], between

    def _rate_at_rest(
        self, belief: Belief, motion: Motion, samples: Samples
    ) -> tuple[Vector, Vector, Vector]:
        """Return the derivative of the rate at rest by the error, the rate, and its covariance.

        In rad/s and the body frame.
        """
        duration = samples.duration
        measured = self.sensor(belief).rates(np.array(samples.rates), np.array(samples.forces))
        turn = motion.turns[0] @ self.turn
        forces = np.tile(GRAVITY * turn[2], (len(measured), 1))
        by = -np.tensordot(motion.weights / duration, motion.rate_errors(forces), 1)
        noise = self.imu.gyro_noise**2 / duration * np.eye(3)
        return np.asarray(by, float), motion.weights @ measured / duration, noise

    def with_other_bias(self, belief: Belief, samples: Samples) -> Belief:
        """Return the belief of a gyro whose bias is another one, as its rate at rest shows.

        Or the shell has turned about the vertical while that was seen.
        """
        by, rate, noise = self._rate_at_rest(belief, self._motion(belief, samples), samples)
        covariance = belief.covariance.copy()
        covariance[GYRO_BIAS, GYRO_BIAS] += np.diag(self._numbers.bias_jump**2 + rate**2)
        turned, heading = float(np.linalg.norm(rate)) * samples.duration, PHI.stop - 1
        covariance[heading, heading] += turned**2
        return self._updated(
            belief._replace(covariance=covariance), by, rate, noise, math.inf
        )[0]

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
        found, square, _ = self._updated(belief, by, innovation, covariance, largest)
        return found, square

    def _updated(
        self, belief: Belief, by: Vector, innovation: Vector, noise: Vector, largest: float
    ) -> tuple[Belief, float, Vector]:
        """Return the belief updated by a measurement, unless its square is beyond `largest`.

        Also that normalised square of the innovation, and its covariance.
        """
        across = by @ belief.covariance
        total = across @ by.T + noise
        solved = np.linalg.solve(total, np.column_stack((innovation, across)))
        square = float(innovation @ solved[:, 0])
        if not square <= largest:
            return belief, square, total
        error = across.T @ solved[:, 0]
        covariance = belief.covariance - across.T @ solved[:, 1:]
        covariance = 0.5 * (covariance + covariance.T)
        numbers = belief.numbers + error[FIRST:]
        momentum = slice(MOMENTUM.start - FIRST, MOMENTUM.stop - FIRST)
        turn = rotation.matrix(rotation.exponential(error[PHI]))
        numbers[momentum] = turn @ numbers[momentum]
        pose = applied(belief.pose, error[POSE_ERROR])
        found = belief._replace(pose=pose, numbers=numbers, covariance=covariance)
        return found, square, total
