# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Angular momentum about the contact point, and the disturbances that change it.

A push, a slope and a centre of mass beside the centre of the sphere give the sphere angular
momentum H about the contact point, which the paper takes as zero (Eq. 11). Divided by the axial
inertia I1 of a rotor, h = H / I1 has the unit of a rotor speed, and with it the equations of
motion need no further constant of the plant (`sphere_nmpc.model.dynamics`). It changes by

    dh/dt = s + (R a) x (-e3) - v x (w x R a) / g,

s the torque of gravity on a slope over I1, horizontal and constant in the world; a = Mt g c / I1
with c the centre of mass in the body; v and w the velocity of the centre and the angular velocity.
The centre of mass also enters the inertia about the contact point.

The sphere is at rest with momentum where the rotors hold it: rotor speeds (R^T h)_1,2, if the
component of h along the body's z axis is zero.

Here momenta h, shape (3,), are in rad/s in the world frame, quaternions have shape (4,).
"""

import math
from dataclasses import dataclass, field

import numpy as np

from sphere_nmpc.model import rotation
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.rotation import Vector

GRAVITY = 9.81
"""Acceleration of free fall g [m/s^2]."""


@dataclass(frozen=True, eq=False)
class Disturbance:
    """Slope of the floor and imbalance of the sphere: what changes the momentum.

    Attributes
    ----------
    slope : ndarray, shape (2,)
        s, the torque of a slope over I1 [rad/s^2; world frame].
    imbalance : ndarray, shape (3,)
        a = Mt g c / I1 of a centre of mass at c [rad/s^2; body frame].
    """

    slope: Vector = field(default_factory=lambda: np.zeros(2))
    imbalance: Vector = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self) -> None:
        for array in (self.slope, self.imbalance):
            array.flags.writeable = False  # strategies and plants are given the same arrays

    @classmethod
    def from_array(cls, torques: Vector) -> "Disturbance":
        """Return the disturbance of an array [s, a], shape (5,)."""
        return cls(torques[:2].copy(), torques[2:].copy())

    def as_array(self) -> Vector:
        """Return [s, a], shape (5,)."""
        return np.concatenate((self.slope, self.imbalance))

    def at_rest(self, quaternion: Vector) -> Vector:
        """Return dh/dt of a sphere that rests at an orientation [rad/s^2; world], (3,)."""
        if not self.imbalance.any():
            return np.append(self.slope, 0.0)
        world = rotation.matrix(quaternion) @ self.imbalance
        return np.array([self.slope[0] - world[1], self.slope[1] + world[0], 0.0])


UNDISTURBED = Disturbance()
"""A level floor and a balanced sphere."""


def is_zero(momentum: Vector, disturbance: Disturbance) -> bool:
    """Return whether the model is the paper's: no momentum, level and balanced."""
    return not (
        momentum.any() or disturbance.slope.any() or disturbance.imbalance.any()
    )


def in_body(momentum: Vector, quaternion: Vector) -> Vector:
    """Return a momentum in the body frame at an orientation [rad/s], shape (3,)."""
    return np.array(rotation.to_body(quaternion, momentum))


def rest_speeds(momentum: Vector, quaternion: Vector) -> Vector:
    """Return the rotor speeds that hold a momentum at an orientation [rad/s], shape (2,).

    With them the sphere rests if the component of the momentum along the body's z axis is zero;
    otherwise it turns slowly about that axis.
    """
    return in_body(momentum, quaternion)[:2] if momentum.any() else np.zeros(2)


def after_slope(momentum: Vector, disturbance: Disturbance, duration: float) -> Vector:
    """Return the momentum after `duration` [s] of the slope's torque alone."""
    return momentum + duration * np.append(disturbance.slope, 0.0)


def speeds_at_rest(
    momentum: Vector, disturbance: Disturbance, quaternion: Vector, times: Vector
) -> Vector:
    """Return the speeds that hold a momentum after times of rest [s], (n,), in rad/s, (n, 2).

    At rest the orientation does not change, so they grow linearly.
    """
    gained = rest_speeds(disturbance.at_rest(quaternion), quaternion)
    return rest_speeds(momentum, quaternion) + np.multiply.outer(times, gained)


def momentum_of_push(robot: RobotParameters, impulse: Vector) -> Vector:
    """Return the jump of h [rad/s; world frame], shape (3,), by an impulse at the centre.

    The impulse, shape (2,), is in N s in the world frame.
    """
    lever = robot.shell_radius / robot.rotor_axial_inertia
    return np.array([-lever * impulse[1], lever * impulse[0], 0.0])


def push_against(robot: RobotParameters, momentum: Vector) -> Vector:
    """Return the impulse at the centre [N s; world frame], shape (2,), that takes a momentum h.

    It takes the horizontal part; see `momentum_of_push` for the units.
    """
    arm = robot.rotor_axial_inertia / robot.shell_radius
    return arm * np.array([-momentum[1], momentum[0]])


def slope_torque(robot: RobotParameters, angle: float, direction: float) -> Vector:
    """Return s of a slope [rad/s^2; world frame], shape (2,).

    `angle` is its inclination, `direction` that downhill, from the x axis [rad].
    """
    force = robot.total_mass * GRAVITY * np.sin(angle)
    return momentum_of_push(robot, force * np.array([np.cos(direction), np.sin(direction)]))[:2]


def imbalance_of_offset(robot: RobotParameters, offset: Vector) -> Vector:
    """Return a of a centre of mass at `offset` [m; body frame], in rad/s^2, shape (3,)."""
    weight = robot.total_mass * GRAVITY / robot.rotor_axial_inertia
    imbalance: Vector = weight * np.asarray(offset, dtype=float)
    return imbalance


def offset_of_imbalance(robot: RobotParameters, imbalance: Vector) -> Vector:
    """Return the centre of mass [m; body frame], shape (3,), of a [rad/s^2]."""
    offset: Vector = imbalance * (robot.rotor_axial_inertia / (robot.total_mass * GRAVITY))
    return offset


def angle_of_slope(robot: RobotParameters, slope: Vector) -> float:
    """Return the inclination [rad] of a slope with torque `slope` over I1, shape (2,)."""
    weight = robot.total_mass * GRAVITY * robot.shell_radius / robot.rotor_axial_inertia
    return float(np.arcsin(min(1.0, float(np.linalg.norm(slope)) / weight)))


def time_to_saturation(
    momentum: Vector, disturbance: Disturbance, quaternion: Vector, max_speed: float
) -> float:
    """Return the time that the sphere can rest with momentum until a rotor is at its limit [s].

    At rest the orientation does not change, so the momentum that the rotors hold grows linearly.
    The time is the least t >= 0 with |(R^T (h + t dh/dt))_i| = `max_speed` [rad/s] for a rotor i:
    0 if a rotor is at its limit or beyond, and inf if none ever reaches it.
    """
    gained = rest_speeds(disturbance.at_rest(quaternion), quaternion)
    times = (
        _time_to_limit(float(speed), float(rate), max_speed)
        for speed, rate in zip(rest_speeds(momentum, quaternion), gained, strict=True)
    )
    return min(times)


def _time_to_limit(speed: float, rate: float, limit: float) -> float:
    """Return the least t >= 0 with |speed + t rate| >= limit."""
    if abs(speed) >= limit:
        return 0.0
    if rate == 0.0:
        return math.inf
    return (math.copysign(limit, rate) - speed) / rate
