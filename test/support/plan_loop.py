# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Closed loop of a strategy alone: exact states, and plans followed for a sample period."""

import numpy as np

from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector, state_error
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.solver.roll_out import roll_out
from sphere_nmpc.strategy.contract import Situation, make_strategy

_PIECES = 8
"""Instants of a sample period at which the error is evaluated."""


def settling_time(
    name: str, start: Vector, goal: Vector, duration: float,
    robot: RobotParameters | None = None, tolerance: float = 1e-2,
) -> float:
    """Return the time from which the error stays below `tolerance` [s]; inf where it does not.

    Parameters
    ----------
    name : str
        Name of the strategy, which has its own sample period.
    start, goal : ndarray, shape (6,)
        States at rest.
    duration : float
        Length of the run [s].
    robot : RobotParameters, optional
        By default that of Table 1.
    tolerance : float, optional
        Error [mixed units].
    """
    robot = robot or RobotParameters()
    settings = ControllerSettings(strategy=name).of(robot)
    strategy, period = make_strategy(settings, robot), settings.period
    constants, shares = robot.lumped, np.linspace(0.0, 1.0, _PIECES + 1)
    state, speeds, settled = start, np.zeros(2), 0.0
    for k in range(int(np.ceil(duration / period))):
        now = k * period
        plan = strategy.plan(Situation(now, state, goal, speeds, constants))
        hold = plan.hold.limited(robot.max_rotor_speed, robot.max_rotor_acceleration)
        knots = np.array([hold.at(now + share * period) for share in shares])
        states = roll_out(
            state, knots, np.full(_PIECES, period / _PIECES), constants.as_array(),
            settings.longest_step,
        )
        for share, here in zip(shares[1:], states[1:], strict=True):
            if not state_error(here, goal) < tolerance:
                settled = now + share * period
        state, speeds = states[-1], knots[-1]
    return settled if settled < now + period else float("inf")
