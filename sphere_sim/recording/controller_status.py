# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Values of the controller's status messages."""

from collections.abc import Mapping
from dataclasses import dataclass

HOLDING = "holding"
"""Status of a plan that has reached the goal and holds the sphere there."""


@dataclass(frozen=True)
class SolveStatus:
    """Solve of one control sample as a status message reports it; nan where it does not.

    Attributes
    ----------
    time : float
        Sampling instant [s].
    duration : float
        Solve time [s]; 0 where nothing was solved.
    cost : float
        Value of the optimal control problem.
    arrival : float
        Time at which the plan reaches the goal [s].
    plan : str
        Status of the plan; empty without a plan.
    """

    time: float
    duration: float
    cost: float
    arrival: float
    plan: str

    @property
    def time_to_go(self) -> float:
        """Time from the sampling instant until the plan reaches the goal [s]."""
        return self.arrival - self.time


def solve_status(values: Mapping[str, str]) -> SolveStatus:
    """Return the solve that the key-value pairs of a status message report."""
    return SolveStatus(
        _number(values, "time_s"), _number(values, "solve_time_s"), _number(values, "cost"),
        _number(values, "arrival_s"), values.get("plan", ""),
    )


def _number(values: Mapping[str, str], key: str) -> float:
    try:
        return float(values.get(key, "nan"))
    except ValueError:
        return float("nan")
