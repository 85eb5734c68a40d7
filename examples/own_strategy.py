#!/usr/bin/env python3
# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""A strategy of one's own: a receding horizon by SciPy that rolls to a position.

``python examples/own_strategy.py`` runs it in the closed loop without ROS. An installed package
brings it to nodes, launch file and commands by an entry point, as `setup.py` beside this file
does.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from sphere_nmpc import (
    Controller,
    ControllerSettings,
    FirstOrderHold,
    Goal,
    Plan,
    RobotParameters,
    Situation,
    roll_out,
)
from sphere_sim import Simulator, run_closed_loop

Vector = NDArray[np.float64]
POSITION = slice(0, 2)
"""Of a state x, y [m], quaternion wxyz [-], momentum [rad/s]."""
KNOTS = 8
"""Rotor speeds that are planned ahead, a sample period apart."""
TERMINAL_WEIGHT, INPUT_WEIGHT = 10.0, 0.1
"""Weights of the last position and of the speeds, over their limit; other positions have 1."""
EVALUATIONS = 15
"""Cap on the iterations of a sample."""


class RollTo:
    """Strategy that rolls to the position of the goal; the orientation is what results.

    The methods are those of `sphere_nmpc.strategy.contract.Strategy`.
    """

    def __init__(self, settings: ControllerSettings, robot: RobotParameters) -> None:
        self._limit = robot.max_rotor_speed
        self.change(settings)
        self.reset()

    def change(self, settings: ControllerSettings) -> None:
        """Use other settings from the next plan on."""
        self._period = settings.period

    def reset(self) -> None:
        """Forget the last plan."""
        self._last: FirstOrderHold | None = None

    def plan(self, situation: Situation) -> Plan:
        """Return the plan from `situation.time` on, with the last one as a warm start."""
        durations = np.full(KNOTS, self._period)
        times: Vector = situation.time + np.append(0.0, np.cumsum(durations))
        constants = situation.constants  # as estimated

        def speeds(scaled: Vector) -> Vector:
            planned = self._limit * scaled.reshape(KNOTS, 2)
            return np.vstack((situation.speeds, planned))

        def states(scaled: Vector) -> Vector:
            return roll_out(situation.state, speeds(scaled), durations, constants.as_array())

        def residuals(scaled: Vector) -> Vector:
            away = states(scaled)[1:, POSITION] - situation.goal.pose[POSITION]
            away[-1] *= TERMINAL_WEIGHT
            return np.append(away / constants.shell_radius, INPUT_WEIGHT * scaled)

        guess: Vector = np.full(2 * KNOTS, 0.1)
        if self._last is not None:
            guess = np.concatenate([self._last.at(t) for t in times[1:]]) / self._limit
        inside = np.clip(guess, -0.999, 0.999)
        found = least_squares(residuals, inside, bounds=(-1.0, 1.0), max_nfev=EVALUATIONS)
        self._last = FirstOrderHold(times, speeds(found.x))
        # The loop limits the accelerations, ends the plan at rest, and certifies it on a map.
        return Plan.found(self._last, states(found.x), found.success, cost=found.cost)


def main() -> None:
    """Run the paper's first case to its position, and print how it went."""
    settings, robot = ControllerSettings(), RobotParameters()
    for name, strategy in (("roll_to", RollTo(settings, robot)), ("time_optimal", None)):
        controller = Controller(settings, robot, strategy)
        run = run_closed_loop(Simulator(), controller, Goal.position(0.0, 0.0), 10.0)
        print(f"{name:12}  within 1 cm after {run.settled_after:.2f} s, "
              f"{run.errors[-1]:.0e} m off at the end")


if __name__ == "__main__":
    main()
