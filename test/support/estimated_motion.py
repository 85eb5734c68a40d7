# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Rotor speeds that excite the motion of the sphere, and the motion that they cause."""

import numpy as np

from sphere_nmpc.estimation.sent_inputs import SentInputs
from sphere_nmpc.model.disturbance import UNDISTURBED, Disturbance
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector, as_state
from sphere_nmpc.solver.roll_out import roll_out

LUMPED = RobotParameters().lumped
START = as_state([0.3, -0.2, 0.5, 0.5, 0.5, 0.5])


def random_ramps(rng: np.random.Generator, until: float, largest: float = 100.0) -> SentInputs:
    """Return ramps of 0.5 s between random speeds up to `largest` [rad/s], from rest at 0 s."""
    times = np.arange(0.0, until, 0.5)
    speeds = rng.uniform(-largest, largest, (times.size, 2))
    speeds[0] = 0.0
    sent = SentInputs()
    sent.record(FirstOrderHold(times, speeds))
    return sent


def predicted(
    sent: SentInputs,
    state: Vector,
    start: float,
    end: float,
    constants: Vector,
    disturbance: Disturbance = UNDISTURBED,
) -> Vector:
    """Return the state, (9,), at `end` [s] from that at `start` by the speeds sent."""
    if end <= start:
        return state
    durations, speeds = sent.pieces(start, end)
    return roll_out(state, speeds, durations, constants, 0.02, disturbance)[-1].copy()
