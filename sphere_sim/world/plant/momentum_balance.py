# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Motion of the ideal sphere with angular momentum about the contact point.

With the momentum H, the centre of mass c (body frame) and the vertical k in body axes,

    (J + m (1 - k k^T) + Mt Rs (2 (k.c) 1 - c k^T - k c^T)) omega = R^T H - I1 [u1, u2, 0],
    dH/dt = (Rs e3 + R c) x Mt g - v x Mt (omega x R c) - friction,

J the inertia about the centre of the sphere, whatever c is, and m = Mt Rs^2. The second term of
dH/dt is there as the contact point moves with the velocity v of the centre. Exact but for the
normal force in the friction, which is that at rest.
"""

import math

import numpy as np

from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector
from sphere_sim.world.disturbances import DisturbanceSettings

Numbers = tuple[float, ...]


class MomentumBalance:
    """Equations of motion of state and momentum, y = [x, y, qw, qx, qy, qz, Hx, Hy, Hz].

    `inertia` are the principal inertias about the centre of the sphere [kg m^2; body frame]. Where
    friction could stop the shell within the longest integration step `max_step` [s], its torque
    falls in proportion to the angular velocity, so that the sphere comes to rest.
    """

    def __init__(
        self,
        robot: RobotParameters,
        inertia: tuple[float, float, float],
        settings: DisturbanceSettings,
        max_step: float,
    ) -> None:
        self._mass = robot.total_mass
        self._radius = robot.shell_radius
        self._rotor_inertia = robot.rotor_axial_inertia
        self._inertia = inertia
        self._offset = settings.mass_offset
        self._gravity = settings.gravity
        normal = -self._mass * self._gravity[2]
        self._rolling = settings.rolling_friction * normal
        self._spinning = settings.torsional_friction * normal
        self._stopped_in_a_step = max_step / min(inertia)

    def body_rate(self, y: Numbers, u1: float, u2: float) -> tuple[float, float, float]:
        """Return the angular velocity of the shell [rad/s; body frame]."""
        return self._body_rate(_axes(y), y, u1, u2)

    def step(
        self, y: Numbers, a1: float, a2: float, b1: float, b2: float, h: float
    ) -> Numbers:
        """Make a Runge-Kutta step of h [s] in which the rotor speeds ramp from a to b."""
        m1, m2, half = 0.5 * (a1 + b1), 0.5 * (a2 + b2), 0.5 * h
        k = self.rate(y, a1, a2)
        n = self.rate(tuple([s + half * d for s, d in zip(y, k, strict=True)]), m1, m2)
        o = self.rate(tuple([s + half * d for s, d in zip(y, n, strict=True)]), m1, m2)
        p = self.rate(tuple([s + h * d for s, d in zip(y, o, strict=True)]), b1, b2)
        sixth = h / 6.0
        east, north, w, x, q3, z, *momentum = [
            s + sixth * (first + 2.0 * second + 2.0 * third + last)
            for s, first, second, third, last in zip(y, k, n, o, p, strict=True)
        ]
        norm = math.sqrt(w**2 + x**2 + q3**2 + z**2)
        return (east, north, w / norm, x / norm, q3 / norm, z / norm, *momentum)

    def rate(self, y: Numbers, u1: float, u2: float) -> Numbers:
        """Return dy/dt, written out, as most time of a simulation is spent here."""
        _, _, w, x, q3, z, _, _, _ = y
        axes = _axes(y)
        b1, b2, b3 = self._body_rate(axes, y, u1, u2)
        o1, o2, o3 = _turned(axes, b1, b2, b3)
        v1, v2 = self._radius * o2, -self._radius * o1
        c1, c2, c3 = _turned(axes, *self._offset)
        g1, g2, g3 = self._gravity
        lever = self._radius + c3
        t1, t2, t3 = o2 * c3 - o3 * c2, o3 * c1 - o1 * c3, o1 * c2 - o2 * c1
        f1, f2, f3 = self._friction(o1, o2, o3)
        return (
            v1,
            v2,
            0.5 * (-x * b1 - q3 * b2 - z * b3),
            0.5 * (w * b1 - z * b2 + q3 * b3),
            0.5 * (z * b1 + w * b2 - x * b3),
            0.5 * (-q3 * b1 + x * b2 + w * b3),
            self._mass * (c2 * g3 - lever * g2 - v2 * t3) + f1,
            self._mass * (lever * g1 - c1 * g3 + v1 * t3) + f2,
            self._mass * (c1 * g2 - c2 * g1 - v1 * t2 + v2 * t1) + f3,
        )

    def angular_acceleration(
        self, y: Numbers, speeds: Numbers, accelerations: Numbers
    ) -> Vector:
        """Return the derivative of `body_rate` [rad/s^2; body frame], shape (3,).

        `speeds` and `accelerations` are those of the rotors [rad/s, rad/s^2].
        """
        axes = _axes(y)
        turn = np.array(axes).reshape(3, 3)
        rate = np.array(self._body_rate(axes, y, *speeds))
        k, c = turn[2], np.array(self._offset)
        momentum, change = np.array(y[6:]), np.array(self.rate(y, *speeds)[6:])
        # The balance differentiated once: k and R^T H turn in the body at k x omega.
        k_rate = np.cross(k, rate)
        pull = self._mass * self._radius
        inertia_rate = pull * (
            -self._radius * k_rate * (k @ rate) + 2.0 * (k_rate @ c) * rate - k_rate * (c @ rate)
        )
        spin = self._rotor_inertia * np.array([*accelerations, 0.0])
        torque = turn.T @ change + np.cross(turn.T @ momentum, rate) - spin - inertia_rate
        inertia = np.diag(self._inertia) + pull * (
            self._radius * (np.eye(3) - np.outer(k, k))
            + 2.0 * (k @ c) * np.eye(3) - np.outer(c, k) - np.outer(k, c)
        )
        found: Vector = np.linalg.solve(inertia, torque)
        return found

    def _body_rate(
        self, axes: Numbers, y: Numbers, u1: float, u2: float
    ) -> tuple[float, float, float]:
        """Solve the momentum balance about the contact point for the shell's rate."""
        r11, r12, r13, r21, r22, r23, k1, k2, k3 = axes
        _, _, _, _, _, _, h1, h2, h3 = y
        p1 = r11 * h1 + r21 * h2 + k1 * h3 - self._rotor_inertia * u1
        p2 = r12 * h1 + r22 * h2 + k2 * h3 - self._rotor_inertia * u2
        p3 = r13 * h1 + r23 * h2 + k3 * h3
        j1, j2, j3 = self._inertia
        c1, c2, c3 = self._offset
        pull = self._mass * self._radius
        m = pull * self._radius
        shared = 2.0 * pull * (k1 * c1 + k2 * c2 + k3 * c3)
        a11 = j1 + m * (1.0 - k1 * k1) + shared - 2.0 * pull * k1 * c1
        a22 = j2 + m * (1.0 - k2 * k2) + shared - 2.0 * pull * k2 * c2
        a33 = j3 + m * (1.0 - k3 * k3) + shared - 2.0 * pull * k3 * c3
        a12 = -m * k1 * k2 - pull * (k1 * c2 + k2 * c1)
        a13 = -m * k1 * k3 - pull * (k1 * c3 + k3 * c1)
        a23 = -m * k2 * k3 - pull * (k2 * c3 + k3 * c2)
        c11, c12, c13 = a22 * a33 - a23 * a23, a13 * a23 - a12 * a33, a12 * a23 - a13 * a22
        c22, c23, c33 = a11 * a33 - a13 * a13, a12 * a13 - a11 * a23, a11 * a22 - a12 * a12
        determinant = a11 * c11 + a12 * c12 + a13 * c13
        return (
            (c11 * p1 + c12 * p2 + c13 * p3) / determinant,
            (c12 * p1 + c22 * p2 + c23 * p3) / determinant,
            (c13 * p1 + c23 * p2 + c33 * p3) / determinant,
        )

    def _friction(self, o1: float, o2: float, o3: float) -> tuple[float, float, float]:
        """Return the torque of rolling and torsional friction [N m; world frame]."""
        f1 = f2 = f3 = 0.0
        if self._rolling > 0.0:
            slowest = self._rolling * self._stopped_in_a_step
            viscous = self._rolling / max(math.hypot(o1, o2), slowest)
            f1, f2 = -viscous * o1, -viscous * o2
        if self._spinning > 0.0:
            slowest = self._spinning * self._stopped_in_a_step
            f3 = -self._spinning / max(abs(o3), slowest) * o3
        return f1, f2, f3


def _axes(y: Numbers) -> Numbers:
    """Return the matrix from body to world, row by row; the quaternion may have another norm."""
    _, _, w, x, q3, z, _, _, _ = y
    ww, xx, yy, zz = w * w, x * x, q3 * q3, z * z
    return (
        ww + xx - yy - zz, 2.0 * (x * q3 - w * z), 2.0 * (x * z + w * q3),
        2.0 * (x * q3 + w * z), ww - xx + yy - zz, 2.0 * (q3 * z - w * x),
        2.0 * (x * z - w * q3), 2.0 * (q3 * z + w * x), ww - xx - yy + zz,
    )  # fmt: skip


def _turned(axes: Numbers, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return a body vector in world axes."""
    r11, r12, r13, r21, r22, r23, r31, r32, r33 = axes
    return (
        r11 * x + r12 * y + r13 * z,
        r21 * x + r22 * y + r23 * z,
        r31 * x + r32 * y + r33 * z,
    )
