# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Other ways to a pose from the same IMU: an attitude filter with rolling, and a general filter.

The general one is the model of robot_localization as its sources have it (`ekf.cpp`, with the
default process noise of `filter_base.cpp`), not the program: position, roll, pitch and yaw, then
velocity, angular velocity and acceleration in the body frame, 15 numbers in this order.
"""

import importlib

import numpy as np
from scipy.spatial.transform import Rotation

from sphere_nmpc.model import rotation
from sphere_nmpc.model.disturbance import GRAVITY
from sphere_nmpc.model.state import QUATERNION, Vector
from sphere_sim.world.imu_sensor import SimulatedImuSettings

GAINS = (1e-4, 1e-3, 1e-2, 0.1)
"""Gains of the attitude filter [rad/s]; the first one is nearly the gyro alone."""
_PROCESS_NOISE = np.diag(
    [0.05, 0.05, 0.06, 0.03, 0.03, 0.06, 0.025, 0.025, 0.04, 0.01, 0.01, 0.02, 0.01, 0.01, 0.015]
)
"""Per second, in squared units of the state."""
_ANGLES = slice(3, 6)
_ORIENTATION_DEVIATION = 0.01
"""Of the orientation that the attitude filter gives to the general one [rad]."""


def poses_by_others(
    times: Vector, rates: Vector, forces: Vector, start: Vector, radius: float,
    imu: SimulatedImuSettings,
) -> dict[str, Vector]:
    """Return the poses, (n, 6), from the readings of an IMU at `times` [s], by method.

    The sphere rests at `start`, (6,), until time 0, where the mean of the gyro is its bias.
    """
    rates = rates - rates[times < 0.0].mean(axis=0)
    found = {}
    for gain in GAINS:
        turns = attitudes(times, rates, forces, start[QUATERNION], gain)
        found[f"attitude filter {gain:g}"] = rolled(times, rates, turns, start, radius)
    turns = attitudes(times, rates, forces, start[QUATERNION], GAINS[0])
    for name, is_fused in (("with", True), ("without", False)):
        found[f"general filter {name} orientation"] = general(
            times, rates, forces, turns, start, radius, imu, is_fused
        )
    return found


def attitudes(times: Vector, rates: Vector, forces: Vector, start: Vector, gain: float) -> Vector:
    """Return the orientations by Madgwick's filter from a start, (4,), shape (n, 4)."""
    try:
        filters = importlib.import_module("ahrs.filters")
    except ImportError:
        raise SystemExit(
            "given no package ahrs, expected it for the part others: pip install ahrs"
        ) from None
    one, found = filters.Madgwick(gain=gain), [start]
    for step, rate, force in zip(np.diff(times), rates[1:], forces[1:], strict=True):
        found.append(one.updateIMU(found[-1], rate, force, dt=step))
    return np.array(found)


def rolled(times: Vector, rates: Vector, turns: Vector, start: Vector, radius: float) -> Vector:
    """Return the poses, (n, 6), of a sphere that rolls from a start by rates [rad/s; body]."""
    matrices = Rotation.from_quat(turns[:, [1, 2, 3, 0]]).as_matrix()
    world = np.einsum("nij,nj->ni", matrices, rates)
    steps = 0.5 * (world[1:] + world[:-1]) * np.diff(times)[:, None]
    way = radius * np.cumsum(np.column_stack((steps[:, 1], -steps[:, 0])), axis=0)
    return np.column_stack((start[:2] + np.vstack(([0.0, 0.0], way)), turns))


def general(
    times: Vector, rates: Vector, forces: Vector, turns: Vector, start: Vector, radius: float,
    imu: SimulatedImuSettings, with_orientation: bool,
) -> Vector:
    """Return the poses, (n, 6), of the general filter.

    It has the angular velocities, the specific forces without gravity and the velocity of rolling,
    all by the attitudes `turns`, and, where wanted, these themselves.
    """
    gyro, accelerometer = imu.deviations
    deviations = np.repeat(
        [_ORIENTATION_DEVIATION, radius * gyro, gyro, accelerometer], 3
    )
    used = np.arange(3 if with_orientation else 6, 15)
    noise = np.diag(deviations[used - 3] ** 2)
    matrices = Rotation.from_quat(turns[:, [1, 2, 3, 0]]).as_matrix()
    up = matrices[:, 2]
    measured = np.column_stack((
        _angles(matrices), radius * np.cross(rates, up), rates, forces - GRAVITY * up
    ))
    first = rotation.matrix(start[QUATERNION])
    state = np.concatenate((start[:2], [0.0], _angles(first), np.zeros(9)))
    covariance, found = 1e-9 * np.eye(15), [start]
    for step, row in zip(np.diff(times), measured[1:], strict=True):
        nearby = _moved(np.vstack((state, state + 1e-6 * np.eye(15))), step)
        by = (nearby[1:] - nearby[0]).T / 1e-6
        state, covariance = nearby[0], by @ covariance @ by.T + step * _PROCESS_NOISE
        innovation = row[used - 3] - state[used]
        innovation[used < 6] = _wrapped(innovation[used < 6])
        gain = np.linalg.solve(covariance[np.ix_(used, used)] + noise, covariance[used]).T
        state = state + gain @ innovation
        state[_ANGLES] = _wrapped(state[_ANGLES])
        covariance = covariance - gain @ covariance[used]
        covariance = 0.5 * (covariance + covariance.T)
        x, y, z, w = Rotation.from_euler("ZYX", state[[5, 4, 3]]).as_quat()
        found.append(np.array([*state[:2], w, x, y, z]))
    return np.array(found)


def _moved(states: Vector, step: float) -> Vector:
    """Return states, (m, 15), after a step [s] at constant acceleration."""
    roll, pitch = states[:, 3], states[:, 4]
    turn = Rotation.from_euler("ZYX", states[:, [5, 4, 3]]).as_matrix()
    velocity, rate, acceleration = states[:, 6:9], states[:, 9:12], states[:, 12:15]
    moved = states.copy()
    by = velocity * step + 0.5 * acceleration * step**2
    moved[:, :3] += np.einsum("nij,nj->ni", turn, by)
    along = np.sin(roll) * rate[:, 1] + np.cos(roll) * rate[:, 2]
    moved[:, 3] += step * (rate[:, 0] + np.tan(pitch) * along)
    moved[:, 4] += step * (np.cos(roll) * rate[:, 1] - np.sin(roll) * rate[:, 2])
    moved[:, 5] += step * along / np.cos(pitch)
    moved[:, 6:9] += step * acceleration
    return moved


def _angles(matrices: Vector) -> Vector:
    """Return roll, pitch and yaw [rad] of orientations, (..., 3, 3)."""
    return Rotation.from_matrix(matrices).as_euler("ZYX")[..., ::-1]


def _wrapped(angles: Vector) -> Vector:
    return (angles + np.pi) % (2.0 * np.pi) - np.pi
