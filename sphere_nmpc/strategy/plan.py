# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Plans: rotor speeds with where they lead, from the search to the command."""

import math
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from sphere_nmpc.conditions import Kind
from sphere_nmpc.model.disturbance import Disturbance
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.goal import Goal
from sphere_nmpc.model.state import MOMENTUM, POSITION, Vector
from sphere_nmpc.solver.roll_out import roll_out

_NOT_TOLD = Goal(np.full(6, np.nan))


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
class Plan:
    """Rotor speeds from now on and the states that they are predicted to lead to.

    The control loop takes plans in control time. A plan of a search begins at time 0; `delayed`
    puts it in force.

    Attributes
    ----------
    status : PlanStatus
        Origin and quality of the plan.
    hold : FirstOrderHold
        Rotor speeds [rad/s]; knot times in control time [s], the first at the sampling instant, or
        from time 0 on. That of a search ends at the arrival at its own goal; once it is in force,
        the sphere is held there for a second more, so that its end is no arrival.
    states : ndarray, shape (K, 9)
        Predicted states at the knots of `hold`.
    goal : Goal
        What it aims at: the member of the set at which it ends; its pose is nan if not told.
    error : float
        Predicted terminal error [-], inf where it is not finite, nan where it is not told. Of a
        minimum-time problem it is the sum of the absolute residuals, else the norm in R^6.
    remaining_time : float
        Time from its end to the final goal [s]; 0 where that is its own.
    final : ndarray of shape (6,), or None
        Final goal, where its own is on the way there.
    turns : int
        Whole turns of steady rolling that were left out of the problem.
    work : int
        Cost of the solve in microseconds or so, the same on every machine.
    arrival : float
        Control time at which the final goal is reached [s]; nan where it is not predicted.
    cost : float
        Value of the optimal control problem, in the strategy's own units; nan where none.
    iterations : int
        Solver iterations spent.
    kkt_residual : float
        First-order optimality of the solution; nan where none.
    solve_time : float
        Wall time spent [s], steady clock.
    message : str
        One line that explains the status.
    given_up : str
        What is given up of the goal and why; empty where nothing is.
    unreachable : Kind or None
        Why the goal cannot be reached even without the areas to keep out of, which may move; None
        where it may be.
    motion : int
        Number of the motion that it is the rest of; 0 where none was planned.
    clearance : float
        Clearance that it is certified to keep from what is on the floor [m], infinite where
        nothing is; nan where no motion is planned.
    beyond : float
        Length of the way from its end to the goal [m], where it ends on the way there.
    until : float
        Control time before which no other plan is wanted while nothing new is known [s], see
        `Controller`; -inf where each sampling instant has one of its own.
    tolerance : float
        Difference of the estimated state from the predicted one that is nothing new, in R^6.
    """

    status: PlanStatus
    hold: FirstOrderHold
    states: Vector
    goal: Goal = _NOT_TOLD
    error: float = math.nan
    remaining_time: float = 0.0
    final: Vector | None = None
    turns: int = 0
    work: int = 0
    arrival: float = math.nan
    cost: float = math.nan
    iterations: int = 0
    kkt_residual: float = math.nan
    solve_time: float = 0.0
    message: str = ""
    given_up: str = ""
    unreachable: Kind | None = None
    motion: int = 0
    clearance: float = math.nan
    beyond: float = 0.0
    until: float = -math.inf
    tolerance: float = 0.0

    @property
    def duration(self) -> float:
        """Time from time 0 to the arrival at its own goal [s], of the plan of a search."""
        return self.hold.end

    @property
    def momentum(self) -> Vector:
        """Predicted momentum at its end, shape (3,) [rad/s; world frame]."""
        return self.states[-1, MOMENTUM]

    def delayed(self, time: float) -> "Plan":
        """Return a plan that begins at time 0 in control time, put in force at `time` [s]."""
        return replace(
            self, hold=self.hold.delayed(time),
            goal=replace(self.goal, since=self.goal.since + time),
            arrival=time + self.duration + self.remaining_time,
        )

    @property
    def stops(self) -> bool:
        """Whether all that it does is to bring the rotors to the speeds at which they stay."""
        saturated = self.status is PlanStatus.SATURATED and len(self.states) < 2
        return saturated or self.status is PlanStatus.RAMP_TO_REST

    def state_at(self, time: float, constants: Vector, disturbance: Disturbance) -> Vector:
        """Return the state predicted for control time `time` [s], shape (9,)."""
        hold, passed = self.hold, self.hold.knots_until(time)
        begin = min(passed, len(self.states)) - 1
        times = [*hold.times[begin:passed].tolist(), time]
        speeds = np.vstack((hold.speeds[begin:passed], hold.at(time)))
        return roll_out(
            self.states[begin], speeds, np.diff(times), constants, disturbance=disturbance
        )[-1]

    def distance_left(self, now: float) -> float:
        """Return the length of the way to the goal from `now` [s] on [m]; nan without a plan.

        It is straight between knots.
        """
        times, places = self.hold.times, self.states[:, POSITION]
        if len(places) < 2:
            return 0.0 if self.status is PlanStatus.HOLDING else float("nan")
        times = times[: len(places)]
        now = min(max(now, float(times[0])), float(times[-1]))
        here = [[np.interp(now, times, places[:, axis]) for axis in (0, 1)]]
        ahead = np.concatenate((here, places[times > now]))
        return self.beyond + float(np.sum(np.linalg.norm(np.diff(ahead, axis=0), axis=1)))
