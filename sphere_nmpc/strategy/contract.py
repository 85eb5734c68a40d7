# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Contract between a strategy and the control loop, and strategies by name."""

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Protocol, runtime_checkable

from sphere_nmpc.errors import InvalidParameterError, SphereNmpcError, reason_of
from sphere_nmpc.floor.floor import Floor
from sphere_nmpc.model.disturbance import UNDISTURBED, Disturbance
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.goal import STANDING, Goal, Orientation, moved
from sphere_nmpc.model.parameters import LumpedConstants, RobotParameters
from sphere_nmpc.model.state import MOMENTUM, Vector
from sphere_nmpc.settings import STRATEGIES, ControllerSettings
from sphere_nmpc.strategy.plan import Plan
from sphere_nmpc.worker.contract import Worker

SMALL_MOMENTUM = 1.0
"""Momentum [rad/s] that is small. A sphere with less rolls steadily, rests and stops on its path
as one without, no rotor has to be ramped to hold it before the sphere counts as resting, and a
plan for a momentum that differs by less can still be followed."""


@dataclass(frozen=True, eq=False)
class Situation:
    """Inputs of a strategy at a sampling instant.

    Attributes
    ----------
    time : float
        Sampling instant, control time [s].
    state : ndarray, shape (9,)
        State at that instant, predicted from the newest measurement.
    goal : ndarray, shape (6,)
        Goal state; where `orientation` leaves something free, a member of the set of goals.
    input_in_force : ndarray, shape (2,)
        Rotor speeds at that instant [rad/s].
    constants : LumpedConstants
        Estimated constants of the plant at that instant.
    noise : float
        Estimated process noise: standard deviation of each state in a sample period [m, -].
    uncertainty : float
        Standard deviation of the error of `state` in R^6.
    time_budget : float
        Wall time that planning may take [s]; a strategy then returns the best plan found.
    disturbance : Disturbance
        Estimated slope and imbalance.
    acceleration : float
        Rotor acceleration that the drives attain [rad/s^2], where less than their limit.
    slippery : bool
        Whether the sphere has slipped recently.
    orientation : Orientation
        What the goal demands of the orientation.
    goal_rate : ndarray, shape (5,)
        Rate of change of the goal, an error of a pose by time [m/s, rad/s]; 0 where it stands.
    floor : Floor
        What the sphere has to stay clear of; `Floor.EMPTY` where there is nothing.
    place_deviation : float
        Standard deviation of the error of the position [m].
    in_force : FirstOrderHold or None
        The newest command sent, which is followed to its end without another; None before it.
    """

    time: float
    state: Vector
    goal: Vector
    input_in_force: Vector
    constants: LumpedConstants
    noise: float = 0.0
    uncertainty: float = 0.0
    time_budget: float = float("inf")
    disturbance: Disturbance = UNDISTURBED
    acceleration: float = float("inf")
    slippery: bool = False
    orientation: Orientation = Orientation.FULL
    goal_rate: Vector = field(default_factory=lambda: STANDING)
    floor: Floor = Floor.EMPTY
    place_deviation: float = 0.0
    in_force: FirstOrderHold | None = None

    @property
    def radius(self) -> float:
        """Radius in force [m]: the larger one of built and learnt, which nothing may be within."""
        return max(self.floor.radius, self.constants.shell_radius)

    @property
    def least_distance(self) -> float:
        """Least distance of the sphere's centre from what is occupied [m].

        A sphere that is found to be larger than it was built uses up the clearance first, as there
        may be no other way; a goal is not refused where the learnt radius varies by less.
        """
        return max(self.floor.needed, self.radius)

    @property
    def momentum(self) -> Vector:
        """Estimated momentum at that instant, shape (3,) [rad/s; world frame]."""
        return self.state[MOMENTUM]

    @cached_property
    def has_small_momentum(self) -> bool:
        """Whether the momentum is small, together with what is added in the next second."""
        disturbance = self.disturbance
        return sum(map(_length, (
            self.momentum, disturbance.slope, disturbance.imbalance
        ))) < SMALL_MOMENTUM

    @property
    def is_out_of_balance(self) -> bool:
        """Whether plans end without momentum along the body's z axis by an imbalance."""
        return _length(self.disturbance.imbalance) >= SMALL_MOMENTUM

    def aim(self, pose: Vector) -> Goal:
        """Return the goal at a member of the set, shape (6,), for a plan from time 0 (now) on."""
        return Goal(pose, self.orientation, self.goal_rate)

    def goal_after(self, elapsed: float, goal: Vector | None = None) -> Vector:
        """Return where the goal, or another member of the set, is after a time [s], shape (6,)."""
        return moved(self.goal if goal is None else goal, self.goal_rate, elapsed)


def _length(vector: Vector) -> float:
    """Return the length of three numbers, for which a norm by NumPy takes twice as long."""
    return math.sqrt(vector.dot(vector))


class Strategy(Protocol):
    """Planner of rotor speeds at sampling instants, with its last plan as a warm start."""

    def plan(self, situation: Situation) -> Plan:
        """Return the plan from `situation.time` on; if it raises, the loop uses its fall-back."""

    def change(self, settings: ControllerSettings) -> None:
        """Use other settings from the next plan on; the plan and the warm starts are kept.

        Called between two plans when a parameter changes while the controller runs, never with
        another strategy name or sample period: for those a new strategy is made.
        """

    def reset(self) -> None:
        """Forget warm starts and plans, as after a new goal: the strategy then acts like new."""


@runtime_checkable
class SearchingStrategy(Protocol):
    """Strategy that can search beside the control loop."""

    def search_beside(self, worker: Worker) -> None:
        """Search by a worker from now on; a new goal then needs no `Strategy.reset`."""

    @property
    def searches(self) -> bool:
        """Whether the robot waits for a plan that is being searched for."""

    def is_due(self, now: float) -> bool:
        """Return whether a search has ended whose plan begins at `now` [s] or before."""


def make_strategy(settings: ControllerSettings, robot: RobotParameters) -> Strategy:
    """Return a new strategy of the kind that is named in `settings`, which has checked the name.

    `robot` has the parameters of the robot and the limits of its drives. `InvalidParameterError`
    is raised if the strategy cannot be loaded or made.
    """
    kind = STRATEGIES.load(settings.strategy)
    try:
        strategy: Strategy = kind(settings, robot)
    except (MemoryError, SphereNmpcError):
        raise
    except Exception as error:
        raise InvalidParameterError(
            "strategy", settings.strategy, f"one that can be made ({reason_of(error)})"
        ) from error
    return strategy
