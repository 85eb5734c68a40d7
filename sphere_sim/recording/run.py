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

from sphere_nmpc.floor.occupancy import Grid
from sphere_nmpc.model.disturbance import UNDISTURBED, Disturbance
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.goal import Goal
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import POSE_SIZE, POSITION, QUATERNION, Vector, nearer_sign
from sphere_sim.evaluation.metrics import ERRORS, Metrics, errors_to, measure
from sphere_sim.output.round_numbers import three_digits
from sphere_sim.world.walls import Walls

_SAME_INSTANT = 1e-9
"""Rounding of the times of solves, which are reported as text [s]."""


@dataclass(frozen=True, eq=False)
class Solves:
    """Solves that the controller reported, m in number.

    They have sampling instants and solve times [s], values of the optimal control problem, the
    status of the plan after each, and the times until it reaches the goal [s]; nan where not
    reported.
    """

    times: Vector
    durations: Vector
    costs: Vector
    statuses: tuple[str, ...]
    to_go: Vector

    def between(self, start: float, end: float) -> "Solves":
        """Return the solves from `start` until before `end` [s], with times since `start`."""
        columns = self.durations, self.costs, self.statuses, self.to_go
        return Solves(*_section(start, end, self.times, *columns, rounding=_SAME_INSTANT))


@dataclass(frozen=True, eq=False)
class Momentum:
    """Angular momentum about the contact point that the controller reported, and the pushes.

    Attributes
    ----------
    times, values : ndarray, shapes (m,) and (m, 3)
        Times of the reports [s], and momentum [N m s; world frame]; zero where none was found.
    disturbances : tuple of Disturbance, length m
        Slope and imbalance in the units of the model.
    push_times, impulses : ndarray, shapes (p,) and (p, 2)
        Times at which the simulated sphere was pushed [s], and impulses [N s; world frame].
    """

    times: Vector = field(default_factory=lambda: np.empty(0))
    values: Vector = field(default_factory=lambda: np.empty((0, 3)))
    disturbances: tuple[Disturbance, ...] = ()
    push_times: Vector = field(default_factory=lambda: np.empty(0))
    impulses: Vector = field(default_factory=lambda: np.empty((0, 2)))

    @property
    def is_zero(self) -> bool:
        """Whether the sphere was not pushed, and no momentum was found."""
        return not (self.values.any() or self.push_times.size)

    def at(self, time: float) -> Vector:
        """Return the newest report at a time [s], shape (3,); nan before the first one."""
        index = newest(self.times, time)
        return np.full(3, np.nan) if index < 0 else np.array(self.values[index])

    def disturbance_at(self, time: float) -> Disturbance:
        """Return the newest disturbance reported at a time [s]."""
        index = newest(self.times, time)
        return self.disturbances[index] if index >= 0 else UNDISTURBED

    def between(self, start: float, end: float) -> "Momentum":
        """Return the reports and pushes from `start` until before `end` [s], likewise."""
        return Momentum(
            *_section(start, end, self.times, self.values, self.disturbances),
            *_section(start, end, self.push_times, self.impulses),
        )


@dataclass(frozen=True, eq=False)
class Floors:
    """Floors and clearances of plans that the controller reported, and contacts with walls.

    Attributes
    ----------
    times, grids : ndarray, shape (k,), and tuple of Grid or None, length k
        Times from which on floors were in force [s], and the floors; None where it was free.
    report_times, clearances : ndarray, shape (m,)
        Times of the reports [s], and least distances between the sphere on its planned path and
        what is occupied [m].
    contact_times : ndarray, shape (c,)
        Times by which the simulator had counted each contact with a wall [s].
    """

    times: Vector = field(default_factory=lambda: np.empty(0))
    grids: tuple[Grid | None, ...] = ()
    report_times: Vector = field(default_factory=lambda: np.empty(0))
    clearances: Vector = field(default_factory=lambda: np.empty(0))
    contact_times: Vector = field(default_factory=lambda: np.empty(0))

    @property
    def is_free(self) -> bool:
        """Whether nothing was occupied at any time."""
        return all(grid is None for grid in self.grids)

    def at(self, time: float) -> Grid | None:
        """Return the floor in force at a time [s]; None where it is free."""
        index = newest(self.times, time)
        return self.grids[index] if index >= 0 else None

    def clearance_at(self, time: float) -> float:
        """Return the newest reported clearance at a time [m]; nan before the first one."""
        index = newest(self.report_times, time)
        return float(self.clearances[index]) if index >= 0 else float("nan")

    def between(self, start: float, end: float) -> "Floors":
        """Return what was in force or reported from `start` until before `end` [s], likewise."""
        first = max(0, newest(self.times, start))
        last = int(np.searchsorted(self.times, end))
        return Floors(
            self.times[first:last] - start, self.grids[first:last],
            *_section(start, end, self.report_times, self.clearances),
            *_section(start, end, self.contact_times),
        )


