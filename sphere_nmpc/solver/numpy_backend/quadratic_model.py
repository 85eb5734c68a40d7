# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Quadratic models g^T s + s^T H s / 2 of a cost, and their minimisers within bounds."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dposv, dptsv

from sphere_nmpc.model.state import Vector
from sphere_nmpc.solver.numpy_backend.diagonal_step import diagonal_step

Mask = NDArray[np.bool_]

BOUND_PASSES = 4
"""Largest number of solves for one step, each with more components fixed at their bounds."""


class QuadraticModel(Protocol):
    """Interface of the models to the iteration."""

    gradient: Vector

    def step(self, damping: float, free: Mask, held: Vector) -> Vector | None:
        """Minimise the model with `damping` added to H's diagonal.

        Parameters
        ----------
        damping : float
            Levenberg-Marquardt parameter.
        free : ndarray of bool, shape (n,)
            The components to minimise over.
        held : ndarray, shape (n,)
            Values of the fixed components; zero at the free ones.

        Returns
        -------
        ndarray, shape (n,), or None
            All components of the step; None where the matrix is singular to working precision.
        """
        ...

    def decrease(self, step: Vector) -> float:
        """Return the decrease that the model, without damping, predicts for a step, shape (n,)."""
        ...

    def bounded_step(self, damping: float, down: Vector, up: Vector) -> Vector | None:
        """Return the step, shape (n,), as `bounded_step` finds it, or None as in `step`."""
        ...


def bounded_step(
    model: QuadraticModel, damping: float, down: Vector, up: Vector
) -> Vector | None:
    """Minimise the damped model over steps between `down` (<= 0) and `up` (>= 0), shape (n,).

    Active set: components at a bound whose gradient points outward are fixed there. Components
    that the step would move across a bound are then fixed at it, and the step is solved again.
    """
    gradient = model.gradient
    free = (down < up) & ((down < 0.0) | (gradient < 0.0)) & ((up > 0.0) | (gradient > 0.0))
    step: Vector = np.zeros(gradient.size)
    held: Vector = step
    for _ in range(BOUND_PASSES):
        if not free.any():
            break
        found = model.step(damping, free, held)
        if found is None:
            return None
        step = np.minimum(np.maximum(found, down), up)
        crossed = free & (step != found)
        if not crossed.any():
            break
        free &= ~crossed
        held = np.where(free, 0.0, step)
    return step


class DenseModel:
    """A model with a Hessian as one matrix.

    Attributes
    ----------
    gradient : ndarray, shape (n,)
    hessian : ndarray, shape (n, n)
    """

    def __init__(self, gradient: Vector, hessian: Vector) -> None:
        self.gradient, self.hessian = gradient, hessian

    def step(self, damping: float, free: Mask, held: Vector) -> Vector | None:
        """Minimise the damped model over the free components; see `QuadraticModel`."""
        right = -(self.gradient + self.hessian @ held) * free
        matrix = self.hessian * np.outer(free, free)
        matrix.reshape(-1)[:: right.size + 1] += np.where(free, damping, 1.0)
        _, step, info = dposv(matrix, right, lower=1)
        return None if info else step + held

    def bounded_step(self, damping: float, down: Vector, up: Vector) -> Vector | None:
        """Return the step within bounds; see `QuadraticModel`."""
        return bounded_step(self, damping, down, up)

    def decrease(self, step: Vector) -> float:
        """Return the predicted decrease; see `QuadraticModel`."""
        return -float(self.gradient @ step + 0.5 * step @ (self.hessian @ step))


class LowRankModel:
    """A model with H = w J^T J + D, J having few rows and D being tridiagonal.

    H is never formed: a step solves a system with D and one of the size of J's rows (Woodbury's
    formula).

    Parameters
    ----------
    partial_gradient : ndarray, shape (n,)
        Gradient without the part w J^T r.
    diagonal, subdiagonal : ndarray, shape (n,) and (n - 1,)
        Diagonal and first subdiagonal of D.
    jacobian : ndarray, shape (r, n)
        J.
    residual : ndarray, shape (r,)
        r.
    weight : float
        w, positive.
    """

    def __init__(
        self, partial_gradient: Vector, diagonal: Vector, subdiagonal: Vector, jacobian: Vector,
        residual: Vector, weight: float,
    ) -> None:
        self.gradient = partial_gradient + weight * (residual @ jacobian)
        self._partial_gradient = partial_gradient
        self._diagonal, self._subdiagonal = diagonal, subdiagonal
        self._jacobian, self._residual, self._weight = jacobian, residual, weight
        self._floor = np.eye(residual.size) / weight
        self._right = np.empty((jacobian.shape[0] + 1, partial_gradient.size))

    def step(self, damping: float, free: Mask, held: Vector) -> Vector | None:
        """Minimise the damped model over the free components; see `QuadraticModel`."""
        right, residual = self._right, self._residual
        right[:-1], right[-1] = self._jacobian, self._partial_gradient
        if held.any():
            right[-1] += self._banded(held)
            residual = residual + self._jacobian @ held
        right *= free
        *_, solved, info = dptsv(
            np.where(free, self._diagonal + damping, 1.0),
            self._subdiagonal * (free[1:] & free[:-1]),
            right.T,
        )
        if info:
            return None
        inner = self._jacobian @ solved
        matrix = inner[:, :-1]
        _, multipliers, info = dposv(matrix + self._floor, residual - inner[:, -1], lower=1)
        if info:
            return None
        step: Vector = held - solved[:, -1] - solved[:, :-1] @ multipliers
        return step

    def bounded_step(self, damping: float, down: Vector, up: Vector) -> Vector | None:
        """Return the step within bounds; see `QuadraticModel`."""
        if self._subdiagonal.any():
            return bounded_step(self, damping, down, up)
        return diagonal_step(
            self.gradient, self._partial_gradient, self._diagonal, self._jacobian,
            self._residual, self._weight, damping, down, up, BOUND_PASSES,
        )

    def decrease(self, step: Vector) -> float:
        """Return the predicted decrease; see `QuadraticModel`."""
        end = self._jacobian @ step
        square = self._weight * float(end @ end) + float(step @ self._banded(step))
        return -float(self.gradient @ step) - 0.5 * square

    def _banded(self, step: Vector) -> Vector:
        product = self._diagonal * step
        product[1:] += self._subdiagonal * step[:-1]
        product[:-1] += self._subdiagonal * step[1:]
        return product
