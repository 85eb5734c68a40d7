# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Plans: rotor speeds with where they lead, from the search to the command."""

import math
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any

import numpy as np

from sphere_nmpc.model.course import Leg
from sphere_nmpc.model.disturbance import Disturbance
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.goal import Goal
from sphere_nmpc.model.parameters import LumpedConstants
from sphere_nmpc.model.state import MOMENTUM, POSITION, Vector
from sphere_nmpc.reporting.conditions import Condition, Kind
from sphere_nmpc.solver.roll_out import roll_out

UNPLANNED_RATIO = 1.5
"""Factor on the time of a way that is not planned yet, as of rolling it without a manoeuvre, where
plans are compared: one that leads on is better, though its manoeuvre costs time."""
_NOWHERE = Leg(Goal(np.full(6, np.nan), since=math.nan))


class PlanStatus(Enum):
    """Origin and quality of a plan."""

    SOLVED = "solved"
    BEST_SO_FAR = "best so far"
    """The solve was stopped early; the plan satisfies all limits but not all tolerances."""
    HOLDING = "holding"
    """At rest at the goal."""
    FALLBACK = "fallback"
    """The solve failed; the rest of the previous plan is followed."""
    RAMP_TO_REST = "ramp to rest"
    """No plan is known; the rotors are brought to the speeds at which the sphere rests."""
    SATURATED = "saturated"
    """The rotors cannot hold the momentum: they stay at their limits, and the sphere rolls."""


@dataclass(frozen=True, eq=False)
class Made:
    """How a plan was made.

    Attributes
    ----------
    cost : float
        Value of the optimal control problem, in the strategy's own units; nan where none.
    iterations : int
        Solver iterations spent.
    kkt_residual : float
        First-order optimality of the solution; nan where none.
    work : int
        Cost of the solve in microseconds or so, the same on every machine.
    solve_time : float
        Wall time spent [s], steady clock.
    turns : int
        Whole turns of steady rolling that were left out of the problem.
    motion : int
        Number of the motion that the plan is the rest of; 0 where none was planned.
    """

    cost: float = math.nan
    iterations: int = 0
    kkt_residual: float = math.nan
    work: int = 0
    solve_time: float = 0.0
    turns: int = 0
    motion: int = 0


_UNKNOWN = Made()


