# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""What a sample instant led to: the mode of the controller, its plan, and how far it is to go."""

from dataclasses import dataclass
from enum import Enum

import numpy as np

from sphere_nmpc.model.state import Vector
from sphere_nmpc.strategy.plan import Plan


class Mode(Enum):
    """What the controller is doing, and why it does nothing where it does nothing."""

    NO_CLOCK = "no clock yet"
    STANDSTILL = "the clock stands still"
    NO_POSE = "no pose yet"
    NO_GOAL = "no goal yet"
    DISABLED = "disabled"
    BLIND = "no fresh pose, ramping to rest"
    TRACKING = "on the way to the goal"
    AT_GOAL = "at the goal"
    FALLBACK = "solve failed, following the previous plan"


@dataclass(frozen=True, eq=False)
class Decision:
    """What a sample instant led to.

    Attributes
    ----------
    mode : Mode
        What the controller is doing.
    plan : Plan
        The plan, before it is joined to the speeds in force by `Controller.commit`.
    state : ndarray of shape (6,), or None
        State predicted to the sample instant; None while blind.
    error, position_error, angle_error : float
        Distance to the goal: in R^6, in the plane [m], and of orientation [rad]; nan if unknown.
    pose_age : float
        How old the newest pose was [s], negative for one from the future; inf without one.
    covariance : ndarray of shape (5, 5), or None
        Of the deviation of the true state from `state`: position [m; world frame], rotation
        vector [rad; body frame]. None where poses are trusted exactly.
    """

    mode: Mode
    plan: Plan
    state: Vector | None
    error: float = float("nan")
    position_error: float = float("nan")
    angle_error: float = float("nan")
    pose_age: float = float("inf")
    covariance: Vector | None = None

    @property
    def solved(self) -> bool:
        """Whether the plan is what the strategy found for this instant."""
        return self.mode in (Mode.TRACKING, Mode.AT_GOAL)

    @property
    def position_deviation(self) -> float:
        """Standard deviation of the position, root of the trace of its part [m]; 0 if trusted."""
        return _deviation(self.covariance, slice(0, 2))

    @property
    def angle_deviation(self) -> float:
        """Standard deviation of the orientation, likewise [rad]."""
        return _deviation(self.covariance, slice(2, 5))


def _deviation(covariance: Vector | None, part: slice) -> float:
    return 0.0 if covariance is None else float(np.sqrt(np.trace(covariance[part, part])))
