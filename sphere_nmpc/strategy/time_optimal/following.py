# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Following a plan: what is left of it is solved again from the measured state."""

import math
import operator
import time
from dataclasses import replace

import numpy as np

from sphere_nmpc.model.course import LegEnd
from sphere_nmpc.model.disturbance import UNDISTURBED
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.state import (
    MOMENTUM,
    POSE,
    QUATERNION,
    Vector,
    nearer_sign,
    state_error,
)
from sphere_nmpc.reporting.conditions import Condition, Kind
from sphere_nmpc.strategy.clearance import Margin, is_clear
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.in_force import InForce
from sphere_nmpc.strategy.plan import Plan, PlanStatus
from sphere_nmpc.strategy.rest import hold_momentum
from sphere_nmpc.strategy.time_optimal.arrival import RAISES, ArrivalSolver, rolled_out
from sphere_nmpc.strategy.time_optimal.knots import Grid
from sphere_nmpc.strategy.time_optimal.settings import TimeOptimalSettings

_MIN_TIME_LEFT = 1e-3
"""Time left of a plan [s] below which it has ended."""


def leads_to(followed: InForce, situation: Situation, settings: TimeOptimalSettings) -> bool:
    """Return whether a plan leads to the goal of a situation, or to where that was before.

    The change is that of where the goal will be when the plan arrives: the goal moves, or momentum
    changes the orientation that can be held. More than a little is none that a plan follows.
    """
    if not followed.is_for(situation.course, situation.leg):
        return False
    leg, end = followed.plan.leg, followed.plan.end
    goal = situation.goal.at(end)
    if leg.end is LegEnd.REST:
        own = leg.goal.at(end)
    else:
        own = followed.situation.goal.nearest(goal, end)
    return settings.is_near(own, goal, situation.constants)


def left_of(plan: Plan, now: float, grid: Grid) -> FirstOrderHold:
    """Return what is left of the rotor speeds of a plan at `now` [s], at knots to solve it on."""
    return grid.thinned(grid.split(plan.rest(now)))


def solved_again(
    followed: InForce, situation: Situation, solver: ArrivalSolver, dead_band: float,
    deadline: float, is_aimed: bool = False,
) -> InForce | None:
    """Return what is left of a plan, solved from the present state; None if it has ended.

    Parameters
    ----------
    followed : InForce
        The plan.
    situation : Situation
        The present one.
    solver : ArrivalSolver
        Solver with the limits of the drives that the plan keeps.
    dead_band : float
        Error within which the sphere rests at the goal.
    deadline : float
        Steady clock reading at which to stop [s].
    is_aimed : bool, optional
        Whether it is solved for the goal of the situation, rather than for its own.
    """
    now, settings, before = situation.time, solver.settings, followed.plan
    if before.end - now < _MIN_TIME_LEFT:
        return None
    hold = rest = left_of(before, now, solver.grid)
    goal, asked = before.leg.goal, before.asked if before.spared else -math.inf
    if is_aimed and before.leg.end is LegEnd.REST:
        goal = situation.aim(nearer_sign(situation.goal.pose, goal.pose))
    # With noise an error is left where it would take a manoeuvre to correct it.
    noisy = settings.noisy_share * (dead_band - settings.least_dead_band)
    wanted = max(settings.arrival_error, noisy)
    for factor in RAISES:
        plan = solver.solve(
            situation, goal, hold, factor, deadline - time.perf_counter(), kept=True, asked=asked
        )
        if plan.error <= wanted or time.perf_counter() > deadline:
            break
        hold = plan.hold
    if not is_clear(situation, plan.hold, Margin.KEPT):
        # What is left of a plan that kept clear may still do so as it is.
        plan = rolled_out(plan, situation, rest)
        if not is_clear(situation, plan.hold, Margin.KEPT):
            return None
    reaches = plan.error <= max(dead_band, settings.leaving_error)
    own, text = before.leg, f"a motion of {plan.duration:.2f} s"
    if before.asked > asked and plan.end > before.asked:
        text += f", {plan.end - before.asked:.2f} s later than asked"
    plan = replace(
        plan, status=PlanStatus.SOLVED if reaches else PlanStatus.BEST_SO_FAR,
        leg=replace(own, goal=plan.leg.goal), made=replace(plan.made, motion=before.made.motion),
        conditions=(Condition(Kind.PLANNED, text),), asked=before.asked, spared=before.spared,
    )
    made_for = followed.situation
    if not is_aimed:
        situation = replace(situation, course=made_for.course, leg=made_for.leg)
    return replace(followed, plan=plan, situation=situation)


def momentum_at_arrival(followed: InForce, situation: Situation) -> Vector:
    """Return the momentum of now with what it gains until the arrival, shape (3,)."""
    plan = followed.plan
    if situation.is_out_of_balance:
        return plan.momentum  # what differs now is planned away
    return situation.momentum + (plan.momentum - followed.at(situation.time)[MOMENTUM])


def at_its_end(followed: InForce, situation: Situation) -> Situation:
    """Return the situation in which the next leg begins, as a plan predicts it."""
    plan = followed.plan
    return replace(
        situation, time=plan.end, state=plan.states[-1].copy(), leg=situation.leg + 1,
        in_force=FirstOrderHold.constant(plan.end, plan.hold.speeds[-1]),
    )


def next_leg(
    followed: InForce, situation: Situation, solver: ArrivalSolver, dead_band: float,
    deadline: float,
) -> InForce | None:
    """Return the plan of the next leg from the end of the one that is followed; None without one.

    It is solved again where that end or the plant is another one than it was made for. Parameters
    are those of `solved_again`.
    """
    after = followed.after
    if after is None or not after.is_for(situation.course, situation.leg + 1):
        return None
    start, made_for = at_its_end(followed, situation), after.situation
    start = start.nearest_to(after.plan.leg.goal.pose)
    plan = after.plan.delayed(start.time - after.plan.hold.start)
    after = replace(after, plan=plan)
    known = made_for.plant, made_for.disturbance
    is_same = all(map(operator.is_, known, (start.plant, start.disturbance)))
    off = state_error(start.state, plan.states[0, POSE])
    if not is_same or off > solver.settings.arrival_error:
        after = solved_again(after, start, solver, dead_band, deadline, is_aimed=True)
    if after is None or after.plan.status is not PlanStatus.SOLVED:
        return None
    whole = followed.plan.continued(after.plan)
    return after if is_clear(situation, whole.hold, Margin.KEPT) else None


def held_at_its_end(plan: Plan, situation: Situation, max_speed: float) -> Plan:
    """Return a plan with what holds the momentum after its arrival.

    The rotors turn at `max_speed` [rad/s] at most.
    """
    hold = hold_momentum(
        plan.hold, plan.momentum, UNDISTURBED if plan.made.turns else situation.disturbance,
        plan.leg.goal.pose[QUATERNION], max_speed,
    )
    return plan.spliced(hold, np.tile(plan.states[-1], (hold.times.size, 1)))
