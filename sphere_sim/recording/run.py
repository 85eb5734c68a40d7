# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Recorded run as arrays."""

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import POSITION, QUATERNION, Vector, nearer_sign
from sphere_sim.evaluation.metrics import ERRORS, Metrics, errors_to, measure
from sphere_sim.evaluation.series import RobotSeries, Series
from sphere_sim.output.round_numbers import three_digits
from sphere_sim.world.walls import Walls


@dataclass(frozen=True, eq=False)
class Run(RobotSeries):
    """One run of one robot, to one goal or to several in turn.

    Times are in seconds since the first pose, or where `to_goal` has made the run since the goal.
    Its poses are the measured ones, or the true ones where odometry estimates the poses, without
    sign changes between consecutive quaternions.

    Attributes
    ----------
    name, path : str and Path
        Name of the run in legends, and the bag.
    goals : Series of Goal
        Goals, which do not move, from when they came into force; at least one pose follows each
        before the next.
    plans : Series of FirstOrderHold
        Rotor trajectories that the controller sent, by their starts, knot times in the run's time.
    solves : Series of ReportedSolve
        Solves that the controller reported, by their sampling instants.
    momentum, disturbances : Series
        Angular momentum about the contact point that the controller reported [N m s; world frame],
        shape (3,), zero where none was found; slope and imbalance in the units of the model.
    pushes : Series
        Impulses by which the simulated sphere was pushed [N s; world frame], shape (2,).
    floors, planned_clearances : Series
        Floors in force, a Grid or None where it was free; least distances between the sphere on
        its planned path and what is occupied that the controller reported [m].
    contacts : Series of int
        Numbers of the contacts with a wall, by when the simulator had counted them.
    estimates, estimate_errors : Series
        Poses that odometry estimated and the controller used, shape (6,), and their errors, shape
        (2,), see `metrics.estimate_errors`; empty where the true ones were not recorded.
    robot : RobotParameters
        Robot parameters of the controller, or the defaults where the bag does not have them.
    setup : str
        Strategy, robot and plant in words, see `setup_text`.
    notes : tuple of str
        Messages for users on what is missing or invalid in the bag.
    """

    name: str
    path: Path
    goals: Series = field(default_factory=Series)
    plans: Series = field(default_factory=Series)
    solves: Series = field(default_factory=Series)
    momentum: Series = field(default_factory=Series)
    disturbances: Series = field(default_factory=Series)
    pushes: Series = field(default_factory=Series)
    floors: Series = field(default_factory=Series)
    planned_clearances: Series = field(default_factory=Series)
    contacts: Series = field(default_factory=Series)
    estimates: Series = field(default_factory=Series)
    estimate_errors: Series = field(default_factory=Series)
    robot: RobotParameters = field(default_factory=RobotParameters)
    setup: str = ""
    notes: tuple[str, ...] = ()

    @property
    def has_momentum(self) -> bool:
        """Whether the sphere was pushed, or momentum was found."""
        return bool(np.any(self.momentum.values) or len(self.pushes))

    @property
    def has_floor(self) -> bool:
        """Whether anything was occupied at any time."""
        return any(grid is not None for grid in self.floors.values)

    @property
    def goal(self) -> Vector | None:
        """Pose nearest to the last state that the last goal allows; None without a goal.

        Of its two quaternions it has the nearer one.
        """
        if not self.goals:
            return None
        last = self.states[-1]
        return nearer_sign(self.goals.values[-1].nearest(last, 0.0), last)

    @cached_property
    def goal_errors(self) -> Vector:
        """The `ERRORS` at each pose to the goal in force, shape (n, 3); nan before the first."""
        found = np.full((self.times.size, len(ERRORS)), np.nan)
        for goal, here in self.goals.during(self.times):
            found[here] = errors_to(goal, self.states[here])
        return found

    @cached_property
    def clearances(self) -> Vector:
        """Distance between the sphere and what is occupied at each pose [m], shape (n,).

        It is nan where the floor was free.
        """
        found = np.full(self.times.size, np.nan)
        for grid, here in self.floors.during(self.times):
            if grid is not None and here.any():
                places = self.states[here][:, POSITION]
                found[here] = Walls(grid).distances(places) - self.robot.shell_radius
        return found

    def to_goal(self, number: int) -> "Run":
        """Return the run while the goal of a number, from 1 on, was in force."""
        starts = self.goals.times
        start = max(0.0, float(starts[number - 1]))
        end = float(starts[number]) if number < len(starts) else np.inf
        parts: dict[str, Any] = {
            name: one.between(start, end) for name, one in vars(self).items()
            if isinstance(one, Series)
        }
        moved = tuple(plan.delayed(-start) for plan in parts["plans"].values)
        parts["plans"] = replace(parts["plans"], values=moved)
        name = f"{self.name}, goal {number}" if len(starts) > 1 else self.name
        return replace(self, name=name, **parts)

    def metrics(self) -> Metrics | None:
        """Return the metrics of the run to the last goal; None without a goal."""
        if not self.goals:
            return None
        run = self.to_goal(len(self.goals))
        return measure(run, run.goals.values[0], run.solves.column("duration"))


def setup_text(strategy: str, radius: float, max_speed: float, plant: str) -> str:
    """Return strategy, radius of the shell [m], largest rotor speed [rad/s] and plant in words.

    Those that are empty or nan are unknown.
    """
    size = f"radius {three_digits(radius)} m" if math.isfinite(radius) else "of unknown size"
    limit = f", rotors up to {three_digits(max_speed)} rad/s" if math.isfinite(max_speed) else ""
    return f"strategy {strategy or 'unknown'}; robot {size}{limit}; plant {plant or 'unknown'}"


def without_sign_jumps(states: Vector) -> Vector:
    """Return the states (n, 6) with each quaternion of the sign nearer to the one before."""
    smooth: NDArray[np.float64] = states.copy()
    products = np.sum(states[1:, QUATERNION] * states[:-1, QUATERNION], axis=1)
    signs = np.cumprod(np.where(products < 0.0, -1.0, 1.0))
    smooth[1:, QUATERNION] *= signs[:, None]
    return smooth
