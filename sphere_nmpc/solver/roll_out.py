# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Prediction of the states under a first-order hold, by the solver's own integrator."""

import threading
from typing import Any, NamedTuple

import numpy as np

from sphere_nmpc.model.disturbance import UNDISTURBED, Disturbance
from sphere_nmpc.model.state import STATE_SIZE, Vector
from sphere_nmpc.model.units import DEFAULT_MAX_STEP
from sphere_nmpc.solver.native.library import library

_WORKSPACES = threading.local()


class Propagation(NamedTuple):
    """State at the end of a motion, with the derivatives of its error.

    Errors are those of `sphere_nmpc.model.error_state`.

    Attributes
    ----------
    state : ndarray, shape (9,)
    by_start : ndarray, shape (8, 8)
        By the error at the start.
    by_constants : ndarray, shape (8, 4)
    by_torques : ndarray, shape (8, 5)
        By [slope, imbalance].
    """

    state: Vector
    by_start: Vector
    by_constants: Vector
    by_torques: Vector

    @classmethod
    def of(cls, state: Vector, derivatives: Vector) -> "Propagation":
        """Return one from derivatives by rotation, momentum, constants and torques, (8, 15)."""
        by_start = np.zeros((8, 8))
        by_start[0, 0] = by_start[1, 1] = 1.0
        by_start[:, 2:] = derivatives[:, :6]
        return cls(state, by_start, derivatives[:, 6:10], derivatives[:, 10:])


def roll_out(
    state: Vector,
    inputs: Vector,
    durations: Vector,
    constants: Vector,
    max_step: float = DEFAULT_MAX_STEP,
    disturbance: Disturbance = UNDISTURBED,
) -> Vector:
    """Return the states at the knots of a first-order hold; safe to call from several threads.

    Parameters
    ----------
    state : ndarray, shape (9,) or (6,)
        x_0, the state at the first knot; a pose has no momentum.
    inputs : ndarray, shape (N + 1, 2)
        Rotor speeds u_0 ... u_N at the knots [rad/s].
    durations : ndarray, shape (N,)
        Interval lengths h_1 ... h_N [s]; 0 for a jump of the speeds.
    constants : ndarray, shape (4,)
        Lumped constants [Rs, c1, r1, r3].
    max_step : float, optional
        Longest integration step [s].
    disturbance : Disturbance, optional
        Slope and imbalance.

    Returns
    -------
    ndarray, shape (N + 1, 9) or (N + 1, 6)
        x_0 ... x_N; poses from a pose.
    """
    state, durations = np.asarray(state, dtype=float), np.asarray(durations, dtype=float)
    solver = library()
    if solver is None:
        from sphere_nmpc.solver import plain  # loads CasADi

        torques = disturbance.as_array()
        start = np.concatenate((state, np.zeros(STATE_SIZE - state.size)))
        found = plain.shoot(start, torques, inputs, durations, constants, max_step).states
        return found[:, : state.size]
    n = durations.size
    kept: dict[Any, Any] = _WORKSPACES.__dict__
    workspace: _Workspace | None = kept.get(n)
    if workspace is None:
        workspace = kept[n] = _Workspace(n)
    workspace.constants[:] = constants
    workspace.torques[:2], workspace.torques[2:] = disturbance.slope, disturbance.imbalance
    workspace.durations[:] = durations
    size = state.size
    workspace.states[0, :size] = state
    workspace.states[0, size:] = 0.0
    workspace.inputs[:] = inputs
    solver.hold_roll_out(n, max_step, *workspace.addresses)
    return workspace.states[:, :size].copy()


def propagate(
    state: Vector,
    inputs: Vector,
    durations: Vector,
    constants: Vector,
    max_step: float = DEFAULT_MAX_STEP,
    disturbance: Disturbance = UNDISTURBED,
) -> Propagation:
    """Return the end of a first-order hold with its derivatives; the arguments of `roll_out`."""
    solver, torques = library(), disturbance.as_array()
    if solver is None:
        from sphere_nmpc.solver import plain

        end, found = plain.propagate(state, torques, inputs, durations, constants, max_step)
        return Propagation.of(end, found)
    end, found = state.copy(), np.empty((8, 15))
    inputs, durations = np.ascontiguousarray(inputs), np.ascontiguousarray(durations)
    arrays = (constants, torques, durations, inputs, end, found)
    solver.hold_propagate(durations.size, max_step, *(a.ctypes.data for a in arrays))
    return Propagation.of(end, found)


class _Workspace:
    """Arguments and results of a roll-out over N intervals, at addresses that are kept."""

    def __init__(self, intervals: int) -> None:
        n = intervals
        self.constants, self.torques, self.durations = np.empty(4), np.empty(5), np.empty(n)
        self.inputs, self.states = np.empty((n + 1, 2)), np.empty((n + 1, 9))
        arrays = (self.constants, self.torques, self.durations, self.inputs, self.states)
        self.addresses = [array.ctypes.data for array in arrays]
