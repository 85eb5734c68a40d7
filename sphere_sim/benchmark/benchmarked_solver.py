# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Interface of the solvers that are benchmarked."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from sphere_nmpc.model.state import Vector


@dataclass(frozen=True, eq=False)
class Answer:
    """Result of a solve at a sampling instant.

    Attributes
    ----------
    speeds : ndarray, shape (2,)
        Rotor speeds at the next sampling instant [rad/s].
    solved : bool
        Whether the solver itself reports success.
    took : (float, float) or None
        Wall and processor time of the solve [s] measured in another process, where the solve is
        made; None where it is made in the calling process.
    """

    speeds: Vector
    solved: bool
    took: tuple[float, float] | None = None


class BenchmarkedSolver(Protocol):
    """A solver in a receding horizon, which keeps its own warm start."""

    def start(self, goal: Vector) -> None:
        """Start a run towards `goal`, shape (6,), without a warm start."""
        ...

    def solve(self, state: Vector, input_in_force: Vector) -> Answer:
        """Return the next rotor speeds from `state`, (6,), and the present ones, (2,) [rad/s]."""
        ...


Maker = Callable[[], BenchmarkedSolver]
"""Sets a solver up; raises ModuleNotFoundError where its package is not installed."""