@dataclass(frozen=True, eq=False)
class Estimates:
    """Poses that odometry estimated, m in number; none where the true ones were not recorded.

    They have times [s], states, shape (m, 6), and errors, shape (m, 2), see `estimate_errors`.
    """

    times: Vector = field(default_factory=lambda: np.empty(0))
    states: Vector = field(default_factory=lambda: np.empty((0, POSE_SIZE)))
    errors: Vector = field(default_factory=lambda: np.empty((0, 2)))

    def at(self, time: float) -> tuple[Vector | None, Vector]:
        """Return the newest estimate at a time [s] and its errors; None and nan before."""
        index = newest(self.times, time)
        if index < 0:
            return None, np.full(2, np.nan)
        return self.states[index], self.errors[index]

    def between(self, start: float, end: float) -> "Estimates":
        """Return the estimates from `start` until before `end` [s], likewise."""
        return Estimates(*_section(start, end, self.times, self.states, self.errors))


@dataclass(frozen=True, eq=False)
class Run:
    """One run of one robot, to one goal or to several in turn.

    Times are in seconds since the first pose, or where `to_goal` has made the run since the goal.

    Attributes
    ----------
    name, path : str and Path
        Name of the run in legends, and the bag.
    times, states : ndarray, shapes (n,) and (n, 6)
        Times of the poses [s], and measured states, or the true ones where odometry estimates the
        poses, without sign changes between consecutive quaternions.
    joint_times, rotor_speeds, rotor_torques : ndarray, shapes (m,), (m, 2) and (m, 2)
        Times of the joint states [s], speeds [rad/s] and torques [N m]; nan where not recorded.
    goal_times, goals : ndarray, shape (g,), and tuple of Goal, length g
        Times at which the goals came into force [s], ascending, and the goals, which do not move;
        at least one pose follows each before the next.
    plans : tuple of FirstOrderHold
        Rotor trajectories that the controller sent, knot times in the run's time.
    solves, momentum, floors : Solves, Momentum and Floors
        Solves and momentum that it reported, and pushes; floors, clearances and contacts.
    robot : RobotParameters
        Robot parameters of the controller, or the defaults where the bag does not have them.
    setup : str
        Strategy, robot and plant in words, see `setup_text`.
    notes : tuple of str
        Messages for users on what is missing or invalid in the bag.
    estimates : Estimates
        Poses by odometry, which the controller used.
    """

    name: str
    path: Path
    times: Vector
    states: Vector
    joint_times: Vector
    rotor_speeds: Vector
    rotor_torques: Vector
    goal_times: Vector
    goals: tuple[Goal, ...]
    plans: tuple[FirstOrderHold, ...]
    solves: Solves
    momentum: Momentum = field(default_factory=Momentum)
    floors: Floors = field(default_factory=Floors)
    robot: RobotParameters = field(default_factory=RobotParameters)
    setup: str = ""
    notes: tuple[str, ...] = ()
    estimates: Estimates = field(default_factory=Estimates)

    @property
    def goal(self) -> Vector | None:
        """Pose nearest to the last state that the last goal allows; None without a goal.

        Of its two quaternions it has the nearer one.
        """
        last = self.states[-1]
        return nearer_sign(self.goals[-1].nearest(last, 0.0), last) if self.goals else None

    def goal_at(self, time: float) -> Goal | None:
        """Return the goal in force at a time [s]; None before the first one."""
        index = newest(self.goal_times, time)
        return self.goals[index] if index >= 0 else None

    @cached_property
    def errors(self) -> Vector:
        """The `ERRORS` at each pose to the goal in force, shape (n, 3); nan before the first."""
        found = np.full((self.times.size, len(ERRORS)), np.nan)
        which = np.searchsorted(self.goal_times, self.times, side="right") - 1
        for i, goal in enumerate(self.goals):
            found[which == i] = errors_to(goal, self.states[which == i])
        return found

    @cached_property
    def clearances(self) -> Vector:
        """Distance between the sphere and what is occupied at each pose [m], shape (n,).

        It is nan where the floor was free.
        """
        found = np.full(self.times.size, np.nan)
        which = np.searchsorted(self.floors.times, self.times, side="right") - 1
        for i, grid in enumerate(self.floors.grids):
            here = which == i
            if grid is not None and here.any():
                places = self.states[here][:, POSITION]
                found[here] = Walls(grid).distances(places) - self.robot.shell_radius
        return found

    def to_goal(self, number: int) -> "Run":
        """Return the run while the goal of a number, from 1 on, was in force."""
        i = number - 1
        start = max(0.0, float(self.goal_times[i]))
        end = float(self.goal_times[number]) if number < len(self.goals) else np.inf
        times, states = _section(start, end, self.times, self.states)
        joint_times, speeds, torques = _section(
            start, end, self.joint_times, self.rotor_speeds, self.rotor_torques
        )
        return replace(
            self,
            name=f"{self.name}, goal {number}" if len(self.goals) > 1 else self.name,
            times=times, states=states,
            joint_times=joint_times, rotor_speeds=speeds, rotor_torques=torques,
            goal_times=self.goal_times[i:number] - start,
            goals=self.goals[i:number],
            plans=tuple(p.delayed(-start) for p in self.plans if start <= p.start < end),
            solves=self.solves.between(start, end),
            momentum=self.momentum.between(start, end),
            floors=self.floors.between(start, end),
            estimates=self.estimates.between(start, end),
        )

    def metrics(self) -> Metrics | None:
        """Return the metrics of the run to the last goal; None without a goal."""
        if not self.goals:
            return None
        run = self.to_goal(len(self.goals))
        return measure(
            run.times, run.states, run.goals[0], run.joint_times, run.rotor_speeds,
            run.rotor_torques, run.solves.durations,
        )


