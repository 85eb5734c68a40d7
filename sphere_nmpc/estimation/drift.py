# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Momentum with its disturbance as one array, and derivatives of the motion, for the estimators.

Errors are those of `sphere_nmpc.model.error_state`.
"""

import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import casadi as ca
import numpy as np

from sphere_nmpc.model import rotation
from sphere_nmpc.model.disturbance import Disturbance
from sphere_nmpc.model.dynamics import rolling, world_rate
from sphere_nmpc.model.integrator import DEFAULT_MAX_STEP, cf4_step, steps_for
from sphere_nmpc.model.state import Vector
from sphere_nmpc.model.symbolic_rotation import quaternion_product, rotation_matrix

ERROR_SIZE = 5
MOVING_SIZE = ERROR_SIZE + 3
"""Size of the error of state and momentum."""
TORQUES_SIZE = 5
"""Size of [slope, imbalance]."""

_COLUMNS = MOVING_SIZE + 4 + TORQUES_SIZE
_WORKSPACES = threading.local()


MOMENTUM = slice(0, 3)
SLOPE = slice(3, 5)
IMBALANCE = slice(5, 8)
DRIFT_SIZE = 8
"""Layout of a drift as an array."""


def _zeros(size: int) -> Vector:
    zeros: Vector = np.zeros(size)
    zeros.flags.writeable = False
    return zeros


@dataclass(frozen=True, eq=False)
class Drift:
    """Momentum at an instant, and the torques that change it.

    Attributes
    ----------
    momentum : ndarray, shape (3,)
        h [rad/s; world frame].
    slope : ndarray, shape (2,)
        s, the torque of a slope over I1 [rad/s^2; world frame].
    imbalance : ndarray, shape (3,)
        a = Mt g c / I1 of a centre of mass at c [rad/s^2; body frame].
    """

    momentum: Vector = field(default_factory=lambda: _zeros(3))
    slope: Vector = field(default_factory=lambda: _zeros(2))
    imbalance: Vector = field(default_factory=lambda: _zeros(3))

    @classmethod
    def from_array(cls, values: Vector) -> "Drift":
        """Return the drift of an array laid out [h, s, a], shape (8,)."""
        return cls(values[MOMENTUM].copy(), values[SLOPE].copy(), values[IMBALANCE].copy())

    def as_array(self) -> Vector:
        """Return [h, s, a], shape (8,)."""
        return np.concatenate((self.momentum, self.slope, self.imbalance))

    @property
    def is_zero(self) -> bool:
        """Whether the model is the paper's: no momentum, level and balanced."""
        # The identity first: this is asked several times a solve.
        if self is NO_DRIFT:
            return True
        return not (self.momentum.any() or self.slope.any() or self.imbalance.any())

    def in_body(self, quaternion: Vector) -> Vector:
        """Return the momentum in the body frame at an orientation (4,) [rad/s], shape (3,)."""
        if self is NO_DRIFT:
            return np.zeros(3)
        turned: Vector = rotation.matrix(quaternion).T @ self.momentum
        return turned

    def rest_speeds(self, quaternion: Vector) -> Vector:
        """Return the rotor speeds that hold the momentum at an orientation [rad/s], shape (2,).

        With them the sphere rests if the component of the momentum along the body's z axis is
        zero; otherwise it turns slowly about that axis.
        """
        return self.in_body(quaternion)[:2]

    @property
    def disturbance(self) -> Disturbance:
        """Slope and imbalance."""
        return Disturbance(self.slope, self.imbalance)


NO_DRIFT = Drift()
"""Drift of the paper's model."""


def parts_of_ramp(start: Vector, end: Vector, steps: int) -> Iterator[tuple[Vector, Vector]]:
    """Yield the inputs at both ends of each of equal steps of an interval."""
    for i in range(steps):
        yield start + (end - start) * (i / steps), start + (end - start) * ((i + 1) / steps)


def state_rates(state: Vector, speeds: Vector, constants: Vector) -> Vector:
    """Return velocity [m/s; world frame] and angular velocity [rad/s; body frame], shape (5,).

    For a state (6,), rotor speeds (2,) [rad/s] and constants [Rs, c1, r1, r3].
    """
    return np.array(_rates()(state, speeds, constants)).ravel()


