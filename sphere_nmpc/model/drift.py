# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Drift of the model: angular momentum about the contact point and the torques that change it.

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
"""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from sphere_nmpc.model import rotation
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.rotation import Vector

GRAVITY = 9.81
"""Acceleration of free fall g [m/s^2]."""

MOMENTUM = slice(0, 3)
SLOPE = slice(3, 5)
IMBALANCE = slice(5, 8)
DRIFT_SIZE = 8
"""Layout of a drift as an array."""


def _zeros(size: int) -> Vector:
    zeros: Vector = np.zeros(size)
    zeros.flags.writeable = False
    return zeros


@dataclass(frozen=True, eq=False)
class Drift:
    """Momentum at an instant, and the torques that change it.

    Attributes
    ----------
    momentum : ndarray, shape (3,)
        h [rad/s; world frame].
    slope : ndarray, shape (2,)
        s, the torque of a slope over I1 [rad/s^2; world frame].
    imbalance : ndarray, shape (3,)
        a = Mt g c / I1 of a centre of mass at c [rad/s^2; body frame].
    """

    momentum: Vector = field(default_factory=lambda: _zeros(3))
    slope: Vector = field(default_factory=lambda: _zeros(2))
    imbalance: Vector = field(default_factory=lambda: _zeros(3))

    @classmethod
    def from_array(cls, values: Vector) -> "Drift":
        """Return the drift of an array laid out [h, s, a], shape (8,)."""
        return cls(values[MOMENTUM].copy(), values[SLOPE].copy(), values[IMBALANCE].copy())

    def as_array(self) -> Vector:
        """Return [h, s, a], shape (8,)."""
        return np.concatenate((self.momentum, self.slope, self.imbalance))

    @property
    def is_zero(self) -> bool:
        """Whether the model is the paper's: no momentum, level and balanced."""
        # The identity first: this is asked several times a solve.
        if self is NO_DRIFT:
            return True
        return not (self.momentum.any() or self.slope.any() or self.imbalance.any())

    def torque_at_rest(self, quaternion: Vector) -> Vector:
        """Return dh/dt of a sphere that rests at an orientation (4,) [rad/s^2; world], (3,)."""
        world = rotation.matrix(quaternion) @ self.imbalance
        return np.array([self.slope[0] - world[1], self.slope[1] + world[0], 0.0])

    def in_body(self, quaternion: Vector) -> Vector:
        """Return the momentum in the body frame at an orientation (4,) [rad/s], shape (3,)."""
        if self is NO_DRIFT:
            return np.zeros(3)
        turned: Vector = rotation.matrix(quaternion).T @ self.momentum
        return turned

    def rest_speeds(self, quaternion: Vector) -> Vector:
        """Return the rotor speeds that hold the momentum at an orientation [rad/s], shape (2,).

        With them the sphere rests if the component of the momentum along the body's z axis is
        zero; otherwise it turns slowly about that axis.
        """
        return self.in_body(quaternion)[:2]

    def after_slope(self, duration: float) -> "Drift":
        """Return the drift after `duration` [s] of the slope's torque alone."""
        if self is NO_DRIFT:
            return self
        gained = duration * np.append(self.slope, 0.0)
        return replace(self, momentum=self.momentum + gained)

    def after_rest(self, quaternion: Vector, duration: float) -> "Drift":
        """Return the drift after a rest of `duration` [s] at an orientation, shape (4,)."""
        gained = duration * self.torque_at_rest(quaternion)
        return replace(self, momentum=self.momentum + gained)


NO_DRIFT = Drift()
"""Drift of the paper's model."""


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


def time_to_saturation(drift: Drift, quaternion: Vector, max_speed: float) -> float:
    """Return the time that the sphere can rest with momentum until a rotor is at its limit [s].

    At rest the orientation does not change, so the momentum that the rotors hold grows linearly.
    The time is the least t >= 0 with |(R^T (h + t dh/dt))_i| = `max_speed` for a rotor i.

    It is 0 if a rotor is at its limit or beyond, and inf if none ever reaches it. `drift` is that
    at present, `quaternion`, shape (4,), the orientation, `max_speed` in rad/s.
    """
    gained = rotation.matrix(quaternion).T @ drift.torque_at_rest(quaternion)
    times = (
        _time_to_limit(float(speed), float(rate), max_speed)
        for speed, rate in zip(drift.rest_speeds(quaternion), gained[:2], strict=True)
    )
    return min(times)


def _time_to_limit(speed: float, rate: float, limit: float) -> float:
    """Return the least t >= 0 with |speed + t rate| >= limit."""
    if abs(speed) >= limit:
        return 0.0
    if rate == 0.0:
        return math.inf
    return (math.copysign(limit, rate) - speed) / rate
