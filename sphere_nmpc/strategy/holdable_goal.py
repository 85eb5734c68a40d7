# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Nearest orientation to a goal at which the rotors can hold the momentum.

The rotors hold what is perpendicular to the body's z axis. Momentum that comes from pushes, slopes
and imbalance is horizontal, so every upright goal can be held; at another one the component along
that axis would turn the sphere. At rest on a slope or out of balance the momentum grows, so that
its rate must be perpendicular to the axis, too.
"""

import numpy as np

from sphere_nmpc.model import rotation
from sphere_nmpc.model.drift import Drift
from sphere_nmpc.model.state import QUATERNION, Vector

MOMENTUM_TOLERANCE = 0.05
"""Component along the body's z axis [rad/s] that is left: it turns the sphere by 1e-2 in some
seconds."""
TORQUE_TOLERANCE = 0.05
"""The same of the momentum's rate [rad/s^2]."""
_LEAST_TOLD = 1e-2
"""Change of the orientation [rad] that is told; one below it is half the error at which a goal
counts as reached."""
_ITERATIONS = 20
_STEP = 1e-6
"""Step of the difference quotients [rad]."""
_LARGEST_TURN = 0.5
"""Largest change of an iteration [rad]."""


def holdable_goal(goal: Vector, drift: Drift, margin: float = 0.0) -> Vector:
    """Return the goal, shape (6,), with the nearest orientation that can be held.

    Parameters
    ----------
    goal : ndarray, shape (6,)
        Goal; its position can always be held.
    drift : Drift
        Drift at the arrival.
    margin : float, optional
        What is added to both tolerances [rad/s, rad/s^2], for the error of an estimated drift.

    Returns
    -------
    ndarray, shape (6,)
        The goal itself where it can be held, else a new array.
    """
    q = goal[QUATERNION]
    found = _excess(q, drift, margin)
    if not found.any():
        return goal
    for _ in range(_ITERATIONS):
        steps = _STEP * np.eye(3)
        jacobian = np.column_stack(
            [(_excess(_turned(q, step), drift, margin) - found) / _STEP for step in steps]
        )
        turn = -np.linalg.pinv(jacobian, rcond=1e-6) @ found
        angle = float(np.linalg.norm(turn))
        q = _turned(q, turn * min(1.0, _LARGEST_TURN / max(angle, _STEP)))
        found = _excess(q, drift, margin)
        if not found.any():
            break
    held: Vector = goal.copy()
    held[QUATERNION] = q
    return held


def given_up_angle(angle: float) -> str:
    """Return what is given up by a change of the goal's orientation [rad], empty if little."""
    if angle < _LEAST_TOLD:
        return ""
    return f"orientation by {np.degrees(angle):.1f} deg: the rotors cannot hold the momentum there"


def _excess(q: Vector, drift: Drift, margin: float) -> Vector:
    """Return the excess along the body's z axis, relative, for h and dh/dt, shape (2,)."""
    axis = rotation.matrix(q)[:, 2]
    parts = (
        (drift.momentum, MOMENTUM_TOLERANCE),
        (drift.torque_at_rest(q), TORQUE_TOLERANCE),
    )
    found = []
    for vector, tolerance in parts:
        along, length = float(axis @ vector), float(np.linalg.norm(vector))
        beyond = max(0.0, abs(along) - tolerance - margin)
        found.append(np.copysign(beyond, along) / length if beyond > 0.0 else 0.0)
    return np.array(found)


def _turned(q: Vector, turn: Vector) -> Vector:
    turned = rotation.product(q, rotation.exponential(turn))
    normalised: Vector = turned / np.linalg.norm(turned)
    return normalised