def propagate(
    state: Vector,
    speeds: tuple[Vector, Vector],
    duration: float,
    constants: Vector,
    max_step: float = DEFAULT_MAX_STEP,
) -> tuple[Vector, Vector, Vector]:
    """Advance over an interval of a first-order hold, with the derivatives of the result.

    The arguments are those of `sphere_nmpc.model.integrator.integrate`; `speeds` are the rotor
    speeds at both ends. Returned are the state at the end, and the derivatives of its error by
    the error at the start, shape (5, 5), and by the constants, shape (5, 4).
    """
    steps = steps_for(duration, max_step)
    by_state: Vector = np.eye(ERROR_SIZE)
    by_constants: Vector = np.zeros((ERROR_SIZE, 4))
    for here, there in parts_of_ramp(*speeds, steps):
        found = _propagation_step()(state, here, there, duration / steps, constants)
        end, onwards, added = (np.array(matrix, dtype=float) for matrix in found)
        state = end.ravel()
        by_state, by_constants = onwards @ by_state, onwards @ by_constants + added
    return state, by_state, by_constants


@cache
def _propagation_step() -> ca.Function:
    x, p, d = ca.SX.sym("x", 6), ca.SX.sym("p", 4), ca.SX.sym("d", ERROR_SIZE)
    u_start, u_end, h = ca.SX.sym("u_start", 2), ca.SX.sym("u_end", 2), ca.SX.sym("h")
    shift, q = _still_step(x[2:6], u_start, u_end, h, p)
    # To first order, which suffices for the derivative at zero.
    turned = quaternion_product(x[2:6], ca.vertcat(1.0, 0.5 * d[2:5]))
    moved, turned_end = _still_step(turned, u_start, u_end, h, p)
    inverse = ca.vertcat(q[0], -q[1:4])
    held = ca.SX.sym("q", 4)
    away = ca.vertcat(d[0:2] + moved, 2.0 * quaternion_product(held, turned_end)[1:4])
    by_state = ca.substitute(ca.jacobian(away, d), held, inverse)
    by_constants = ca.substitute(ca.jacobian(away, p), held, inverse)
    zero = ca.SX.zeros(ERROR_SIZE)
    outputs = [
        ca.vertcat(x[0:2] + shift, q),
        ca.substitute(by_state, d, zero),
        ca.substitute(by_constants, d, zero),
    ]
    return ca.Function("propagation_step", [x, u_start, u_end, h, p], outputs)


def _still_step(q: Any, u_start: Any, u_end: Any, h: Any, p: Any) -> tuple[Any, Any]:
    still = ca.SX.zeros(3), ca.SX.zeros(TORQUES_SIZE)
    return cf4_step(q, still[0], u_start, u_end, h, p, still[1])[:2]


@cache
def _rates() -> ca.Function:
    x, u, p = ca.SX.sym("x", 6), ca.SX.sym("u", 2), ca.SX.sym("p", 4)
    still = ca.SX.zeros(3)
    return ca.Function("rates", [x, u, p], [_velocities(x, still, u, p, still)])


@dataclass(frozen=True, eq=False)
class DriftPropagation:
    """State and momentum at the end of an interval, with derivatives of their error.

    Attributes
    ----------
    state : ndarray, shape (6,)
    momentum : ndarray, shape (3,)
        [rad/s; world frame].
    by_start : ndarray, shape (8, 8)
        Derivative by the error of state and momentum at the start.
    by_constants : ndarray, shape (8, 4)
    by_torques : ndarray, shape (8, 5)
        Derivative by [slope, imbalance].
    """

    state: Vector
    momentum: Vector
    by_start: Vector
    by_constants: Vector
    by_torques: Vector


def state_rates_with_drift(
    state: Vector, drift: Drift, speeds: Vector, constants: Vector
) -> Vector:
    """Return the rates of `state_rates`, shape (5,), with drift."""
    found = _rates_with_drift()(state, drift.momentum, drift.imbalance, speeds, constants)
    return np.array(found).ravel()


