# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Plant with contact: it can slip and be pushed, and its drives lag and saturate."""

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sphere_nmpc.errors import SphereNmpcError
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import POSITION, QUATERNION, Vector
from sphere_sim.world.disturbances import DisturbanceSettings
from sphere_sim.world.plant.contract import Plant, PlantError
from sphere_sim.world.plant.rigid_body.mjcf import make_floor, make_mjcf, servo_gain
from sphere_sim.world.plant.rigid_body.settings import RigidBodySettings
from sphere_sim.world.walls import Walls

# Layout of MuJoCo's generalised coordinates and velocities.
_CENTRE, _TURN, _ANGLES = slice(0, 3), slice(3, 7), slice(7, 9)
_VELOCITY, _RATE, _SPEEDS = slice(0, 3), slice(3, 6), slice(6, 8)


class MissingEngineError(SphereNmpcError, ImportError):
    """The rigid-body engine is not installed."""

    def __init__(self) -> None:
        super().__init__(
            "the plant 'rigid_body' needs MuJoCo: pip install 'sphere_nmpc[rigid]' (or mujoco)"
        )


class PlantDivergedError(PlantError, RuntimeError):
    """The state of a simulated plant is not finite: its longest step [s] is too long."""

    def __init__(self, time_step: float) -> None:
        super().__init__(
            f"rigid_body: the state is no longer finite; time_step {time_step:g} s is too long "
            "for the contact and the drives"
        )


