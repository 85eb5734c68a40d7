# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Contract between a strategy and the control loop, and strategies by name."""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from numbers import Integral, Real
from typing import Any, Protocol, runtime_checkable

import numpy as np

from sphere_nmpc.errors import (
    ForeignCodeError,
    InvalidParameterError,
    SphereNmpcError,
    printable_line,
    reason_of,
    shown,
)
from sphere_nmpc.floor.floor import Floor
from sphere_nmpc.foreign.code import called
from sphere_nmpc.model.course import Course, Leg, LegEnd
from sphere_nmpc.model.disturbance import UNDISTURBED, Disturbance
from sphere_nmpc.model.error_state import place_deviation, state_deviation
from sphere_nmpc.model.first_order_hold import SHORTEST, FirstOrderHold
from sphere_nmpc.model.goal import Goal, Orientation
from sphere_nmpc.model.parameters import LumpedConstants, RobotParameters
from sphere_nmpc.model.plant import PlantEstimate
from sphere_nmpc.model.state import MOMENTUM, STATE_SIZE, Vector
from sphere_nmpc.reporting.conditions import Condition, Kind
from sphere_nmpc.settings import STRATEGIES, ControllerSettings
from sphere_nmpc.strategy.plan import Made, Plan, PlanStatus
from sphere_nmpc.worker.contract import Worker

SMALL_MOMENTUM = 1.0
"""Momentum [rad/s] that is small. A sphere with less rolls steadily, rests and stops on its path
as one without, no rotor has to be ramped to hold it before the sphere counts as resting, and a
plan for a momentum that differs by less can still be followed."""

MOST_KNOTS = 3000
"""Knots that a plan may have: those of this package have some hundred. Up to a command so many
take 15 ms, 10 000 of them 80 ms."""
_SPEED_STEP = 1e-3
"""Difference from the speeds in force [rad/s] from which on a plan does not begin with them."""
_FIELDS: dict[type, dict[str, Any]] = {
    Plan: {
        "status": PlanStatus, "hold": FirstOrderHold, "leg": Leg, "error": Real, "until": Real,
        "tolerance": Real, "conditions": tuple, "made": Made, "asked": Real,
        "spared": Real,
    },
    Leg: {"goal": Goal, "end": LegEnd, "time_left": Real, "way_left": Real},
    Goal: {"since": Real},
    Condition: {"kind": Kind, "text": str, "subject": str},
    Made: dict.fromkeys(("cost", "kkt_residual", "solve_time"), Real)
    | dict.fromkeys(("turns", "work", "iterations", "motion"), Integral),
    FirstOrderHold: {},  # it has checked them itself
}
"""Types of the fields of a plan and its parts, of other packages as well."""


