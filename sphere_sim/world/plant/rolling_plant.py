# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Ideal plant: rolls without slipping, and its rotors follow their reference exactly.

Written independently of the controller's model on purpose, quaternion algebra included, as a test
compares the two. The inertia about the contact point is the sum of the bodies' inertias (Eqs. 8
to 11), the momentum balance is solved as a 3 x 3 system, the orientation follows Eqs. (3) and (7),
and the integrator is the classical Runge-Kutta method with short steps. That is without angular
momentum; `sphere_sim.world.plant.momentum_balance` has the equations with it.
"""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector
from sphere_sim.world.disturbances import DisturbanceSettings
from sphere_sim.world.plant.momentum_balance import MomentumBalance

MAX_STEP = 5e-3
"""Longest Runge-Kutta step [s], times `step_scale`: error of a 0.5 s interval at full speed below
1e-6 for the robot of Table 1."""

_REFERENCE = RobotParameters()
"""Robot of Table 1, for which the constants were measured."""

_Numbers = tuple[float, ...]


class RollingPlant:
    """Ideal plant; for the arguments see `sphere_sim.world.plant.factory.make_plant`."""

    def __init__(
        self, robot: RobotParameters, state: Vector,
        disturbances: DisturbanceSettings | None = None,
    ) -> None:
        self._robot = robot
        self._max_step = MAX_STEP * step_scale(robot)
        self._radius = robot.shell_radius
        self._rotor_inertia = robot.rotor_axial_inertia
        self._rolling_inertia = robot.total_mass * robot.shell_radius**2
        self._central_inertia = _inertia_about_centre(robot)
        self._disturb(DisturbanceSettings() if disturbances is None else disturbances)
        self.reset(state)

    def reset(self, state: Vector) -> None:
        """Put the sphere at rest at `state`, shape (6,)."""
        self._y: _Numbers = tuple(float(value) for value in state)
        self._speeds = (0.0, 0.0)
        self._acceleration = (0.0, 0.0)
        self._angles = (0.0, 0.0)
        self._momentum: _Numbers = (0.0, 0.0, 0.0)
        self._has_momentum = self._is_disturbed

    def displace(self, state: Vector) -> None:
        """Put the sphere at `state`, shape (6,), keeping its rotors and its momentum."""
        self._y = tuple(float(value) for value in state)

    def push(self, impulse: ArrayLike) -> None:
        """Apply a horizontal impulse [N s; world frame], shape (2,), at the centre."""
        east, north = (float(value) for value in np.asarray(impulse))
        hx, hy, hz = self._momentum
        self._momentum = (hx - self._radius * north, hy + self._radius * east, hz)
        self._has_momentum = True

    def tilt(self, slope: float, direction: float) -> None:
        """Change the inclination of the floor and its downhill direction [rad]."""
        self._disturb(replace(self._disturbances, slope=slope, slope_direction=direction))
        # Once there may be momentum it may stay on a level floor.
        self._has_momentum = self._has_momentum or self._is_disturbed

    def _disturb(self, disturbances: DisturbanceSettings) -> None:
        self._disturbances = disturbances
        self._balance = MomentumBalance(
            self._robot, self._central_inertia, disturbances, self._max_step
        )
        self._is_disturbed = replace(disturbances, slope_direction=0.0) != DisturbanceSettings()

    @property
    def state(self) -> Vector:
        """State [m, -; world frame, body to world], shape (6,)."""
        return np.array(self._y)

    @property
    def body_rate(self) -> Vector:
        """Angular velocity of the shell [rad/s; body frame], shape (3,)."""
        if self._has_momentum:
            return np.array(self._balance.body_rate((*self._y, *self._momentum), *self._speeds))
        return np.array(self._body_rate(self._y, self._speeds[0], self._speeds[1]))

    @property
    def velocity(self) -> Vector:
        """Velocity of the centre [m/s; world frame], shape (3,)."""
        if self._has_momentum:
            rate = self._balance.rate((*self._y, *self._momentum), *self._speeds)
        else:
            rate = self._rate(self._y, self._speeds[0], self._speeds[1])
        return np.array([rate[0], rate[1], 0.0])

    @property
    def momentum(self) -> Vector:
        """Angular momentum about the contact point [N m s; world frame], shape (3,)."""
        return np.array(self._momentum)

    @property
    def rotor_angles(self) -> Vector:
        """Angles of the rotors [rad], shape (2,)."""
        return np.array(self._angles)

    @property
    def rotor_speeds(self) -> Vector:
        """Speeds of the rotors relative to the shell [rad/s], shape (2,)."""
        return np.array(self._speeds)

    @property
    def rotor_torques(self) -> Vector:
        """Motor torques over the last step [N m], shape (2,) (Eq. 45)."""
        if self._has_momentum:
            y = (*self._y, *self._momentum)
            shell = self._balance.angular_acceleration(y, self._speeds, self._acceleration)
            torques: Vector = self._rotor_inertia * (shell[:2] + self._acceleration)
            return torques
        # The momentum balance differentiated once: the vertical turns in the body at k x omega.
        k1, k2, k3 = self._vertical(self._y)
        w1, w2, w3 = self._body_rate(self._y, *self._speeds)
        a1, a2 = self._acceleration
        gain = self._rolling_inertia * (k1 * w1 + k2 * w2 + k3 * w3)
        inertia = self._rotor_inertia
        g1 = gain * (k2 * w3 - k3 * w2) - inertia * a1
        g2 = gain * (k3 * w1 - k1 * w3) - inertia * a2
        g3 = gain * (k1 * w2 - k2 * w1)
        c11, c12, c13, c22, c23, determinant = self._inverse(self._y)
        shell1 = (c11 * g1 + c12 * g2 + c13 * g3) / determinant
        shell2 = (c12 * g1 + c22 * g2 + c23 * g3) / determinant
        return np.array([inertia * (shell1 + a1), inertia * (shell2 + a2)])

    def advance(self, speeds_end: Vector, duration: float) -> None:
        """Simulate a step of `duration` [s]; the rotor speeds ramp to `speeds_end` [rad/s]."""
        a1, a2 = self._speeds
        b1, b2 = float(speeds_end[0]), float(speeds_end[1])
        half = 0.5 * duration
        self._angles = (self._angles[0] + half * (a1 + b1), self._angles[1] + half * (a2 + b2))
        self._acceleration = ((b1 - a1) / duration, (b2 - a2) / duration)
        self._speeds = (b1, b2)
        has_momentum = self._has_momentum
        if not has_momentum and a1 == a2 == b1 == b2 == 0.0:
            return  # without inputs and momentum the ideal sphere is at rest
        steps = max(1, math.ceil(duration / self._max_step - 1e-9))
        h = duration / steps
        step = self._balance.step if has_momentum else self._step
        y = (*self._y, *self._momentum) if has_momentum else self._y
        for i in range(steps):
            here, there = i / steps, (i + 1) / steps
            y = step(
                y, a1 + (b1 - a1) * here, a2 + (b2 - a2) * here,
                a1 + (b1 - a1) * there, a2 + (b2 - a2) * there, h,
            )
        self._y = y[:6]
        if has_momentum:
            self._momentum = y[6:]

    def _step(
        self, y: _Numbers, a1: float, a2: float, b1: float, b2: float, h: float
    ) -> _Numbers:
        """Make a Runge-Kutta step; written out, as most time of a simulation is spent here.

        The rotor speeds ramp from a to b; only the quaternion enters the rates.
        """
        m1, m2 = 0.5 * (a1 + b1), 0.5 * (a2 + b2)
        half, sixth = 0.5 * h, h / 6.0
        px, py, w, x, q3, z = y
        k = self._rate(y, a1, a2)
        at = (px, py, w + half * k[2], x + half * k[3], q3 + half * k[4], z + half * k[5])
        n = self._rate(at, m1, m2)
        at = (px, py, w + half * n[2], x + half * n[3], q3 + half * n[4], z + half * n[5])
        o = self._rate(at, m1, m2)
        at = (px, py, w + h * o[2], x + h * o[3], q3 + h * o[4], z + h * o[5])
        p = self._rate(at, b1, b2)
        w += sixth * (k[2] + 2.0 * n[2] + 2.0 * o[2] + p[2])
        x += sixth * (k[3] + 2.0 * n[3] + 2.0 * o[3] + p[3])
        q3 += sixth * (k[4] + 2.0 * n[4] + 2.0 * o[4] + p[4])
        z += sixth * (k[5] + 2.0 * n[5] + 2.0 * o[5] + p[5])
        norm = math.sqrt(w**2 + x**2 + q3**2 + z**2)
        return (
            px + sixth * (k[0] + 2.0 * n[0] + 2.0 * o[0] + p[0]),
            py + sixth * (k[1] + 2.0 * n[1] + 2.0 * o[1] + p[1]),
            w / norm, x / norm, q3 / norm, z / norm,
        )

    def _rate(self, y: _Numbers, u1: float, u2: float) -> _Numbers:
        """Return the time derivative of the state."""
        _, _, w, x, q3, z = y
        b1, b2, b3 = self._body_rate(y, u1, u2)
        dw = 0.5 * (-x * b1 - q3 * b2 - z * b3)
        dx = 0.5 * (w * b1 - z * b2 + q3 * b3)
        dy = 0.5 * (z * b1 + w * b2 - x * b3)
        dz = 0.5 * (-q3 * b1 + x * b2 + w * b3)
        # Eq. (7): the contact point has no velocity.
        east = 2.0 * self._radius * (-q3 * dw + z * dx + w * dy - x * dz)
        north = 2.0 * self._radius * (x * dw - w * dx + z * dy - q3 * dz)
        return (east, north, dw, dx, dy, dz)

    def _body_rate(self, y: _Numbers, u1: float, u2: float) -> tuple[float, float, float]:
        """Solve the momentum balance about the contact point for the shell's rate (Eq. 11)."""
        c11, c12, c13, c22, c23, determinant = self._inverse(y)
        h1, h2 = -self._rotor_inertia * u1, -self._rotor_inertia * u2
        return (
            (c11 * h1 + c12 * h2) / determinant, (c12 * h1 + c22 * h2) / determinant,
            (c13 * h1 + c23 * h2) / determinant,
        )

    def _vertical(self, y: _Numbers) -> tuple[float, float, float]:
        """Return the world's vertical k in the body frame."""
        _, _, w, x, q3, z = y
        return 2.0 * (x * z - w * q3), 2.0 * (q3 * z + w * x), w * w - x * x - q3 * q3 + z * z

    def _inverse(self, y: _Numbers) -> _Numbers:
        """Return cofactors 11, 12, 13, 22, 23 and determinant of the inertia about the contact."""
        k1, k2, k3 = self._vertical(y)
        j1, j2, j3 = self._central_inertia
        m = self._rolling_inertia
        # Rolling adds m (1 - k k^T): the centre moves with k x omega.
        a11, a22, a33 = j1 + m * (1 - k1 * k1), j2 + m * (1 - k2 * k2), j3 + m * (1 - k3 * k3)
        a12, a13, a23 = -m * k1 * k2, -m * k1 * k3, -m * k2 * k3
        c11, c12, c13 = a22 * a33 - a23 * a23, a13 * a23 - a12 * a33, a12 * a23 - a13 * a22
        c22, c23 = a11 * a33 - a13 * a13, a12 * a13 - a11 * a23
        return c11, c12, c13, c22, c23, a11 * c11 + a12 * c12 + a13 * c13


def _inertia_about_centre(robot: RobotParameters) -> tuple[float, float, float]:
    """Add up the principal inertias of all bodies about the centre [kg m^2] (Eq. 8).

    Rotor 1 and its counterweight sit at +d and -d on the body's x axis with their axis of
    symmetry along it, rotor 2 and its counterweight likewise on the y axis.
    """
    total = np.full(3, robot.shell_inertia)
    bodies = (
        (robot.rotor_mass, robot.rotor_axial_inertia, robot.rotor_transverse_inertia),
        (
            robot.counterweight_mass, robot.counterweight_axial_inertia,
            robot.counterweight_transverse_inertia,
        ),
    )
    for mass, axial, transverse in bodies:
        for axis in range(2):
            own = np.full(3, transverse + mass * robot.rotor_offset**2)
            own[axis] = axial
            total += own
    return float(total[0]), float(total[1]), float(total[2])


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
