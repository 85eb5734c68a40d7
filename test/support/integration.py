# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Integration of the paper's model by its CasADi step, as a reference for compiled code."""

import numpy as np

from sphere_nmpc.model.integrator import step_function, steps_for
from sphere_nmpc.model.state import Vector
from sphere_nmpc.model.units import DEFAULT_MAX_STEP


def integrate(
    state: Vector,
    u_start: Vector,
    u_end: Vector,
    duration: float,
    constants: Vector,
    max_step: float = DEFAULT_MAX_STEP,
) -> Vector:
    """Return the pose after one interval of a first-order hold (Eq. 20 with Eq. 21).

    From a pose, shape (6,), with the rotor speeds at both ends [rad/s], shape (2,), over
    `duration` [s] in steps of `max_step` [s] at most; `constants` are [Rs, c1, r1, r3].
    """
    steps = steps_for(duration, max_step)
    step, h = step_function(), duration / steps
    x: Vector = state
    for i in range(steps):
        here, there = (u_start + (u_end - u_start) * (k / steps) for k in (i, i + 1))
        x = np.array(step(x, here, there, h, constants)).ravel()
    return x
