# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Prediction of the states under a first-order hold, by the solver's own integrator."""

import threading
from dataclasses import dataclass
from typing import Any

import numpy as np

from sphere_nmpc.model.drift import DRIFT_SIZE, NO_DRIFT, Drift
from sphere_nmpc.model.integrator import DEFAULT_MAX_STEP
from sphere_nmpc.model.state import Vector
from sphere_nmpc.solver import plain
from sphere_nmpc.solver.native.library import library

_WORKSPACES = threading.local()


def roll_out(
    state: Vector,
    inputs: Vector,
    durations: Vector,
    constants: Vector,
    max_step: float = DEFAULT_MAX_STEP,
    drift: Drift = NO_DRIFT,
) -> Vector:
    """Return the states at the knots of a first-order hold; safe to call from several threads.

    Parameters
    ----------
    state : ndarray, shape (6,)
        x_0, the state at the first knot.
    inputs : ndarray, shape (N + 1, 2)
        Rotor speeds u_0 ... u_N at the knots [rad/s].
    durations : ndarray, shape (N,)
        Interval lengths h_1 ... h_N [s]; 0 for a jump of the speeds.
    constants : ndarray, shape (4,)
        Lumped constants [Rs, c1, r1, r3].
    max_step : float, optional
        Longest integration step [s].
    drift : Drift, optional
        Drift at the first knot.

    Returns
    -------
    ndarray, shape (N + 1, 6)
        x_0 ... x_N.
    """
    return roll_out_with_momentum(state, drift, inputs, durations, constants, max_step)[0]


def roll_out_with_momentum(
    state: Vector,
    drift: Drift,
    inputs: Vector,
    durations: Vector,
    constants: Vector,
    max_step: float = DEFAULT_MAX_STEP,
) -> tuple[Vector, Vector]:
    """Return the states (N + 1, 6) as `roll_out` does and the momenta at the knots.

    The momenta h are (N + 1, 3) [rad/s; world frame].
    """
    solver = library()
    if solver is None:
        found = plain.shoot(state, drift.as_array(), inputs, durations, constants, max_step)
        return found.states, found.momenta
    n = durations.size
    kept: dict[Any, Any] = _WORKSPACES.__dict__
    workspace: _Workspace | None = kept.get(n)
    if workspace is None:
        workspace = kept[n] = _Workspace(n)
    workspace.constants[:] = constants
    workspace.durations[:] = durations
    workspace.state[:] = state
    workspace.drift[:] = 0.0 if drift is NO_DRIFT else drift.as_array()
    workspace.inputs[:] = inputs
    solver.hold_roll_out(n, max_step, *workspace.addresses)
    return workspace.states.copy(), workspace.momenta.copy()


@dataclass(frozen=True, eq=False)
class Propagation:
    """State and momentum at the end of a motion, with the derivatives of their error.

    Attributes
    ----------
    state : ndarray, shape (6,)
    momentum : ndarray, shape (3,)
        [rad/s; world frame].
    by_start : ndarray, shape (8, 8)
        Derivative of the error of state and momentum by that at the start.
    by_constants : ndarray, shape (8, 4)
    by_torques : ndarray, shape (8, 5)
        Derivative by [slope, imbalance].
    """

    state: Vector
    momentum: Vector
    by_start: Vector
    by_constants: Vector
    by_torques: Vector


def propagate(
    state: Vector,
    drift: Drift,
    inputs: Vector,
    durations: Vector,
    constants: Vector,
    max_step: float = DEFAULT_MAX_STEP,
) -> Propagation:
    """Return the end of a first-order hold with its derivatives; the arguments of `roll_out`."""
    solver = library()
    assert solver is not None
    end, momentum = state.copy(), drift.momentum.copy()
    torques = np.concatenate((drift.slope, drift.imbalance))
    found = np.empty((8, 15))
    inputs, durations = np.ascontiguousarray(inputs), np.ascontiguousarray(durations)
    arrays = (constants, torques, durations, inputs, end, momentum, found)
    solver.hold_propagate(durations.size, max_step, *(a.ctypes.data for a in arrays))
    by_start = np.zeros((8, 8))
    by_start[0, 0] = by_start[1, 1] = 1.0
    by_start[:, 2:] = found[:, :6]
    return Propagation(end, momentum, by_start, found[:, 6:10], found[:, 10:])


class _Workspace:
    """Arguments and results of a roll-out over N intervals, at addresses that are kept."""

    def __init__(self, intervals: int) -> None:
        n = intervals
        self.constants, self.durations = np.empty(4), np.empty(n)
        self.state, self.drift = np.empty(6), np.empty(DRIFT_SIZE)
        self.inputs = np.empty((n + 1, 2))
        self.states, self.momenta = np.empty((n + 1, 6)), np.empty((n + 1, 3))
        arrays = (
            self.constants, self.durations, self.state, self.drift, self.inputs, self.states,
            self.momenta,
        )
        self.addresses = [array.ctypes.data for array in arrays]
