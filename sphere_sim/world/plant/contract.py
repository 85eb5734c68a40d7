# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Interface of the plants, and the time scale of a robot with which their steps are chosen."""

import math
from typing import Protocol

from numpy.typing import ArrayLike

from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector

_REFERENCE = RobotParameters()
"""Robot of Table 1, for which the constants were measured."""


class Plant(Protocol):
    """Rolling sphere whose rotors follow a speed reference that ramps over each step."""

    @property
    def state(self) -> Vector:
        """[x, y, qw, qx, qy, qz], shape (6,): centre [m; world], orientation body to world."""
        ...

    @property
    def body_rate(self) -> Vector:
        """Angular velocity of the shell [rad/s; body frame], shape (3,)."""
        ...

    @property
    def velocity(self) -> Vector:
        """Velocity of the centre [m/s; world frame], shape (3,)."""
        ...

    @property
    def momentum(self) -> Vector:
        """Angular momentum about the contact point [N m s; world frame], shape (3,)."""
        ...

    @property
    def rotor_angles(self) -> Vector:
        """Angles of the rotors relative to the shell [rad], shape (2,)."""
        ...

    @property
    def rotor_speeds(self) -> Vector:
        """Speeds of the rotors relative to the shell [rad/s], shape (2,)."""
        ...

    @property
    def rotor_torques(self) -> Vector:
        """Motor torques over the last step [N m], shape (2,)."""
        ...

    def reset(self, state: Vector) -> None:
        """Put the sphere at rest at `state`, shape (6,), with rotors at rest and angles zero."""
        ...

    def advance(self, speeds_end: Vector, duration: float) -> None:
        """Simulate a step of `duration` [s].

        Parameters
        ----------
        speeds_end : ndarray, shape (2,)
            Reference of the rotor speeds at the end of the step [rad/s]. It changes linearly from
            that at the end of the previous step (zero after a reset).
        duration : float
            Length of the step [s]; the plant divides it into integration steps.
        """
        ...

    def displace(self, state: Vector) -> None:
        """Put the sphere at `state`, keeping its rotors and its momentum (process noise)."""
        ...

    def push(self, impulse: ArrayLike) -> None:
        """Apply a horizontal impulse [N s; world frame], shape (2,), at the centre."""
        ...

    def tilt(self, slope: float, direction: float) -> None:
        """Change the inclination of the floor and its downhill direction [rad]."""
        ...


def time_scale(robot: RobotParameters) -> float:
    """Return the robot's unit of time, 1 / (c1 u_max), over that of Table 1 [-]."""
    return _fastest_rate(_REFERENCE) / _fastest_rate(robot)


def step_scale(robot: RobotParameters) -> float:
    """Return the factor on steps of integration [-]: the time scale as a power of two, at most 1.

    Rounded, so that errors of the parameters change neither the steps nor, thereby, the rounding
    of results. Slow robots have the steps of Table 1, as gravity acts on all at the same pace.
    """
    return min(1.0, 2.0 ** round(math.log2(time_scale(robot))))


def _fastest_rate(robot: RobotParameters) -> float:
    """Return c1 u_max [rad/s]."""
    return robot.lumped.input_gain * robot.max_rotor_speed
