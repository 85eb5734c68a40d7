# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The answer of a strategy at a sample instant."""

from dataclasses import dataclass
from enum import Enum

from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.state import Vector


class PlanStatus(Enum):
    """How far a plan can be trusted."""

    SOLVED = "solved"
    BEST_SO_FAR = "best so far"
    """The search was cut short; the plan is sound but not optimal."""
    HOLDING = "holding"
    """At the goal: nothing to do but to rest."""
    FALLBACK = "fallback"
    """The solve failed and the rest of the previous plan is followed."""
    RAMP_TO_REST = "ramp to rest"
    """Nothing better is known than to stop the rotors."""


@dataclass(frozen=True, eq=False)
class Plan:
    """Rotor speeds from now on and where they are expected to lead.

    Attributes
    ----------
    status : PlanStatus
        Where the plan comes from.
    hold : FirstOrderHold
        Rotor speeds [rad/s]; knot times in control time [s], the first at the sample instant.
    states : ndarray, shape (K, 6)
        Predicted states at the knots of `hold`.
    arrival : float
        Control time at which the goal is reached [s]; nan where the strategy does not know.
    cost : float
        Value of the optimal control problem, in the strategy's own units; nan where none.
    iterations : int
        Solver iterations spent.
    kkt_residual : float
        First-order optimality of the solution; nan where none.
    solve_time : float
        Wall time spent [s], steady clock.
    message : str
        One line for people: why the status is what it is.
    """

    status: PlanStatus
    hold: FirstOrderHold
    states: Vector
    arrival: float = float("nan")
    cost: float = float("nan")
    iterations: int = 0
    kkt_residual: float = float("nan")
    solve_time: float = 0.0
    message: str = ""