class RigidBodyPlant(Plant):
    """Plant of rigid bodies; for the arguments see `sphere_sim.world.plant.factory.make_plant`.

    The world frame is that of the floor: x and y are coordinates in it, also on a slope.
    `InvalidParameterError` is raised if the robot cannot be built of rigid bodies.
    """

    Settings = RigidBodySettings

    def __init__(
        self, robot: RobotParameters, state: Vector, settings: RigidBodySettings | None = None,
        disturbances: DisturbanceSettings | None = None, walls: Walls | None = None,
    ) -> None:
        try:
            import mujoco
        except ImportError as error:
            raise MissingEngineError from error
        super().__init__(robot, disturbances, walls)
        self._mj: Any = mujoco
        settings = RigidBodySettings() if settings is None else settings
        self._settings = settings.for_robot(robot)
        self._radius = robot.shell_radius
        self._gain = servo_gain(robot, self._settings)
        bandwidth = self._gain / robot.rotor_axial_inertia
        self._lead = 1.0 / bandwidth if self._settings.drive_feedforward else 0.0
        self._floor = make_floor(self._settings)
        self._robot = robot
        self._compile(walls)
        self.reset(state)

    def _compile(self, walls: Walls | None) -> None:
        """Make MuJoCo's model of robot, floor and walls, and its data; all of them or none."""
        mjcf = make_mjcf(self._robot, self._settings, self.disturbances, self._floor, walls)
        model = self._mj.MjModel.from_xml_string(mjcf)
        if self._floor is not None:
            model.hfield_data[:] = (self._floor.heights / self._floor.span).ravel()
        data, workspace = self._mj.MjData(model), self._mj.MjData(model)
        self._model, self._data, self._workspace = model, data, workspace

    def reset(self, state: Vector) -> None:
        """Put the sphere at rest at `state`, shape (6,)."""
        self._mj.mj_resetData(self._model, self._data)
        self._reference: Vector = np.zeros(2)
        self._place(state)
        self._touch()

    def surround(self, walls: Walls | None) -> None:
        """Replace the walls; None where there are none."""
        before = self._data
        self._compile(walls)
        super().surround(walls)
        for name in ("qpos", "qvel", "act", "ctrl", "qacc_warmstart"):
            getattr(self._data, name)[:] = getattr(before, name)
        self._touch()

    def displace(self, state: Vector) -> None:
        """Put the sphere at `state`, shape (6,), keeping its rotors.

        The angular momentum about the contact point and the slip stay as they are, so that the
        angular velocity of the shell changes with the orientation, as in the ideal plant.
        """
        momentum, slip = self.momentum, self.slip
        self._place(state)
        velocity = self._data.qvel
        columns = []
        for rate in np.vstack((np.zeros(3), np.eye(3))):
            velocity[_RATE] = rate
            velocity[_VELOCITY] = self._rolling_velocity() + np.append(slip, 0.0)
            columns.append(self.momentum)
        still = columns[0]
        matrix = np.column_stack([column - still for column in columns[1:]])
        velocity[_RATE] = np.linalg.solve(matrix, momentum - still)
        velocity[_VELOCITY] = self._rolling_velocity() + np.append(slip, 0.0)
        self._touch()

    def push(self, impulse: ArrayLike) -> None:
        """Apply a horizontal impulse [N s; world frame], shape (2,), at the centre."""
        force = np.zeros(8)
        force[:2] = impulse
        self._data.qvel[:] += np.linalg.solve(self._mass_matrix(), force)

    def tilt(self, slope: float, direction: float) -> None:
        """Change the inclination of the floor and its downhill direction [rad]."""
        super().tilt(slope, direction)
        self._model.opt.gravity[:] = self.gravity

    @property
    def state(self) -> Vector:
        """State [m, -; world frame, body to world], shape (6,)."""
        place = self._data.qpos
        return np.concatenate((place[POSITION], place[_TURN]))

    @property
    def body_rate(self) -> Vector:
        """Angular velocity of the shell [rad/s; body frame], shape (3,)."""
        return self._data.qvel[_RATE].copy()

    @property
    def velocity(self) -> Vector:
        """Velocity of the centre [m/s; world frame], shape (3,)."""
        return self._data.qvel[_VELOCITY].copy()

    @property
    def slip(self) -> Vector:
        """Velocity of the shell at the contact point [m/s; world frame], shape (2,)."""
        return (self.velocity - self._rolling_velocity())[:2]

    @property
    def momentum(self) -> Vector:
        """Angular momentum about the contact point [N m s; world frame], shape (3,) (Eq. 9)."""
        generalised = self._mass_matrix() @ self._data.qvel
        along = generalised[_VELOCITY]
        arm = np.array([-along[1], along[0], 0.0])
        return self._rotation() @ generalised[_RATE] + self._radius * arm

    @property
    def rotor_angles(self) -> Vector:
        """Angles of the rotors [rad], shape (2,)."""
        return self._data.qpos[_ANGLES].copy()

    @property
    def rotor_speeds(self) -> Vector:
        """Speeds of the rotors relative to the shell [rad/s], shape (2,)."""
        return self._data.qvel[_SPEEDS].copy()

    @property
    def rotor_torques(self) -> Vector:
        """Torques of the drives [N m], shape (2,), at the present instant."""
        unlimited = self._gain * (self._data.act - self._data.qvel[_SPEEDS])
        return np.clip(unlimited, -self._settings.torque_limit, self._settings.torque_limit)

    def advance(self, speeds_end: Vector, duration: float) -> None:
        """Simulate a step of `duration` [s] in which the reference ramps to `speeds_end` [rad/s].

        `PlantDivergedError` is raised if the state is no longer finite.
        """
        steps = max(1, math.ceil(duration / self._settings.time_step - 1e-9))
        slope = (speeds_end - self._reference) / duration
        self._model.opt.timestep = duration / steps
        self._data.ctrl[:] = slope
        # Set in each step, so that rounding errors do not accumulate.
        self._data.act[:] = self._reference + self._lead * slope
        if self.contact.walls is None:
            self._mj.mj_step(self._model, self._data, nstep=steps)
        else:
            self._step_by_step(steps)
        self._reference = np.array(speeds_end, dtype=float)
        if not np.all(np.isfinite(self._data.qpos)):
            raise PlantDivergedError(self._settings.time_step)

    def _step_by_step(self, steps: int) -> None:
        """Make integration steps and look for contact with walls after each."""
        place = self._data.qpos[POSITION].tolist()
        for _ in range(steps):
            self._mj.mj_step(self._model, self._data)
            before, place = place, self._data.qpos[POSITION].tolist()
            self.contact.is_into_wall(before, place)

    def _touch(self) -> None:
        """Count a contact with walls where the sphere has been put."""
        place = self._data.qpos[POSITION].tolist()
        self.contact.is_into_wall(place, place)

    def _place(self, state: Vector) -> None:
        """Set the pose, with the shell in contact with the floor."""
        x, y = float(state[0]), float(state[1])
        height = self._radius
        if self._floor is not None:
            height = self._floor.resting_height(x, y, self._radius)
        self._data.qpos[_CENTRE] = (x, y, height)
        self._data.qpos[_TURN] = state[QUATERNION]

    def _rotation(self) -> Vector:
        """Return the matrix that takes body vectors to world ones, shape (3, 3)."""
        flat = np.zeros(9)
        self._mj.mju_quat2Mat(flat, self._data.qpos[_TURN])
        return flat.reshape(3, 3)

    def _rolling_velocity(self) -> Vector:
        """Return the velocity at which the centre rolls without slip [m/s; world], shape (3,)."""
        rate = self._rotation() @ self._data.qvel[_RATE]
        return self._radius * np.array([rate[1], -rate[0], 0.0])

    def _mass_matrix(self) -> Vector:
        """Return MuJoCo's mass matrix at the present pose, shape (8, 8)."""
        # With other data, so that reading quantities does not change the simulation.
        self._workspace.qpos[:] = self._data.qpos
        self._mj.mj_forward(self._model, self._workspace)
        columns = np.zeros((8, 8))
        for column, unit in zip(columns, np.eye(8), strict=True):
            self._mj.mj_mulM(self._model, self._workspace, column, unit)
        return columns
