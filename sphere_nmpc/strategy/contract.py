# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Contract between a strategy and the control loop, and strategies by name."""

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from numbers import Integral, Real
from typing import Any, Protocol, runtime_checkable

import numpy as np

from sphere_nmpc.conditions import Kind
from sphere_nmpc.errors import (
    ForeignCodeError,
    InvalidParameterError,
    SphereNmpcError,
    reason_of,
)
from sphere_nmpc.floor.floor import Floor
from sphere_nmpc.foreign_code import called
from sphere_nmpc.foreign_text import printable_line, shown
from sphere_nmpc.model.disturbance import UNDISTURBED, Disturbance
from sphere_nmpc.model.first_order_hold import SHORTEST, FirstOrderHold
from sphere_nmpc.model.goal import STANDING, Goal, Orientation, moved
from sphere_nmpc.model.parameters import LumpedConstants, RobotParameters
from sphere_nmpc.model.state import MOMENTUM, STATE_SIZE, Vector
from sphere_nmpc.settings import STRATEGIES, ControllerSettings
from sphere_nmpc.strategy.plan import Plan, PlanStatus
from sphere_nmpc.worker.contract import Worker

SMALL_MOMENTUM = 1.0
"""Momentum [rad/s] that is small. A sphere with less rolls steadily, rests and stops on its path
as one without, no rotor has to be ramped to hold it before the sphere counts as resting, and a
plan for a momentum that differs by less can still be followed."""

MOST_KNOTS = 3000
"""Knots that a plan may have: those of this package have some hundred. Up to a command so many
take 15 ms, 10 000 of them 80 ms."""
_DIFFERENT = 1e-3
"""Difference from the speeds in force [rad/s] from which on a plan does not begin with them."""
_FIELDS: dict[str, Any] = dict.fromkeys(
    ("error", "remaining_time", "arrival", "cost", "kkt_residual", "solve_time", "beyond", "until",
     "tolerance"), Real,
) | dict.fromkeys(("turns", "work", "iterations", "motion"), Integral) | {
    "status": PlanStatus, "goal": Goal, "message": str, "given_up": str,
    "unreachable": Kind | None, "final": np.ndarray | None,
}
"""Types of the fields of a plan, of other packages as well."""


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

    def __post_init__(self) -> None:
        for array in (self.state, self.goal, self.input_in_force, self.goal_rate):
            array.flags.writeable = False  # the estimate and the goal in force are the same arrays

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


def make_strategy(
    settings: ControllerSettings, robot: RobotParameters, worker: Worker | None = None
) -> Strategy:
    """Return a new strategy of the kind that is named in `settings`, which has checked the name.

    `robot` has the parameters of the robot and the limits of its drives; one that can search
    beside the loop does so by `worker`. `InvalidParameterError` is raised if the strategy cannot
    be loaded or made.
    """
    kind = STRATEGIES.load(settings.strategy)

    def make() -> Strategy:
        strategy: Strategy = kind(settings, robot)
        if worker is not None and isinstance(strategy, SearchingStrategy):
            strategy.search_beside(worker)
        return strategy

    try:
        return called(make)
    except Exception as error:
        is_own = isinstance(error, MemoryError | SphereNmpcError)
        if is_own and not isinstance(error, ForeignCodeError):
            raise
        raise InvalidParameterError(
            "strategy", settings.strategy, f"one that can be made ({reason_of(error)})"
        ) from error


def plan_of(strategy: Strategy, situation: Situation, robot: RobotParameters) -> Plan:
    """Return the plan of a strategy, whatever that is, as the control loop can follow it.

    It begins at the present with the speeds in force and keeps the limits of the drives, its
    arrays are nobody else's, and its clearance is that of nobody. An error is raised where the
    strategy raises one, and for what is no plan.
    """
    return called(_taken, strategy, situation, robot)


def _taken(strategy: Strategy, situation: Situation, robot: RobotParameters) -> Plan:
    plan = strategy.plan(situation)
    # Classes derived from these could have other methods.
    for given, kind in (plan, Plan), (plan.hold, FirstOrderHold):
        if type(given) is not kind:
            raise TypeError(f"plan: given {type(given).__name__}, expected {kind.__name__}")
    for name, expected in _FIELDS.items():
        value = getattr(plan, name)
        if not isinstance(value, expected):
            raise TypeError(f"plan: given the {name} {shown(value)}, expected another type")
    hold, states = plan.hold, np.array(plan.states, dtype=float)
    knots, rows = hold.times.size, len(states) if states.ndim else -1
    if knots > MOST_KNOTS:
        raise ValueError(f"plan: given {knots} knots, expected at most {MOST_KNOTS}")
    if states.shape != (rows, STATE_SIZE) or rows > knots:
        raise ValueError(
            f"plan: given states of the shape {states.shape}, expected at most ({knots}, "
            f"{STATE_SIZE})"
        )
    if not np.isfinite(states).all():
        raise ArithmeticError("the predicted states are not finite")
    states.flags.writeable = False
    time, speeds = situation.time, situation.input_in_force
    if abs(hold.start - time) > SHORTEST or np.abs(hold.speeds[0] - speeds).max() > _DIFFERENT:
        hold = hold.starting_at(time, speeds, SHORTEST)
    return replace(
        plan, states=states, clearance=math.nan,
        hold=hold.limited(robot.max_rotor_speed, robot.max_rotor_acceleration),
        message=printable_line(plan.message), given_up=printable_line(plan.given_up),
    )
