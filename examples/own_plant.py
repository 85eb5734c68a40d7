#!/usr/bin/env python3
# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""A plant of one's own, and the controller on it without ROS.

``python examples/own_plant.py``. The plant rolls without slipping, as in the model; its rotors
lag behind their commands, and its mass is another one than the controller has been told. An
installed package brings it to the simulator node, launch file and studies by an entry point, as
`setup.py` beside this file does.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from sphere_nmpc import Controller, Goal, RobotParameters, quantity
from sphere_sim import Plant, PlantSettings, Simulator, run_closed_loop

Vector = NDArray[np.float64]
START = np.array((2.0, -3.0, 0.6, 0.8, 0.0, 0.0))
"""Position [m] and unit quaternion wxyz, body to world."""
STEP = 2e-3
"""Longest step of the integration [s]."""


@dataclass(frozen=True)
class LaggingSettings(PlantSettings):
    """Settings that this plant has of its own; as parameters ``lagging.lag``."""

    lag: float = quantity(
        0.02, "s", "Lag of the rotors behind their commands", minimum=1e-3, maximum=0.1
    )


class Lagging(Plant):
    """Rolling sphere whose rotors follow their commands with a lag, integrated by midpoints."""

    Settings = LaggingSettings
    state: Vector = np.zeros(6)
    momentum: Vector = np.zeros(3)
    rotor_angles: Vector = np.zeros(2)
    rotor_speeds: Vector = np.zeros(2)
    rotor_torques: Vector = np.zeros(2)

    def __init__(
        self, robot: RobotParameters, state: Vector, settings: LaggingSettings | None = None,
        **given: Any,
    ) -> None:
        super().__init__(robot, **given)
        settings, refused = settings or LaggingSettings(), self.disturbances
        if any(refused.mass_offset) or refused.rolling_friction or refused.torsional_friction:
            raise ValueError(f"given {refused}, expected a balanced sphere without friction")
        self._lag, self._rotor = settings.lag, robot.rotor_axial_inertia
        self._radius, self._mass = robot.shell_radius, robot.total_mass
        transverse, axial = robot.transverse_inertia, robot.axial_inertia
        self._rolling = robot.rolling_inertia
        self._inertia = np.diag([transverse, transverse, axial]) + self._rolling * np.eye(3)
        self.reset(state)

    def reset(self, state: Vector) -> None:
        """Put the sphere at rest."""
        self.state, self.momentum = state, np.zeros(3)
        self.rotor_angles = self.rotor_speeds = self.rotor_torques = np.zeros(2)
        self._reference: Vector = np.zeros(2)

    def displace(self, state: Vector) -> None:
        """Put the sphere elsewhere, keeping rotors and momentum."""
        self.state = state

    def push(self, impulse: ArrayLike) -> None:
        """Apply an impulse at the centre, which is above the contact point by the radius."""
        horizontal = np.append(np.asarray(impulse, dtype=float), 0.0)
        self.momentum = self.momentum + np.cross([0.0, 0.0, self._radius], horizontal)

    def advance(self, speeds_end: Vector, duration: float) -> None:
        """Simulate a step in short ones, with the rotors on their way to the reference."""
        steps = math.ceil(duration / STEP - 1e-9)
        step, begin = duration / steps, self._reference
        for i in range(steps):
            wanted = begin + (speeds_end - begin) * (i + 1) / steps
            self._step(step, (1.0 - math.exp(-step / self._lag)) * (wanted - self.rotor_speeds))
        self._reference = speeds_end

    def _step(self, step: float, change: Vector) -> None:
        """Make a step of integration, in which the rotor speeds change."""
        rate_before, before = self.body_rate, self.state
        torque = np.cross([0.0, 0.0, self._radius], self._mass * self.gravity)
        self.rotor_angles = self.rotor_angles + step * (self.rotor_speeds + 0.5 * change)
        self.rotor_speeds = self.rotor_speeds + change
        self.momentum = self.momentum + step * torque
        self.state = before + 0.5 * step * self._rate()
        after = before + step * self._rate()
        after[2:] /= np.linalg.norm(after[2:])
        # A step that leads into a wall is not made.
        into_wall = self.contact.is_into_wall(before[:2].tolist(), after[:2].tolist())
        self.state = before if into_wall else after
        turning = (self.body_rate - rate_before)[:2] + change
        self.rotor_torques = self._rotor * turning / step

    def _rate(self) -> Vector:
        """Return the rate of the state."""
        w, x, y, z = self.state[2:]
        a, b, c = self.body_rate
        quaternion_rate = 0.5 * np.array([
            -x * a - y * b - z * c, w * a + y * c - z * b, w * b + z * a - x * c,
            w * c + x * b - y * a,
        ])
        return np.concatenate((self.velocity[:2], quaternion_rate))

    @property
    def _turn(self) -> Vector:
        """Rotation from body to world."""
        return np.array(Rotation.from_quat(np.roll(self.state[2:], -1)).as_matrix())

    @property
    def body_rate(self) -> Vector:
        """Angular velocity [rad/s; body frame], from the momentum about the contact point."""
        turn = self._turn
        vertical = turn[2]  # in the body frame
        inertia = self._inertia - self._rolling * np.outer(vertical, vertical)
        spin = self._rotor * np.append(self.rotor_speeds, 0.0)
        return np.array(np.linalg.solve(inertia, turn.T @ self.momentum - spin))

    @property
    def velocity(self) -> Vector:
        """Velocity of the centre [m/s; world frame]."""
        world_rate = self._turn @ self.body_rate
        return self._radius * np.array([world_rate[1], -world_rate[0], 0.0])


def main() -> None:
    """Roll to the goal and print the error each second."""
    told, true = RobotParameters(), RobotParameters(shell_mass=1.1)
    controller = Controller(robot=told)
    simulator = Simulator(robot=true, plant=Lagging(true, START))
    run = run_closed_loop(simulator, controller, Goal.upright(0.0, 0.0, 0.0), 10.0)
    for time, error in zip(run.times[::100], run.errors[::100], strict=True):
        print(f"{time:4.0f} s   error {error:.4f}")
    print(f"settled after {run.settled_after:.2f} s; {run.decisions[-1].mode.value}")
    learnt = controller.estimator.plant
    gains = learnt.constants.input_gain, true.lumped.input_gain, told.lumped.input_gain
    print("learnt: lag {:.0f} ms, c1 {:.5f} (true {:.5f}, told {:.5f})".format(
        1e3 * learnt.lag, *gains
    ))


if __name__ == "__main__":
    main()
