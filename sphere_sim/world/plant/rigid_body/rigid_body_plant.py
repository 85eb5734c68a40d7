# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The plant with contact: it can slip, sink in, be pushed, and its drives lag and saturate."""

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import POSITION, QUATERNION, Vector
from sphere_sim.world.plant.errors import MissingEngineError, PlantDivergedError
from sphere_sim.world.plant.rigid_body.floor import make_floor
from sphere_sim.world.plant.rigid_body.mjcf import make_mjcf, servo_gain
from sphere_sim.world.plant.rigid_body.settings import RigidBodySettings

# Layout of the engine's generalised coordinates and velocities.
_CENTRE, _TURN, _ANGLES = slice(0, 3), slice(3, 7), slice(7, 9)
_VELOCITY, _RATE, _SPEEDS = slice(0, 3), slice(3, 6), slice(6, 8)


class RigidBodyPlant:
    """See `sphere_sim.world.plant.contract.Plant`.

    World frame is the floor's; x and y lie in it, also on a slope.

    Parameters
    ----------
    robot : RobotParameters
        True parameters of the robot, which the controller need not know.
    state : ndarray, shape (6,)
        Initial state; the sphere and its rotors start at rest.
    settings : RigidBodySettings, optional
        Drives, floor, contact and integration.

    Raises
    ------
    MissingEngineError
        If MuJoCo is not installed.
    InvalidParameterError
        If the robot cannot be built of rigid bodies.
    """

    def __init__(
        self, robot: RobotParameters, state: Vector, settings: RigidBodySettings | None = None
    ) -> None:
        self._mj = _load_engine()
        self._settings = RigidBodySettings() if settings is None else settings
        self._radius = robot.shell_radius
        self._gain = servo_gain(robot, self._settings)
        bandwidth = self._gain / robot.rotor_axial_inertia
        self._lead = 1.0 / bandwidth if self._settings.drive_feedforward else 0.0
        self._floor = make_floor(self._settings)
        mjcf = make_mjcf(robot, self._settings, self._floor)
        self._model = self._mj.MjModel.from_xml_string(mjcf)
        if self._floor is not None:
            self._model.hfield_data[:] = (self._floor.heights / self._floor.span).ravel()
        self._data = self._mj.MjData(self._model)
        self._scratch = self._mj.MjData(self._model)
        self.reset(state)

    def reset(self, state: Vector) -> None:
        """Put the sphere at rest at `state`, shape (6,)."""
        self._mj.mj_resetData(self._model, self._data)
        self._reference: Vector = np.zeros(2)
        self._place(state)

    def displace(self, state: Vector) -> None:
        """Put the sphere at `state`, shape (6,), without touching its rotors.

        What the disturbance leaves alone is the angular momentum about the contact point and the
        slip, so the shell's rate changes with its orientation, as in the ideal plant.
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

    def push(self, impulse: ArrayLike) -> None:
        """Hit the sphere at its centre.

        Parameters
        ----------
        impulse : array_like, shape (2,) or (3,)
            [N s; world frame].
        """
        force = np.zeros(8)
        given = np.asarray(impulse, dtype=float)
        force[: given.size] = given
        self._data.qvel[:] += np.linalg.solve(self._mass_matrix(), force)

    @property
    def state(self) -> Vector:
        """State [m, -; world frame, body to world], shape (6,)."""
        place = self._data.qpos
        return np.concatenate((place[POSITION], place[_TURN]))

    @property
    def height(self) -> float:
        """Height of the centre over the plane, or over the lowest point of a rough floor [m]."""
        return float(self._data.qpos[2])

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
        """Velocity of the shell where it touches the floor [m/s; world frame], shape (2,)."""
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
        wanted = self._gain * (self._data.act - self._data.qvel[_SPEEDS])
        return np.clip(wanted, -self._settings.torque_limit, self._settings.torque_limit)

    def advance(self, speeds_end: Vector, duration: float) -> None:
        """Move on by `duration` [s] while the speed reference ramps to `speeds_end` [rad/s].

        Raises
        ------
        PlantDivergedError
            If the state is no longer finite.
        """
        steps = max(1, math.ceil(duration / self._settings.time_step - 1e-9))
        slope = (speeds_end - self._reference) / duration
        self._model.opt.timestep = duration / steps
        self._data.ctrl[:] = slope
        # Set anew each time, so that rounding does not add up over a long run.
        self._data.act[:] = self._reference + self._lead * slope
        self._mj.mj_step(self._model, self._data, nstep=steps)
        self._reference = np.array(speeds_end, dtype=float)
        if not np.all(np.isfinite(self._data.qpos)):
            raise PlantDivergedError(self._settings.time_step)

    def _place(self, state: Vector) -> None:
        """Set the pose, with the shell just touching the floor."""
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
        """Return the engine's mass matrix at the present pose, shape (8, 8)."""
        # In data of its own, so that looking does not change the run.
        self._scratch.qpos[:] = self._data.qpos
        self._mj.mj_forward(self._model, self._scratch)
        columns = np.zeros((8, 8))
        for column, unit in zip(columns, np.eye(8), strict=True):
            self._mj.mj_mulM(self._model, self._scratch, column, unit)
        return columns


def _load_engine() -> Any:
    try:
        import mujoco
    except ImportError as error:
        raise MissingEngineError from error
    return mujoco