@dataclass(frozen=True, eq=False)
class Situation:
    """Inputs of a strategy at a sampling instant.

    Attributes
    ----------
    time : float
        Sampling instant, control time [s].
    state : ndarray, shape (9,)
        State at that instant, predicted from the newest measurement.
    course : Course
        The goals, which are compared by `Course.origin`.
    in_force : FirstOrderHold
        The newest command sent, from `time` on: it is followed to its end without another.
    plant : PlantEstimate
        Parameters of the plant as known at that instant.
    disturbance : Disturbance
        Estimated slope and imbalance.
    floor : Floor
        What the sphere has to stay clear of; `Floor.EMPTY` where there is nothing.
    leg : int
        Index of the leg of the course that is followed.
    covariance : ndarray of shape (5, 5), or None
        Covariance of the error of `state`: position [m; world frame], rotation vector [rad; body
        frame]. None where it is trusted exactly.
    time_budget : float
        Wall time that planning may take [s]; a strategy then returns the best plan found.
    """

    time: float
    state: Vector
    course: Course
    in_force: FirstOrderHold
    plant: PlantEstimate
    disturbance: Disturbance = UNDISTURBED
    floor: Floor = Floor.EMPTY
    leg: int = 0
    covariance: Vector | None = None
    time_budget: float = float("inf")

    def __post_init__(self) -> None:
        aimed = self.course.legs[self.leg].goal
        # The estimate and the goal in force are the same arrays.
        for array in (self.state, aimed.pose, aimed.rate, self.plant.deviations, self.covariance):
            if array is not None:
                array.flags.writeable = False

    @classmethod
    def of(
        cls, time: float, state: Vector, goal: Vector | Goal, speeds: Vector,
        constants: LumpedConstants, **others: Any,
    ) -> "Situation":
        """Return that of a known plant with one goal, or a pose, (6,), and rotor speeds [rad/s].

        `others` are further fields.
        """
        one = goal if isinstance(goal, Goal) else Goal(goal)
        in_force = FirstOrderHold.constant(time, speeds)
        return cls(
            time, state, Course.of(one), in_force, PlantEstimate(constants), **others
        )

    @cached_property
    def goal(self) -> Goal:
        """The goal that is aimed at, as it is now: a set, see `Goal.nearest`."""
        return self.course.legs[self.leg].goal.now(self.time)

    def aim(self, pose: Vector) -> Goal:
        """Return the goal at another pose, such as a member of the set, now."""
        goal = self.goal
        return goal if pose is goal.pose else replace(goal, pose=pose, since=self.time)

    def aimed_at(self, goal: Goal) -> "Situation":
        """Return the situation with another goal of the same leg, such as a member of the set."""
        if goal is self.goal:
            return self
        return replace(self, course=self.course.aimed(self.leg, goal))

    def nearest_to(self, state: Vector) -> "Situation":
        """Return the situation with the member of the goals that is nearest to a state."""
        goal = self.goal
        if goal.orientation is Orientation.FULL:
            return self
        return self.aimed_at(self.aim(goal.orientation.nearest(goal.pose, state)))

    def from_zero(self) -> "Situation":
        """Return the same situation at time 0, with its leg alone."""
        leg = replace(self.course.legs[self.leg], goal=replace(self.goal, since=0.0))
        return replace(
            self, time=0.0, course=Course((leg,), self.course.origin), leg=0,
            in_force=self.in_force.delayed(-self.time),
        )

    @cached_property
    def constants(self) -> LumpedConstants:
        """Constants of the plant."""
        return self.plant.constants

    @cached_property
    def speeds(self) -> Vector:
        """Rotor speeds in force at that instant [rad/s], shape (2,)."""
        return self.in_force.speeds[0]

    @cached_property
    def place_deviation(self) -> float:
        """Standard deviation of the error of the position [m]."""
        return place_deviation(self.covariance)

    @cached_property
    def uncertainty(self) -> float:
        """Standard deviation of the error of the state in R^6."""
        return state_deviation(self.covariance)

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

    @cached_property
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
        """Forget warm starts and plans, as before another leg: the strategy then acts like new."""


@runtime_checkable
class SearchingStrategy(Protocol):
    """Strategy that can search beside the control loop.

    It finds by `Course.origin` and `Situation.leg` that another goal is aimed at, and is not
    `reset` then.
    """

    def search_beside(self, worker: Worker) -> None:
        """Search by a worker from now on."""

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
    _check_types(plan)
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
    time, speeds = situation.time, situation.speeds
    if abs(hold.start - time) > SHORTEST or np.abs(hold.speeds[0] - speeds).max() > _SPEED_STEP:
        hold = hold.starting_at(time, speeds, SHORTEST)
    return replace(
        plan, states=states, clearance=math.nan,
        hold=hold.limited(robot.max_rotor_speed, robot.max_rotor_acceleration),
        conditions=tuple([
            Condition(kind, printable_line(text), subject and printable_line(subject))
            for kind, text, subject in plan.conditions
        ]),
    )


def _check_types(plan: Plan) -> None:
    """Raise a `TypeError` where a plan, a part of it or a field of these is of another type."""
    parts: list[tuple[Any, type]] = [(plan, Plan)]
    for given, kind in parts:
        # Classes derived from these could have other methods.
        if type(given) is not kind:
            raise TypeError(f"plan: given {type(given).__name__}, expected {kind.__name__}")
        for name, expected in _FIELDS[kind].items():
            value = getattr(given, name)
            if not isinstance(value, expected):
                raise TypeError(f"plan: given the {name} {shown(value)}, expected another type")
            if expected in _FIELDS:
                parts.append((value, expected))
            elif expected is tuple:
                parts += [(one, Condition) for one in value]
