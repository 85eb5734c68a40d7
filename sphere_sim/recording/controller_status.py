# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Values of the controller's status messages."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sphere_nmpc.model.drift import Drift, imbalance_of_offset, slope_torque
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector
from sphere_sim.recording.message_fields import known

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
        number(values, "time_s"), number(values, "solve_time_s"), number(values, "cost"),
        number(values, "arrival_s"), values.get("plan", ""),
    )


def reported_momentum(values: Mapping[str, str]) -> Vector:
    """Return the momentum that a status reports [N m s; world frame], shape (3,).

    It is zero where the controller finds none, and nan where it does not report any.
    """
    return np.array([number(values, f"momentum_{axis}") for axis in "xyz"])


def reported_drift(values: Mapping[str, str], robot: RobotParameters) -> Drift | None:
    """Return the drift that a status of the controller of this robot reports; None without one."""
    direction = math.radians(number(values, "slope_direction_deg"))
    offset = np.array([number(values, f"mass_offset_{axis}_mm") for axis in "xyz"])
    drift = Drift(
        reported_momentum(values) / robot.rotor_axial_inertia,
        slope_torque(robot, math.radians(number(values, "slope_deg")), direction),
        imbalance_of_offset(robot, 1e-3 * offset),
    )
    return drift if np.all(np.isfinite(drift.as_array())) else None


def number(values: Mapping[str, str], key: str) -> float:
    """Return a value as a number; nan where it is missing, none, or beyond `LARGEST`."""
    try:
        return known(float(values.get(key, "nan")))
    except ValueError:
        return float("nan")
