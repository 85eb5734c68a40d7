# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Bounded step of a low-rank model with a diagonal D, on CasADi's virtual machine.

As long as all accelerations are within their limit, no cost couples successive knots, and the
passes of `quadratic_model.bounded_step` are a few instructions on vectors.
"""

import threading
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from sphere_nmpc.model.state import Vector
from sphere_nmpc.model.symbolic_rotation import Expression
from sphere_nmpc.solver.numpy_backend.rounded_size import rounded_size

_MEMORY = threading.local()


@lru_cache(maxsize=128)
def _step_function(size: int, rows: int, passes: int) -> ca.Function:
    """Return the step and the solution of the small system for the arguments of `diagonal_step`.

    That solution is not finite where the system is not positive definite.
    """
    names = ("down", "up", "gradient", "partial_gradient", "diagonal")
    vectors = (ca.MX.sym(name, size) for name in names)
    down, up, gradient, partial_gradient, diagonal = vectors
    across, residual = ca.MX.sym("across", size, rows), ca.MX.sym("residual", rows)
    scalars = ca.MX.sym("scalars", 2)
    damping, weight = scalars[0], scalars[1]
    below, above = ca.logic_or(down < 0, gradient < 0), ca.logic_or(up > 0, gradient > 0)
    free = ca.logic_and(down < up, ca.logic_and(below, above))
    inverse = 1 / (diagonal + damping)
    floor = ca.MX(ca.DM.eye(rows)) / weight
    jacobian = across.T
    step = held = ca.MX(size, 1)
    solve = _cholesky_function(rows)
    multipliers = ca.MX(rows, 1)
    for _ in range(passes):
        free_inverse = free * inverse
        moved = across * ca.repmat(free_inverse, 1, rows)
        slope = partial_gradient + diagonal * held
        error = residual + ca.mtimes(jacobian, held) - ca.mtimes(moved.T, slope)
        multipliers = solve(ca.mtimes(jacobian, moved) + floor, error)
        found = held - free_inverse * (slope + ca.mtimes(across, multipliers))
        step = ca.fmin(ca.fmax(found, down), up)
        free = free * (step == found)
        held = (1 - free) * step
    inputs = [down, up, gradient, partial_gradient, diagonal, across, residual, scalars]
    return ca.Function("bounded_step", inputs, [step, multipliers])


@lru_cache(maxsize=2)
def _cholesky_function(size: int) -> ca.Function:
    """Return ``(A, b) -> A^-1 b`` for a symmetric positive definite A; not finite for others."""
    a, b = ca.SX.sym("a", size, size), ca.SX.sym("b", size)
    factor: list[list[Expression]] = []
    for i in range(size):
        row: list[Expression] = []
        for j in range(i + 1):
            other = row if i == j else factor[j]
            rest = a[i, j] - sum(row[k] * other[k] for k in range(j))
            row.append(ca.sqrt(rest) if i == j else rest / factor[j][j])
        factor.append(row)
    x: list[Expression] = []
    for i in range(size):
        x.append((b[i] - sum(factor[i][k] * x[k] for k in range(i))) / factor[i][i])
    for i in reversed(range(size)):
        x[i] = (x[i] - sum(factor[k][i] * x[k] for k in range(i + 1, size))) / factor[i][i]
    return ca.Function("cholesky", [a, b], [ca.vertcat(*x)])


class _Memory:
    """Arguments and results of a step function; variables beyond those in use are fixed."""

    def __init__(self, size: int, rows: int, passes: int) -> None:
        self.down, self.up, self.gradient, self.partial_gradient = np.zeros((4, size))
        self.diagonal, self.jacobian = np.ones(size), np.zeros((rows, size))
        self.residual, self.scalars = np.zeros(rows), np.zeros(2)
        self.step, self.multipliers = np.zeros(size), np.zeros(rows)
        self._buffer: Any
        self._buffer, self.run = _step_function(size, rows, passes).buffer()
        given = (
            self.down, self.up, self.gradient, self.partial_gradient, self.diagonal,
            self.jacobian, self.residual, self.scalars,
        )
        for i, argument in enumerate(given):
            self._buffer.set_arg(i, argument.data)
        for i, result in enumerate((self.step, self.multipliers)):
            self._buffer.set_res(i, result.data)


def diagonal_step(
    gradient: Vector, partial_gradient: Vector, diagonal: Vector, jacobian: Vector,
    residual: Vector, weight: float, damping: float, down: Vector, up: Vector, passes: int,
) -> Vector | None:
    """Return the bounded step; the parameters are those of `LowRankModel`, D being diagonal."""
    rows, size = jacobian.shape
    kept: dict[Any, Any] = _MEMORY.__dict__
    key = rounded_size(size), rows, passes
    if key not in kept:
        kept[key] = _Memory(*key)
    memory: _Memory = kept[key]
    memory.down[:size], memory.up[:size] = down, up
    memory.down[size:] = memory.up[size:] = 0.0
    memory.gradient[:size], memory.partial_gradient[:size] = gradient, partial_gradient
    memory.diagonal[:size], memory.jacobian[:, :size] = diagonal, jacobian
    memory.jacobian[:, size:] = 0.0
    memory.residual[:], memory.scalars[:] = residual, (damping, weight)
    memory.run()
    return memory.step[:size].copy() if np.isfinite(memory.multipliers.sum()) else None
