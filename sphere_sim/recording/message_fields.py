# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Values of the controller's status."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sphere_nmpc.model.disturbance import Disturbance, imbalance_of_offset, slope_torque
from sphere_nmpc.model.goal import Orientation
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector

LARGEST = 1e30
"""Largest magnitude of a number that is believed [SI units]: its square is one, too."""
_MOST_GOALS = 1e6
"""Largest number of goals that is believed."""
CLEARANCE = "clearance_m"
"""Key of the least distance between the sphere on its planned path and what is occupied [m]."""
POSE_TOPIC = "pose_topic"
"""Key of the full name of the topic from which the controller has its poses."""
CONTACTS = ": commands", "wall touched"
"""End of the name of a simulator's status in diagnostics, and key of its contacts so far."""
HOLDING = "holding"
"""Status of a plan that has reached the goal and holds the sphere there."""


def known(number: float) -> float:
    """Return a number of a message; nan, as for an unknown one, where it is beyond `LARGEST`."""
    return float(number) if abs(number) <= LARGEST else float("nan")


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


def reported_solve(values: Mapping[str, str]) -> ReportedSolve:
    """Return the solve that the key-value pairs of a status message report."""
    return ReportedSolve(
        number(values, "solve_time_s"), number(values, "cost"),
        number(values, "arrival_s") - number(values, "time_s"), values.get("plan", ""),
    )


@dataclass(frozen=True)
class ReportedProgress:
    """Progress of the sphere through its goals as a status message reports it.

    It has the stamp of the message that brought the goals, as text and empty without a goal; the
    goal aimed at, from 0 on, and the number of goals; the time [s] and the length of the path [m]
    to that one, nan where they are unknown.
    """

    stamp: str = ""
    index: int = 0
    count: int = 0
    time_left: float = math.nan
    distance_left: float = math.nan


def reported_progress(values: Mapping[str, str]) -> ReportedProgress:
    """Return the progress that the key-value pairs of a status message report."""
    index, count = (number(values, f"goal_{name}") for name in ("index", "count"))
    known_goal = 0.0 <= index < count <= _MOST_GOALS
    return ReportedProgress(
        values.get("goal_stamp", ""),
        int(index) if known_goal else 0, int(count) if known_goal else 0,
        number(values, "time_left_s"), number(values, "distance_left_m"),
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
