# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Situations of a sphere that a strategy is asked for a plan in."""

from typing import Any

import numpy as np

from sphere_nmpc.model.disturbance import UNDISTURBED, Disturbance
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import NO_MOMENTUM, Vector
from sphere_nmpc.strategy.contract import Situation


def situation(
    goal: Any, momentum: Vector = NO_MOMENTUM, disturbance: Disturbance = UNDISTURBED,
    pose: Vector | None = None, in_force: tuple[float, float] = (0.0, 0.0),
) -> Situation:
    """Return the one at a goal's pose, or at another, with rotor speeds in force [rad/s]."""
    state = np.append(goal if pose is None else pose, momentum)
    constants = RobotParameters().lumped
    return Situation.of(
        0.0, state, goal, np.array(in_force), constants, disturbance=disturbance
    )