def propagate_with_drift(
    state: Vector,
    drift: Drift,
    durations: Vector,
    speeds: Vector,
    constants: Vector,
    max_step: float = DEFAULT_MAX_STEP,
) -> DriftPropagation:
    """Advance over the intervals of a first-order hold with drift, with derivatives.

    `drift` is that at the start, `durations`, shape (K,), are the lengths of the intervals [s],
    `speeds`, shape (K + 1, 2), the rotor speeds at their ends [rad/s]; for the others see
    `sphere_nmpc.model.integrator.integrate`.
    """
    work = _step()
    work.state[:], work.momentum[:], work.constants[:] = state, drift.momentum, constants
    work.torques[:2], work.torques[2:] = drift.slope, drift.imbalance
    derivatives = np.eye(MOVING_SIZE, _COLUMNS)
    for duration, start, end in zip(durations, speeds[:-1], speeds[1:], strict=True):
        steps = steps_for(float(duration), max_step)
        work.length[0] = duration / steps
        for here, there in parts_of_ramp(start, end, steps):
            work.u_start[:], work.u_end[:] = here, there
            work.run()
            work.state[:], work.momentum[:] = work.end[:6], work.end[6:]
            derivatives = work.columns[:MOVING_SIZE].T @ derivatives
            derivatives[:, MOVING_SIZE:] += work.columns[MOVING_SIZE:].T
    by_start, by_constants, by_torques = np.split(
        derivatives, [MOVING_SIZE, MOVING_SIZE + 4], axis=1
    )
    return DriftPropagation(
        work.state.copy(), work.momentum.copy(), by_start, by_constants, by_torques
    )


class _Step:
    """One step of the integrator, with arguments and results at addresses that are kept.

    A call through CasADi's own conversion of arrays takes ten times as long.
    """

    def __init__(self) -> None:
        sizes = (6, 3, 2, 2, 1, 4, TORQUES_SIZE)
        arrays = [np.zeros(size) for size in sizes]
        self.state, self.momentum, self.u_start, self.u_end, *others = arrays
        self.length, self.constants, self.torques = others
        self.end = np.zeros(9)
        # CasADi writes column by column.
        self.columns = np.zeros((_COLUMNS, MOVING_SIZE))
        self._buffer: Any
        self._buffer, self.run = _drift_propagation_step().buffer()
        for i, array in enumerate(arrays):
            self._buffer.set_arg(i, array.data)
        self._buffer.set_res(0, self.end.data)
        self._buffer.set_res(1, self.columns.data)


def _step() -> _Step:
    """Return the step of this thread."""
    kept: _Step | None = getattr(_WORKSPACES, "step", None)
    if kept is None:
        kept = _WORKSPACES.step = _Step()
    return kept


@cache
def _drift_propagation_step() -> ca.Function:
    x, p, d = ca.SX.sym("x", 6), ca.SX.sym("p", 4), ca.SX.sym("d", MOVING_SIZE)
    momentum, torques = ca.SX.sym("momentum", 3), ca.SX.sym("torques", TORQUES_SIZE)
    u_start, u_end, h = ca.SX.sym("u_start", 2), ca.SX.sym("u_end", 2), ca.SX.sym("h")
    shift, q, after = cf4_step(x[2:6], momentum, u_start, u_end, h, p, torques)
    turned = quaternion_product(x[2:6], ca.vertcat(1.0, 0.5 * d[2:5]))
    moved, turned_end, away_after = cf4_step(
        turned, momentum + d[5:8], u_start, u_end, h, p, torques
    )
    inverse, held = ca.vertcat(q[0], -q[1:4]), ca.SX.sym("q", 4)
    turn = 2.0 * quaternion_product(held, turned_end)[1:4]
    away = ca.vertcat(d[0:2] + moved, turn, away_after)
    jacobian = ca.substitute(ca.jacobian(away, ca.vertcat(d, p, torques)), held, inverse)
    jacobian = ca.substitute(jacobian, d, ca.SX.zeros(MOVING_SIZE))
    end = ca.vertcat(x[0:2] + shift, q, after)
    arguments = [x, momentum, u_start, u_end, h, p, torques]
    results = ca.cse([end, ca.densify(jacobian)])
    return ca.Function("drift_propagation_step", arguments, results)


@cache
def _rates_with_drift() -> ca.Function:
    x, u, p = ca.SX.sym("x", 6), ca.SX.sym("u", 2), ca.SX.sym("p", 4)
    momentum, imbalance = ca.SX.sym("momentum", 3), ca.SX.sym("imbalance", 3)
    arguments = [x, momentum, imbalance, u, p]
    return ca.Function("rates", arguments, [_velocities(x, momentum, u, p, imbalance)])


def _velocities(x: Any, momentum: Any, u: Any, p: Any, imbalance: Any) -> Any:
    world = world_rate(x[2:6], momentum, u, p, imbalance)
    body = ca.mtimes(rotation_matrix(x[2:6]).T, world)
    return ca.vertcat(rolling(world, p[0]), body)
