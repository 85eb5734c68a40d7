# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Result of a sampling instant: mode of the controller, plan, and distance to the goal."""

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from functools import cached_property

import numpy as np

from sphere_nmpc.model.disturbance import UNDISTURBED, Disturbance
from sphere_nmpc.model.state import NO_MOMENTUM, Vector, angle_error, position_error, state_error
from sphere_nmpc.strategy.plan import Plan


class Mode(Enum):
    """Operating mode of the controller; where it does not move the robot, the reason."""

    NO_CLOCK = "no clock yet"
    CLOCK_STOPPED = "the clock stands still"
    CLOCK_JUMPED = "the clock jumps, nothing is sent"
    NO_POSE = "no pose yet"
    NO_GOAL = "no goal"
    DISABLED = "disabled"
    NO_FRESH_POSE = "no fresh pose, stopping"
    POSE_JUMPED = "the pose has jumped, stopping"
    TRACKING = "on the way to the goal"
    AT_GOAL = "at the goal"
    NO_PROGRESS = "no progress towards the goal"
    SATURATED = "the rotors cannot hold the momentum"
    FALLBACK = "solve failed, following the previous plan"


_SOLVED = (Mode.TRACKING, Mode.AT_GOAL, Mode.NO_PROGRESS, Mode.SATURATED)


@dataclass(frozen=True, eq=False)
class Decision:
    """Result of a sampling instant.

    Attributes
    ----------
    mode : Mode
        Operating mode.
    plan : Plan
        The plan, before it is joined to the speeds in force by `Controller.commit`.
    state : ndarray of shape (9,), or None
        State estimated for the sampling instant; None without a fresh pose.
    goal : ndarray of shape (6,), or None
        Goal that is aimed at; of a set the member that is nearest to the state.
    pose_age : float
        Age of the newest pose [s], negative for one from the future; inf without one.
    covariance : ndarray of shape (5, 5), or None
        Covariance of the error state: position [m; world frame], rotation vector [rad; body
        frame]. None where poses are trusted exactly.
    momentum : ndarray, shape (3,)
        Estimated momentum, also without a fresh pose [rad/s; world frame].
    disturbance : Disturbance
        Estimated slope and imbalance.
    no_progress : str
        For how long the sphere has stood away from its goal, and why; empty where it has not.
    is_new : bool
        Whether the plan was made at this instant, rather than kept.
    """

    mode: Mode
    plan: Plan
    state: Vector | None
    goal: Vector | None = None
    pose_age: float = float("inf")
    covariance: Vector | None = None
    momentum: Vector = field(default_factory=lambda: NO_MOMENTUM)
    disturbance: Disturbance = UNDISTURBED
    no_progress: str = ""
    is_new: bool = True

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
        return self.plan.solve_time if self.is_new else 0.0

    @property
    def solved(self) -> bool:
        """Whether the plan is the solution of the strategy for this instant."""
        return self.mode in _SOLVED

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