def setup_text(strategy: str, radius: float, max_speed: float, plant: str) -> str:
    """Return strategy, radius of the shell [m], largest rotor speed [rad/s] and plant in words.

    Those that are empty or nan are unknown.
    """
    size = f"radius {three_digits(radius)} m" if math.isfinite(radius) else "of unknown size"
    limit = f", rotors up to {three_digits(max_speed)} rad/s" if math.isfinite(max_speed) else ""
    return f"strategy {strategy or 'unknown'}; robot {size}{limit}; plant {plant or 'unknown'}"


def _section(
    start: float, end: float, times: Vector, *columns: Any, rounding: float = 0.0
) -> list[Any]:
    """Return the times from `start` until before `end`, counted from it, and their columns."""
    kept = np.flatnonzero((times >= start - rounding) & (times < end - rounding))
    return [
        times[kept] - start,
        *(tuple(it[i] for i in kept) if isinstance(it, tuple) else it[kept] for it in columns),
    ]


def newest(times: Vector, time: float) -> int:
    """Return the index of the newest of ascending times at a time; -1 before the first one."""
    return int(np.searchsorted(times, time, side="right")) - 1


def without_sign_jumps(states: Vector) -> Vector:
    """Return the states (n, 6) with each quaternion of the sign nearer to the one before."""
    smooth: NDArray[np.float64] = states.copy()
    products = np.sum(states[1:, QUATERNION] * states[:-1, QUATERNION], axis=1)
    signs = np.cumprod(np.where(products < 0.0, -1.0, 1.0))
    smooth[1:, QUATERNION] *= signs[:, None]
    return smooth
