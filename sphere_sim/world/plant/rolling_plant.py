# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Ideal plant: rolls without slipping, and its rotors follow their reference exactly.

With the angular momentum H about the contact point and the centre of mass c, in world axes,

    (J + m (1 - e3 e3^T) + Mt Rs (2 c3 1 - c e3^T - e3 c^T)) omega = H - I1 (u1 x + u2 y),
    dH/dt = (Rs e3 + c) x Mt g - v x Mt (omega x c) - friction,

J the inertia about the centre of the sphere, whatever c is, m = Mt Rs^2, x and y the axes of the
rotors. The second term of dH/dt is there as the contact point moves with the velocity v of the
centre. Exact but for the normal force in the friction, which is that at rest.

Written independently of the controller's model on purpose, quaternion algebra included, as a test
compares the two. The inertia about the contact point is the sum of the bodies' inertias (Eqs. 8
to 11), the balance is solved as a 3 x 3 system, and the integrator is the classical Runge-Kutta
method with short steps.

Walls stop the motion and have no forces: a step that would lead into one is not made, so that pose
and momentum stay as before it while the rotors turn on.
"""

import math

import numpy as np
from numpy.typing import ArrayLike

from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.rotation import matrix
from sphere_nmpc.model.state import Vector
from sphere_sim.world.disturbances import DisturbanceSettings
from sphere_sim.world.plant.contract import Plant
from sphere_sim.world.walls import Walls

MAX_STEP = 5e-3
"""Longest Runge-Kutta step [s], times `step_scale`: error of a 0.5 s interval at full speed below
1e-6 for the robot of Table 1."""

_REFERENCE = RobotParameters()
"""Robot of Table 1, for which the constants were measured."""

_Numbers = tuple[float, ...]


class RollingPlant(Plant):
    """Ideal plant; for the arguments see `sphere_sim.world.plant.factory.make_plant`.

    Where friction could stop the shell within the longest integration step, its torque falls in
    proportion to the angular velocity, so that the sphere comes to rest.
    """

    def __init__(
        self, robot: RobotParameters, state: Vector,
        disturbances: DisturbanceSettings | None = None, walls: Walls | None = None,
    ) -> None:
        super().__init__(robot, disturbances, walls)
        self._max_step = MAX_STEP * step_scale(robot)
        self._radius = robot.shell_radius
        self._mass = robot.total_mass
        self._rotor_inertia = robot.rotor_axial_inertia
        self._inertia = _inertia_about_centre(robot)
        self._stopped_in_a_step = self._max_step / min(self._inertia)
        self._offset = self.disturbances.mass_offset
        self._weigh()
        self.reset(state)

    def reset(self, state: Vector) -> None:
        """Put the sphere at rest at `state`, shape (6,)."""
        self._y: _Numbers = (*(float(value) for value in state), 0.0, 0.0, 0.0)
        """Position, quaternion wxyz and momentum H [m, -, N m s]."""
        self._speeds = (0.0, 0.0)
        self._acceleration = (0.0, 0.0)
        self._angles = (0.0, 0.0)
        self._stop_at_walls(self._y)

    def displace(self, state: Vector) -> None:
        """Put the sphere at `state`, shape (6,), keeping its rotors and its momentum."""
        self._y = (*(float(value) for value in state), *self._y[6:])
        self._stop_at_walls(self._y)

    def surround(self, walls: Walls | None) -> None:
        """Replace the walls; None where there are none."""
        super().surround(walls)
        self._stop_at_walls(self._y)

    def push(self, impulse: ArrayLike) -> None:
        """Apply a horizontal impulse [N s; world frame], shape (2,), at the centre."""
        east, north = (float(value) for value in np.asarray(impulse))
        *pose, hx, hy, hz = self._y
        self._y = (*pose, hx - self._radius * north, hy + self._radius * east, hz)

    def tilt(self, slope: float, direction: float) -> None:
        """Change the inclination of the floor and its downhill direction [rad]."""
        super().tilt(slope, direction)
        self._weigh()

    def _weigh(self) -> None:
        """Take over the forces of gravity and friction."""
        self._gravity = self.disturbances.gravity
        normal = -self._mass * self._gravity[2]
        self._rolling = self.disturbances.rolling_friction * normal
        self._spinning = self.disturbances.torsional_friction * normal

    @property
    def state(self) -> Vector:
        """Pose [m, -; world frame, body to world], shape (6,)."""
        return np.array(self._y[:6])

    @property
    def body_rate(self) -> Vector:
        """Angular velocity of the shell [rad/s; body frame], shape (3,)."""
        if self._is_stopped:
            return np.zeros(3)
        rate = np.array(self._world_rate(self._y, *self._speeds))
        found: Vector = matrix(self.state[2:]).T @ rate
        return found

    @property
    def velocity(self) -> Vector:
        """Velocity of the centre [m/s; world frame], shape (3,)."""
        if self._is_stopped:
            return np.zeros(3)
        return np.array([*self.rate(self._y, *self._speeds)[:2], 0.0])

    @property
    def momentum(self) -> Vector:
        """Angular momentum about the contact point [N m s; world frame], shape (3,)."""
        return np.array(self._y[6:])

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
        if not any(self._acceleration) and self._is_equilibrium:
            return np.zeros(2)  # as in `advance`: most rows of a study are at rest
        y, (u1, u2), (a1, a2) = self._y, self._speeds, self._acceleration
        # The balance differentiated once, written out; all that is fixed to the body turns at o.
        o1, o2, o3 = self._world_rate(y, u1, u2)
        h1, h2, h3 = self.rate(y, u1, u2)[6:]
        c1, c2, c3 = self._centre(y)
        (x1, y1, _), (x2, y2, _), (x3, y3, _) = matrix(y[2:6]).tolist()
        inertia, radius, pull = self._rotor_inertia, self._radius, self._mass * self._radius
        t1, t2, t3 = o2 * c3 - o3 * c2, o3 * c1 - o1 * c3, o1 * c2 - o2 * c1
        level, along = radius + 2.0 * c3, c1 * o1 + c2 * o2 + (c3 + radius) * o3
        # The momentum of all bodies about the centre of the sphere, rotors included.
        m1 = y[6] - pull * (level * o1 - c1 * o3)
        m2 = y[7] - pull * (level * o2 - c2 * o3)
        m3 = y[8] - pull * (level * o3 - c3 * o3 - along)
        p1, p2, p3 = self._solved(
            y,
            h1 - inertia * (x1 * a1 + y1 * a2) - (o2 * m3 - o3 * m2)
            - pull * (2.0 * t3 * o1 - t1 * o3),
            h2 - inertia * (x2 * a1 + y2 * a2) - (o3 * m1 - o1 * m3)
            - pull * (2.0 * t3 * o2 - t2 * o3),
            h3 - inertia * (x3 * a1 + y3 * a2) - (o1 * m2 - o2 * m1) - pull * t3 * o3,
        )
        shell = x1 * p1 + x2 * p2 + x3 * p3, y1 * p1 + y2 * p2 + y3 * p3
        return np.array((inertia * (shell[0] + a1), inertia * (shell[1] + a2)))

    @property
    def _is_equilibrium(self) -> bool:
        """Whether rotors and shell are at rest and nothing moves them."""
        return not any(self._speeds) and not any(self.rate(self._y, 0.0, 0.0))

    def advance(self, speeds_end: Vector, duration: float) -> None:
        """Simulate a step of `duration` [s]; the rotor speeds ramp to `speeds_end` [rad/s]."""
        a1, a2 = self._speeds
        b1, b2 = float(speeds_end[0]), float(speeds_end[1])
        half = 0.5 * duration
        self._angles = (self._angles[0] + half * (a1 + b1), self._angles[1] + half * (a2 + b2))
        self._acceleration = ((b1 - a1) / duration, (b2 - a2) / duration)
        self._speeds = (b1, b2)
        if a1 == a2 == 0.0 and self._is_equilibrium:
            return  # which costs no time
        steps = max(1, math.ceil(duration / self._max_step - 1e-9))
        h = duration / steps
        for i in range(steps):
            here, there = i / steps, (i + 1) / steps
            before = self._y
            self._step(
                a1 + (b1 - a1) * here, a2 + (b2 - a2) * here,
                a1 + (b1 - a1) * there, a2 + (b2 - a2) * there, h,
            )
            self._stop_at_walls(before)

    def _step(self, a1: float, a2: float, b1: float, b2: float, h: float) -> None:
        """Make a Runge-Kutta step of h [s] in which the rotor speeds ramp from a to b."""
        m1, m2, half = 0.5 * (a1 + b1), 0.5 * (a2 + b2), 0.5 * h
        y = self._y
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
        self._y = (east, north, w / norm, x / norm, q3 / norm, z / norm, *momentum)

    def _stop_at_walls(self, before: _Numbers) -> None:
        """Return to the pose and momentum before a motion that led into a wall."""
        self._is_stopped = self.contact.is_into_wall(before[:2], self._y[:2])
        if self._is_stopped:
            self._y = before

    def rate(self, y: _Numbers, u1: float, u2: float) -> _Numbers:
        """Return dy/dt of y = [x, y, qw, qx, qy, qz, Hx, Hy, Hz] at rotor speeds [rad/s]."""
        _, _, w, x, q3, z, _, _, _ = y
        o1, o2, o3 = self._world_rate(y, u1, u2)
        v1, v2 = self._radius * o2, -self._radius * o1
        c1, c2, c3 = self._centre(y)
        g1, g2, g3 = self._gravity
        lever, mass = self._radius + c3, self._mass
        t1, t2, t3 = o2 * c3 - o3 * c2, o3 * c1 - o1 * c3, o1 * c2 - o2 * c1
        f1, f2, f3 = self._friction(o1, o2, o3)
        return (
            v1,
            v2,
            0.5 * (-x * o1 - q3 * o2 - z * o3),
            0.5 * (w * o1 + z * o2 - q3 * o3),
            0.5 * (-z * o1 + w * o2 + x * o3),
            0.5 * (q3 * o1 - x * o2 + w * o3),
            mass * (c2 * g3 - lever * g2 - v2 * t3) + f1,
            mass * (lever * g1 - c1 * g3 + v1 * t3) + f2,
            mass * (c1 * g2 - c2 * g1 - v1 * t2 + v2 * t1) + f3,
        )

    def _world_rate(self, y: _Numbers, u1: float, u2: float) -> tuple[float, float, float]:
        """Solve the balance; written out, as most time of a simulation is spent here."""
        _, _, w, x, q3, z, h1, h2, h3 = y
        ww, xx, yy, zz = w * w, x * x, q3 * q3, z * z
        xy, xz, yz, wx, wy, wz = x * q3, x * z, q3 * z, w * x, w * q3, w * z
        s1, s2 = self._rotor_inertia * u1, self._rotor_inertia * u2
        return self._solved(
            y,
            h1 - (ww + xx - yy - zz) * s1 - 2.0 * (xy - wz) * s2,
            h2 - 2.0 * (xy + wz) * s1 - (ww - xx + yy - zz) * s2,
            h3 - 2.0 * (xz - wy) * s1 - 2.0 * (yz + wx) * s2,
        )

    def _solved(
        self, y: _Numbers, p1: float, p2: float, p3: float
    ) -> tuple[float, float, float]:
        """Return the product of the inverse inertia about the contact point with p."""
        _, _, w, x, q3, z, _, _, _ = y
        ww, xx, yy, zz = w * w, x * x, q3 * q3, z * z
        xz, yz, wx, wy = x * z, q3 * z, w * x, w * q3
        # J = j 1 + (j3 - j) z z^T: both rotors and their counterweights are alike.
        z1, z2, z3 = 2.0 * (xz + wy), 2.0 * (yz - wx), ww - xx - yy + zz
        j, _, j3 = self._inertia
        radius = self._radius
        c1, c2, c3 = self._centre(y)
        pull, along = self._mass * radius, j3 - j
        level = j + pull * (radius + 2.0 * c3)
        a1, a2 = along * z1, along * z2
        a11, a22, a33 = level + a1 * z1, level + a2 * z2, j + along * z3 * z3
        a12, a13, a23 = a1 * z2, a1 * z3 - pull * c1, a2 * z3 - pull * c2
        c11, c12, c13 = a22 * a33 - a23 * a23, a13 * a23 - a12 * a33, a12 * a23 - a13 * a22
        c22, c23, c33 = a11 * a33 - a13 * a13, a12 * a13 - a11 * a23, a11 * a22 - a12 * a12
        determinant = a11 * c11 + a12 * c12 + a13 * c13
        return (
            (c11 * p1 + c12 * p2 + c13 * p3) / determinant,
            (c12 * p1 + c22 * p2 + c23 * p3) / determinant,
            (c13 * p1 + c23 * p2 + c33 * p3) / determinant,
        )

    def _centre(self, y: _Numbers) -> tuple[float, float, float]:
        """Return the centre of mass [m; world axes]; the quaternion may have another norm."""
        c1, c2, c3 = self._offset
        if c1 == c2 == c3 == 0.0:
            return self._offset
        _, _, w, x, q3, z, _, _, _ = y
        ww, xx, yy, zz = w * w, x * x, q3 * q3, z * z
        return (
            (ww + xx - yy - zz) * c1 + 2.0 * ((x * q3 - w * z) * c2 + (x * z + w * q3) * c3),
            (ww - xx + yy - zz) * c2 + 2.0 * ((x * q3 + w * z) * c1 + (q3 * z - w * x) * c3),
            (ww - xx - yy + zz) * c3 + 2.0 * ((x * z - w * q3) * c1 + (q3 * z + w * x) * c2),
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
