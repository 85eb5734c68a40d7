# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The compiled solver and its quadratic model."""

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


def expand_compiled(problem: HoldProblem, start: Vector) -> dict[str, Vector | float]:
    """Return the quadratic model of the compiled solver at `start` [rad/s].

    It has ``cost``; ``gradient`` (2 N,) and ``hessian`` (2 N, 2 N) by scaled inputs; ``states``
    (N + 1, 9); ``sensitivities`` (N + 1, 6, 2 N) per rad/s.
    """
    n = problem.intervals
    slot = Slot(compiled(), n)
    slot.write_settings(SolverSettings())
    slot.write(problem, start, np.inf)
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