@dataclass(frozen=True, eq=False)
class Plan:
    """Rotor speeds from now on and the states that they are predicted to lead to.

    All times are those of the situation that it was made for: control time, but for a search,
    whose plans begin at time 0 until they are `delayed`.

    Attributes
    ----------
    hold : FirstOrderHold
        Rotor speeds [rad/s]; the first knot is at the sampling instant.
    states : ndarray, shape (K, 9)
        Predicted states at the knots of `hold`; of one that stops that at its start.
    status : PlanStatus
        Origin and quality of the plan.
    leg : Leg
        Leg that it ends at, whose goal is the member at which it ends, since the arrival; nan
        if not known.
    error : float
        Predicted terminal error [-], inf where it is not finite, nan where it is not known. Of a
        minimum-time problem it is the sum of the absolute residuals, else the norm in R^6.
    clearance : float
        Clearance that it is certified to keep from what is on the floor [m], infinite where
        nothing is; nan where no motion is planned.
    conditions : tuple of Condition
        What it does (`Kind.PLANNED`), what it gives up of the goal (`Kind.GIVEN_UP`), and why the
        goal is unreachable whatever moves on the floor.
    until : float
        Time before which no other plan is wanted while nothing new is known [s], see `Controller`;
        -inf where each sampling instant has one of its own.
    tolerance : float
        Difference of the estimated state from the predicted one that is nothing new, in R^6.
    made : Made
        How it was made.
    asked : float
        Time before which it need not arrive [s]; -inf where that is as early as possible.
    spared : float
        Time by which it arrives later than the earliest arrival found [s], to spare the motors.
    """

    hold: FirstOrderHold
    states: Vector
    status: PlanStatus = PlanStatus.SOLVED
    leg: Leg = _NOWHERE
    error: float = math.nan
    clearance: float = math.nan
    conditions: tuple[Condition, ...] = ()
    until: float = -math.inf
    tolerance: float = 0.0
    made: Made = _UNKNOWN
    asked: float = -math.inf
    spared: float = 0.0

    @classmethod
    def found(
        cls, hold: FirstOrderHold, states: Vector, is_converged: bool = True, message: str = "",
        **made: Any,
    ) -> "Plan":
        """Return the plan that a solver has found, the best so far if it has not converged.

        The message is said of it; `made` are fields of `Made`, such as its cost.
        """
        status = PlanStatus.SOLVED if is_converged else PlanStatus.BEST_SO_FAR
        conditions = (Condition(Kind.PLANNED, message),) if message else ()
        return cls(hold, states, status, conditions=conditions, made=Made(**made))

    @property
    def end(self) -> float:
        """Time of its arrival at the end of the leg [s]; nan if not known."""
        return self.leg.goal.since

    @property
    def duration(self) -> float:
        """Time from its start to the arrival at the end of the leg [s]."""
        return self.leg.goal.since - self.hold.start

    @property
    def arrival(self) -> float:
        """Time of the arrival at the goal of the course that is aimed at [s]; nan if not known."""
        return self.leg.goal.since + self.leg.time_left

    @property
    def cost(self) -> float:
        """Arrival that plans are compared by [s]: without the time that spares the motors.

        What is not planned yet counts more, see `UNPLANNED_RATIO`.
        """
        leg = self.leg
        return leg.goal.since + UNPLANNED_RATIO * leg.time_left - self.spared

    @property
    def momentum(self) -> Vector:
        """Predicted momentum at its end, shape (3,) [rad/s; world frame]."""
        return self.states[-1, MOMENTUM]

    @property
    def stops(self) -> bool:
        """Whether all that it does is to bring the rotors to the speeds at which they stay."""
        saturated = self.status is PlanStatus.SATURATED and len(self.states) < 2
        return saturated or self.status is PlanStatus.RAMP_TO_REST

    @property
    def message(self) -> str:
        """What it does, or why it does no more; empty if not known."""
        planned = [text for kind, text, _ in self.conditions if kind is Kind.PLANNED]
        return planned[0] if planned else ""

    @property
    def limitation(self) -> Condition | None:
        """What it gives up of the goal and why; None where that is nothing."""
        found = [one for one in self.conditions if one.kind is not Kind.PLANNED]
        return found[0] if found else None

    @property
    def given_up(self) -> str:
        """The text of its limitation, empty without one."""
        limitation = self.limitation
        return "" if limitation is None else limitation.text

    @property
    def unreachable(self) -> Kind | None:
        """Why the goal is unreachable whatever moves on the floor; None where it may not be."""
        limitation = self.limitation
        if limitation is None or not limitation.kind.is_unreachable:
            return None
        return limitation.kind

    def giving_up(self, reason: str, kind: Kind = Kind.GIVEN_UP) -> "Plan":
        """Return the plan with what it gives up of the goal and why; itself if that is empty.

        The `kind` is another one where the goal is unreachable whatever moves on the floor.
        """
        if not reason:
            return self
        return replace(self, conditions=(*self.conditions, Condition(kind, reason)))

    def at(self, time: float, constants: LumpedConstants, disturbance: Disturbance) -> Vector:
        """Return the state predicted for a time [s], shape (9,)."""
        hold, passed = self.hold, self.hold.knots_until(time)
        begin = min(passed, len(self.states)) - 1
        times = [*hold.times[begin:passed].tolist(), time]
        speeds = np.vstack((hold.speeds[begin:passed], hold.at(time)))
        return roll_out(
            self.states[begin], speeds, np.diff(times), constants.as_array(),
            disturbance=disturbance,
        )[-1]

    def rest(self, now: float) -> FirstOrderHold:
        """Return what is left of the rotor speeds from `now` [s] on."""
        return self.hold.starting_at(now, self.hold.at(now))

    def delayed(self, offset: float) -> "Plan":
        """Return the same plan `offset` seconds later."""
        goal = replace(self.leg.goal, since=self.leg.goal.since + offset)
        return replace(
            self, hold=self.hold.delayed(offset), leg=replace(self.leg, goal=goal),
            asked=self.asked + offset,
        )

    def spliced(self, hold: FirstOrderHold, states: Vector) -> "Plan":
        """Return the plan with speeds and states, shape (K, 9), that follow from its end on.

        The first knot is its own last one. It still ends at the same leg, at the same time.
        """
        return replace(
            self, hold=self.hold.followed_by(hold), states=np.vstack((self.states, states[1:]))
        )

    def continued(self, later: "Plan") -> "Plan":
        """Return one plan of this and of a later one, which begins where and when this one ends.

        It ends at the leg of the later one.
        """
        both = self.spliced(later.hold, later.states)
        return replace(later, hold=both.hold, states=both.states)

    def way_left(self, now: float) -> float:
        """Return the length of the way to the goal from `now` [s] on [m]; nan without a plan.

        It is straight between knots.
        """
        hold, states = self.hold, self.states
        if len(states) < 2:
            return 0.0 if self.status is PlanStatus.HOLDING else float("nan")
        count = len(states) if math.isnan(self.end) else min(
            len(states), hold.knots_until(self.end)
        )
        times, places = hold.times[:count], states[:count, POSITION]
        now = min(max(now, float(times[0])), float(times[-1]))
        here = [[np.interp(now, times, places[:, axis]) for axis in (0, 1)]]
        ahead = np.concatenate((here, places[times > now]))
        way = float(np.sum(np.linalg.norm(np.diff(ahead, axis=0), axis=1)))
        return self.leg.way_left + way
