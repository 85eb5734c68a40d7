# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Eqs. (7) and (12) of the paper, as printed or with the corrected sign in the third line.

Written out from the page, term by term, so that it is the paper that is judged and not a
rearrangement of it. Nothing in the package uses this module.
"""

import numpy as np

from sphere_nmpc.model.parameters import RobotParameters

MAX_STEP = 5e-3
"""Longest Runge-Kutta step [s]."""


class PrintedModel:
    """Integrate Eq. (14), Q(x) dx/dt = [0 0 u1 0 ... u2], for rotor speeds that ramp linearly.

    `corrected` says whether the first term of the third line of Eq. (12) gets a negative sign.
    """

    def __init__(self, robot: RobotParameters, state: np.ndarray, corrected: bool) -> None:
        self._robot = robot
        self._sign = -1.0 if corrected else 1.0
        self._speeds: np.ndarray = np.zeros(2)
        self.state = np.array(state, dtype=float)

    def advance(self, speeds_end: np.ndarray, duration: float) -> None:
        """Integrate over `duration` [s] while the rotor speeds ramp to `speeds_end` [rad/s]."""
        steps = max(1, int(np.ceil(duration / MAX_STEP - 1e-9)))
        h = duration / steps
        slope = (speeds_end - self._speeds) / duration
        for i in range(steps):
            here = self._speeds + slope * (i * h)
            middle, there = here + 0.5 * h * slope, here + h * slope
            x = self.state
            k1 = self.rate(x, here)
            k2 = self.rate(x + 0.5 * h * k1, middle)
            k3 = self.rate(x + 0.5 * h * k2, middle)
            k4 = self.rate(x + h * k3, there)
            x = x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
            x[2:] /= np.linalg.norm(x[2:])
            self.state = x
        self._speeds = np.array(speeds_end, dtype=float)

    def rate(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Return dx/dt, shape (6,)."""
        robot = self._robot
        q1, q2, q3, q4 = x[2:]
        it1, it2 = robot.transverse_inertia, robot.axial_inertia
        linear = robot.total_mass * robot.shell_radius
        s, r = self._sign, robot.shell_radius
        # Unknowns: dx, dy, dq1, dq2, dq3, dq4.
        q = np.zeros((6, 6))
        q[0] = [
            2 * linear * (q1 * q4 + q2 * q3), linear * (q3**2 + q4**2 - q1**2 - q2**2),
            -2 * it1 * q2, 2 * it1 * q1, 2 * it1 * q4, -2 * it1 * q3,
        ]  # fmt: skip
        q[1] = [
            linear * (q1**2 + q3**2 - q2**2 - q4**2), 2 * linear * (q1 * q4 - q2 * q3),
            -2 * it1 * q3, -2 * it1 * q4, 2 * it1 * q1, 2 * it1 * q2,
        ]  # fmt: skip
        q[2] = [
            s * linear * (q1 * q2 - q3 * q4), s * linear * (q1 * q3 + q2 * q4),
            -it2 * q4, it2 * q3, -it2 * q2, it2 * q1,
        ]  # fmt: skip
        q[3] = [0, 0, q1, q2, q3, q4]
        q[4] = [1, 0, 2 * r * q3, -2 * r * q4, -2 * r * q1, 2 * r * q2]
        q[5] = [0, 1, -2 * r * q2, 2 * r * q1, -2 * r * q4, 2 * r * q3]
        right = np.zeros(6)
        right[:2] = -robot.rotor_axial_inertia * u
        return np.linalg.solve(q, right)
