# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The compiled solver and its models."""

import ctypes

import numpy as np

from sphere_nmpc.model.state import Vector
from sphere_nmpc.solver.native.library import Slot, library
from sphere_nmpc.solver.problem import HoldProblem, SolverSettings


def compiled() -> ctypes.CDLL:
    """Return the compiled solver, which tests require."""
    found = library()
    assert found is not None, "the solver is not built: make venv"
    return found


def _slot(problem: HoldProblem, start: Vector) -> Slot:
    """Return the memory of a problem with the initial guess `start` [rad/s]."""
    slot = Slot(compiled(), problem.intervals)
    slot.write_settings(SolverSettings())
    slot.write(problem, start, np.inf)
    return slot


def expand_compiled(problem: HoldProblem, start: Vector) -> dict[str, Vector | float]:
    """Return the quadratic model of the compiled solver at `start` [rad/s].

    It has ``cost``; ``gradient`` (2 N,) and ``hessian`` (2 N, 2 N) by scaled inputs; ``states``
    (N + 1, 9); ``sensitivities`` (N + 1, 6, 2 N) per rad/s.
    """
    n = problem.intervals
    slot = _slot(problem, start)
    gradient, hessian = np.zeros(2 * n), np.zeros((2 * n, 2 * n))
    sensitivities = np.zeros((n + 1, 6, 2 * n))
    outputs = (array.ctypes.data for array in (gradient, hessian, sensitivities))
    compiled().hold_expand(slot.address, *outputs)
    found = slot.read()
    return {
        "cost": found.cost,
        "gradient": gradient,
        "hessian": hessian,
        "states": found.states,
        "sensitivities": sensitivities / problem.input_scale,
    }


def expand_compiled_error(problem: HoldProblem, start: Vector) -> tuple[Vector, Vector, Vector]:
    """Return the terminal error of a minimum-time problem at `start` [rad/s], shape (8,).

    With its derivatives by scaled inputs, (8, 2 N), and by the logarithm of the duration, (8,).
    """
    n = problem.intervals
    slot = _slot(problem, start)
    error, by_knots, by_duration = np.zeros(8), np.zeros((2 * n, 8)), np.zeros(8)
    outputs = (array.ctypes.data for array in (error, by_knots, by_duration))
    compiled().hold_expand_error(slot.address, *outputs)
    return error, by_knots.T, by_duration
