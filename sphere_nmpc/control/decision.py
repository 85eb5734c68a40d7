# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Result of a sampling instant: how things stand, plan, and distance to the goal."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from sphere_nmpc.model.disturbance import UNDISTURBED, Disturbance
from sphere_nmpc.model.state import NO_MOMENTUM, Vector, angle_error, position_error, state_error
from sphere_nmpc.reporting.conditions import Condition, Kind
from sphere_nmpc.strategy.plan import Plan

_SOLVED = (Kind.TRACKING, Kind.AT_GOAL, Kind.NO_PROGRESS, Kind.SATURATED)


@dataclass(frozen=True, eq=False)
class Decision:
    """Result of a sampling instant."""

    conditions: tuple[Condition, ...]
    """How things stand; the first one is the mode."""
    plan: Plan
    """The plan, before it is joined to the speeds in force by `Controller.commit`."""
    state: Vector | None
    """State estimated for the sampling instant, shape (9,); None without a fresh pose."""
    goal: Vector | None = None
    """Goal that is aimed at, shape (6,); of a set the member that is nearest to the state."""
    pose_age: float = float("inf")
    """Age of the newest pose [s], negative for one from the future; inf without one."""
    covariance: Vector | None = None
    """Covariance of the error state, shape (5, 5): position [m; world frame], rotation vector
    [rad; body frame]. None where poses are trusted exactly."""
    momentum: Vector = field(default_factory=lambda: NO_MOMENTUM)
    """Estimated momentum, also without a fresh pose [rad/s; world frame], shape (3,)."""
    disturbance: Disturbance = UNDISTURBED
    """Estimated slope and imbalance."""
    is_new: bool = True
    """Whether the plan was made at this instant, rather than kept."""

    @cached_property
    def mode(self) -> Kind:
        """Operating mode; where it does not move the robot, the reason."""
        return self.conditions[0].kind

    @cached_property
    def solved(self) -> bool:
        """Whether the plan is the solution of the strategy for this instant."""
        return self.conditions[0].kind in _SOLVED

    @cached_property
    def error(self) -> float:
        """Distance of the state to the goal in R^6; nan if unknown."""
        return self._distance(state_error)

    @property
    def position_error(self) -> float:
        """Distance of the state to the goal in the plane [m]; nan if unknown."""
        return self._distance(position_error)

    @property
    def angle_error(self) -> float:
        """Angle between the orientations of state and goal [rad]; nan if unknown."""
        return self._distance(angle_error)

    @property
    def solve_time(self) -> float:
        """Wall time that was spent on the plan at this instant [s], steady clock."""
        return self.plan.made.solve_time if self.is_new else 0.0

    @property
    def position_deviation(self) -> float:
        """Standard deviation of the position, root of the trace of its part [m]; 0 if trusted."""
        return _deviation(self.covariance, slice(0, 2))

    @property
    def angle_deviation(self) -> float:
        """Standard deviation of the orientation, likewise [rad]."""
        return _deviation(self.covariance, slice(2, 5))

    def _distance(self, distance: Callable[[Vector, Vector], float]) -> float:
        if self.state is None or self.goal is None:
            return float("nan")
        return distance(self.state, self.goal)


def _deviation(covariance: Vector | None, part: slice) -> float:
    return 0.0 if covariance is None else float(np.sqrt(np.trace(covariance[part, part])))
