# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Values of the controller's status, and the topic of true poses."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sphere_nmpc.model.disturbance import Disturbance, imbalance_of_offset, slope_torque
from sphere_nmpc.model.goal import Orientation
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector
from sphere_nmpc.quantities import known

CLEARANCE = "clearance_m"
"""Key of the least distance between the sphere on its planned path and what is occupied [m]."""
POSE_TOPIC = "pose_topic"
"""Key of the full name of the topic from which the controller has its poses."""
TRUE_POSE = "ground_truth/pose"
"""Topic of the simulator's poses where `pose` has those that odometry estimates."""
CONTACTS = ": commands", "wall touched"
"""End of the name of a simulator's status in diagnostics, and key of its contacts so far."""
HOLDING = "holding"
"""Status of a plan that has reached the goal and holds the sphere there."""


@dataclass(frozen=True)
class ReportedSolve:
    """Solve of one control sample as a status message reports it; nan where it does not.

    It has its duration [s], 0 where nothing was solved, the value of the optimal control problem,
    the time from the sampling instant until the plan reaches the goal [s], and the status of the
    plan, empty without one.
    """

    duration: float
    cost: float
    time_to_go: float
    plan: str


NO_SOLVE = ReportedSolve(math.nan, math.nan, math.nan, "")
"""What is known before the first solve."""


def reported_solve(values: Mapping[str, str]) -> ReportedSolve:
    """Return the solve that the key-value pairs of a status message report."""
    return ReportedSolve(
        number(values, "solve_time_s"), number(values, "cost"),
        number(values, "arrival_s") - number(values, "time_s"), values.get("plan", ""),
    )


def reported_orientation(values: Mapping[str, str]) -> Orientation:
    """Return what a status says that its goal demands of the orientation; all if it does not."""
    try:
        return Orientation(values.get("goal_orientation", ""))
    except ValueError:
        return Orientation.FULL


def reported_momentum(values: Mapping[str, str]) -> Vector:
    """Return the momentum that a status reports [N m s; world frame], shape (3,).

    It is zero where the controller finds none, and nan where it does not report any.
    """
    return np.array([number(values, f"momentum_{axis}") for axis in "xyz"])


def reported_disturbance(
    values: Mapping[str, str], robot: RobotParameters
) -> Disturbance | None:
    """Return the disturbance in a status of the controller of this robot; None without one."""
    direction = math.radians(number(values, "slope_direction_deg"))
    offset = np.array([number(values, f"mass_offset_{axis}_mm") for axis in "xyz"])
    disturbance = Disturbance(
        slope_torque(robot, math.radians(number(values, "slope_deg")), direction),
        imbalance_of_offset(robot, 1e-3 * offset),
    )
    return disturbance if np.all(np.isfinite(disturbance.as_array())) else None


def number(values: Mapping[str, str], key: str) -> float:
    """Return a value as a number; nan where it is missing, none, or beyond `LARGEST`."""
    try:
        return known(float(values.get(key, "nan")))
    except ValueError:
        return float("nan")
