# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""What ros2_control does with commands, and mujoco_ros2_control with the model of the robot."""

import numpy as np
import pytest
from rclpy.serialization import deserialize_message
from trajectory_msgs.msg import JointTrajectory

from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector
from sphere_nmpc.ros import cdr
from sphere_sim.world.disturbances import DisturbanceSettings
from sphere_sim.world.plant.rigid_body.mjcf import make_mjcf
from sphere_sim.world.plant.rigid_body.settings import RigidBodySettings


class Interpolation:
    """Cubics through positions and velocities of a message, as in `Trajectory::sample`.

    Derived from trajectory.cpp of ros2_controllers 4.42.1.
    """

    def __init__(self, raw: bytes) -> None:
        message = deserialize_message(raw, JointTrajectory)
        assert message.joint_names == list(cdr.JOINT_NAMES)
        times = [p.time_from_start.sec + p.time_from_start.nanosec / 1e9 for p in message.points]
        self.start = message.header.stamp.sec + message.header.stamp.nanosec / 1e9
        self._times = self.start + np.array(times)
        self._positions = np.array([p.positions for p in message.points])
        self._velocities = np.array([p.velocities for p in message.points])

    def sample(self, time: float) -> tuple[Vector, Vector]:
        """Return positions [rad] and velocities [rad/s], shape (2,), from the first point on."""
        i = int(np.searchsorted(self._times, time, side="right")) - 1
        if i == self._times.size - 1:
            return self._positions[i], self._velocities[i]
        p, q = self._positions[i : i + 2]
        v, w = self._velocities[i : i + 2]
        length, t = self._times[i + 1] - self._times[i], time - self._times[i]
        square = (3.0 * (q - p) - (2.0 * v + w) * length) / length**2
        cube = (2.0 * (p - q) + (v + w) * length) / length**3
        angle = p + v * t + square * t**2 + cube * t**3
        return angle, v + 2.0 * square * t + 3.0 * cube * t**2


class Exported:
    """Model in MuJoCo as mujoco_ros2_control runs it, with what it looks up by name."""

    def __init__(self, robot: RobotParameters) -> None:
        self.mujoco = pytest.importorskip("mujoco")
        settings = RigidBodySettings().for_robot(robot)
        text = make_mjcf(robot, settings, DisturbanceSettings(), for_ros2_control=True)
        self.model = self.mujoco.MjModel.from_xml_string(text)
        self.data = self.mujoco.MjData(self.model)

    @property
    def state(self) -> Vector:
        position = self.data.sensor("pose_pos").data[:2]
        return np.concatenate((position, self.data.sensor("pose_quat").data))

    def step(self, speeds: Vector) -> None:
        """Go one step on with these commands [rad/s], shape (2,)."""
        self.data.ctrl[:] = speeds
        self.mujoco.mj_step(self.model, self.data)
        self.mujoco.mj_forward(self.model, self.data)

    def follow(self, hold: FirstOrderHold, share: float) -> Vector:
        """Return the states after each step, shape (K, 6), and stay at the last one.

        A command is the speed at `share` of the step for which it is held.
        """
        step, states = self.model.opt.timestep, []
        for k in range(round(hold.end / step)):
            self.step(hold.at((k + share) * step))
            states.append(self.state)
        return np.array(states)
