#!/usr/bin/env python3
# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The controller without ROS, on a plant of one's own.

``python examples/own_plant.py``. The plant rolls without slipping, as in the model; its rotors
lag behind their commands, and its mass is another one than the controller has been told.
"""

import numpy as np

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector, make_state, state_error
from sphere_nmpc.settings import ControllerSettings

START = make_state((2.0, -3.0), (0.6, 0.8, 0.0, 0.0))
GOAL = make_state((0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
"""Position [m] and unit quaternion wxyz, body to world."""
SETTLED = 0.01
"""Error in R^6 below which the sphere has settled."""


class Plant:
    """Rolling sphere whose rotors follow their commands with a lag, integrated by midpoints."""

    def __init__(self, robot: RobotParameters, lag: float, step: float = 2e-3) -> None:
        self.state, self.time = START.copy(), 0.0
        self.speeds: Vector = np.zeros(2)
        self.step, self._share, self._radius = step, step / lag, robot.shell_radius
        transverse, axial = robot.transverse_inertia, robot.axial_inertia
        self._rolling = robot.rolling_inertia
        self._inertia = np.diag([transverse, transverse, axial]) + self._rolling * np.eye(3)
        self._rotor = robot.rotor_axial_inertia

    def advance(self, command: FirstOrderHold | None) -> None:
        """Go one step on, with the rotors on their way to the speeds of a command [rad/s]."""
        wanted = np.zeros(2) if command is None else command.at(self.time)
        self.speeds = self.speeds + self._share * (wanted - self.speeds)
        middle = self.state + 0.5 * self.step * self._rate(self.state)
        self.state = self.state + self.step * self._rate(middle)
        self.state[2:] /= np.linalg.norm(self.state[2:])
        self.time += self.step

    def _rate(self, state: Vector) -> Vector:
        """Return the rate of the state: angular momentum about the contact point stays zero."""
        w, (x, y, z) = state[2], state[3:]
        turn = np.array([
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ])
        vertical = turn[2]  # in the body frame
        inertia = self._inertia - self._rolling * np.outer(vertical, vertical)
        body_rate = np.linalg.solve(inertia, -self._rotor * np.append(self.speeds, 0.0))
        a, b, c = body_rate
        quaternion_rate = 0.5 * np.array([
            -x * a - y * b - z * c, w * a + y * c - z * b, w * b + z * a - x * c,
            w * c + x * b - y * a,
        ])
        world_rate = turn @ body_rate
        velocity = self._radius * np.array([world_rate[1], -world_rate[0]])
        return np.concatenate((velocity, quaternion_rate))


def main() -> None:
    """Roll to the goal and print the error each second."""
    told, true = RobotParameters(), RobotParameters(shell_mass=1.1)
    plant = Plant(true, lag=0.02)
    settings = ControllerSettings()
    controller = Controller(settings, told)
    controller.set_goal(GOAL)
    steps = round(settings.control_period / plant.step)  # between two sampling instants
    command, settled_at = None, 0.0
    for k in range(round(10.0 / plant.step) + 1):
        error = state_error(plant.state, GOAL)
        settled_at = plant.time if error > SETTLED else settled_at
        if k % round(1.0 / plant.step) == 0:
            print(f"{plant.time:4.0f} s   error {error:.4f}")
        if k % steps == 0:
            controller.observe(plant.time, plant.state)
            decision = controller.decide(plant.time)
            # None where there is nothing to send: the command before ends at rest.
            command = controller.commit(decision, plant.time) or command
        plant.advance(command)
    print(f"settled after {settled_at:.2f} s; {decision.mode.value}")
    learnt = controller.estimator.plant
    gains = learnt.constants.input_gain, true.lumped.input_gain, told.lumped.input_gain
    print("learnt: lag {:.0f} ms, c1 {:.5f} (true {:.5f}, told {:.5f})".format(
        1e3 * learnt.lag, *gains
    ))


if __name__ == "__main__":
    main()
