# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""SLSQP of SciPy on a cost written in NumPy, as in a first prototype."""

import numpy as np
import scipy.optimize

from sphere_nmpc.model.integrator import steps_for
from sphere_nmpc.model.state import INPUT_SIZE, Vector
from sphere_sim.benchmark.nlp_solvers import SIZE, WarmStarted
from sphere_sim.benchmark.problem import (
    CONSTANTS,
    HORIZON,
    INPUT_WEIGHT,
    INTEGRATION_STEP,
    LIMIT,
    SAMPLE_PERIOD,
    TERMINAL_WEIGHT,
)

_DIFFERENCE = 1.5e-8
"""Step of the forward differences: about the square root of the rounding error [-]."""


class NumpySlsqp(WarmStarted):
    """SLSQP with forward differences that are evaluated in one vectorised call."""

    def minimise(self, start: Vector, p: Vector) -> tuple[Vector, bool]:
        """Minimise from `start`, (SIZE,), with parameters `p`; return the point and success."""
        x, goal, u = p[0:6], p[6:12], p[12:14]
        steps = np.vstack((np.zeros(SIZE), _DIFFERENCE * np.eye(SIZE)))

        def evaluate(v: Vector) -> tuple[float, Vector]:
            costs = costs_at(v + steps, x, goal, u)
            return float(costs[0]), (costs[1:] - costs[0]) / _DIFFERENCE

        found = scipy.optimize.minimize(
            evaluate,
            start,
            jac=True,
            method="SLSQP",
            bounds=[(-1.0, 1.0)] * SIZE,
            options={"ftol": 1e-10, "maxiter": 100},
        )
        return np.asarray(found.x), bool(found.success)


def costs_at(v: Vector, x: Vector, goal: Vector, u: Vector) -> Vector:
    """Return the costs of several input sequences, shape (K,).

    Integrator, step and cost are those of all benchmarked solvers.

    Parameters
    ----------
    v : ndarray, shape (K, SIZE)
        Knots of each sequence over `LIMIT` [-].
    x, goal : ndarray, shape (6,)
        Current and desired state.
    u : ndarray, shape (2,)
        Current rotor speeds [rad/s].
    """
    knots = LIMIT * v.reshape(-1, HORIZON, INPUT_SIZE)
    cost: Vector = INPUT_WEIGHT / TERMINAL_WEIGHT * np.sum(knots**2, axis=(1, 2))
    steps = steps_for(SAMPLE_PERIOD, INTEGRATION_STEP)
    at, q, last = (np.repeat(part[:, None], v.shape[0], axis=1) for part in (x[0:2], x[2:6], u))
    for m in range(HORIZON):
        slope = (knots[:, m].T - last) / steps
        for i in range(steps):
            here, there = last + i * slope, last + (i + 1) * slope
            moved, q = _step(q, here, there, SAMPLE_PERIOD / steps)
            at = at + moved
        last = knots[:, m].T
        weight = 1.0 if m == HORIZON - 1 else 1.0 / TERMINAL_WEIGHT
        misses = np.vstack((at, q)) - goal[:, None]
        cost = cost + weight * np.sum(misses**2, axis=0)
    return cost


def _step(q: Vector, u_start: Vector, u_end: Vector, h: float) -> tuple[Vector, Vector]:
    middle = 0.5 * (u_start + u_end)
    w1, v1 = _rates(q, u_start)
    q2 = _turned(q, 0.5 * h * w1)
    w2, v2 = _rates(q2, middle)
    w3, v3 = _rates(_turned(q, 0.5 * h * w2), middle)
    w4, v4 = _rates(_turned(q2, h * (w3 - 0.5 * w1)), u_end)
    first = _turned(q, h / 12.0 * (3.0 * w1 + 2.0 * w2 + 2.0 * w3 - w4))
    q_end = _turned(first, h / 12.0 * (-w1 + 2.0 * w2 + 2.0 * w3 + 3.0 * w4))
    return h / 6.0 * (v1 + 2.0 * v2 + 2.0 * v3 + v4), q_end


def _rates(q: Vector, u: Vector) -> tuple[Vector, Vector]:
    """Return body rates [rad/s], shape (3, K), and velocities of the centre [m/s], (2, K)."""
    radius, c1, r1, r3 = CONSTANTS
    w, x, y, z = q
    k1, k2 = 2.0 * (x * z - w * y), 2.0 * (y * z + w * x)
    k3 = w * w - x * x - y * y + z * z
    along = (k1 * u[0] + k2 * u[1]) / (1.0 - r1 * (k1 * k1 + k2 * k2) - r3 * k3 * k3)
    b1, b2 = -c1 * (u[0] + r1 * k1 * along), -c1 * (u[1] + r1 * k2 * along)
    b3 = -c1 * r3 * k3 * along
    east = (w * w + x * x - y * y - z * z) * b1 + 2.0 * (x * y - w * z) * b2
    east = east + 2.0 * (x * z + w * y) * b3
    north = 2.0 * (x * y + w * z) * b1 + (w * w - x * x + y * y - z * z) * b2
    north = north + 2.0 * (y * z - w * x) * b3
    return np.array([b1, b2, b3]), radius * np.array([north, -east])


def _turned(q: Vector, rotation: Vector) -> Vector:
    """Return q times the exponential of half the rotation vectors [rad], shape (4, K)."""
    half = 0.5 * np.sqrt(np.sum(rotation**2, axis=0))
    a = np.cos(half)
    b, c, d = 0.5 * np.sinc(half / np.pi) * rotation
    w, x, y, z = q
    return np.array(
        [
            w * a - x * b - y * c - z * d,
            w * b + x * a + y * d - z * c,
            w * c - x * d + y * a + z * b,
            w * d + x * c - y * b + z * a,
        ]
    )
