# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Re-planning over the shrinking horizon: the rest of the plan from the measured state."""

import time
from dataclasses import replace

import numpy as np

from sphere_nmpc.model.drift import Drift
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.state import QUATERNION
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.time_optimal.arrival import Arrival
from sphere_nmpc.strategy.time_optimal.states import Following


def replan(
    plan: Following,
    situation: Situation,
    dead_band: float,
    deadline: float,
    settings: ControllerSettings,
) -> Following | None:
    """Solve the rest of the plan again, for the same arrival time or a later one.

    Parameters
    ----------
    plan : Following
        The plan that is being followed.
    situation : Situation
        State of the robot and speeds of its rotors now.
    dead_band : float
        Error [norm in R^6] within which the sphere rests at the goal.
    deadline : float
        Steady clock reading at which to stop [s].
    settings : ControllerSettings
        Planning effort, sample period, control period.

    Returns
    -------
    Following or None
        None if the plan has ended, or no delay that is tried makes it reach the goal.
    """
    tuning, now = plan.planner.tuning, situation.time
    left = plan.time_left(now)
    if left < tuning.ended_time:
        return None
    rest = plan.rest(now)
    if not situation.drift.is_zero:
        rest = _compensated(rest, plan.arrival, situation.drift, left)
    accepted = tuning.accepted_error(left / settings.period) * dead_band
    best: Arrival | None = None
    for delay in tuning.delays:
        if best is not None and time.perf_counter() > deadline:
            return replace(plan, arrival=best, planned_at=now)
        arrival = plan.planner.solve(
            situation, plan.arrival.goal, delay * left, rest, new_plan=False
        )
        if arrival.error <= tuning.arrival_error:
            # After a large delay the robot does not behave as the plan assumed: plan as at first.
            divisor = 1 if delay > tuning.large_delay else tuning.improvement_divisor
            kept = replace(plan, arrival=arrival, planned_at=now)
            work = settings.planning_effort // divisor
            return _improved(kept, situation, work, deadline, settings)
        if best is None or arrival.error < 0.5 * best.error:
            best = arrival
        if best.error < accepted:
            # Too few knots are left to correct what noise has done since: a delay gains nothing.
            return replace(plan, arrival=best, planned_at=now)
    return None


def _compensated(
    rest: FirstOrderHold, arrival: Arrival, drift: Drift, left: float
) -> FirstOrderHold:
    """Return the rest of a plan with the speeds that hold the change of the momentum since then.

    The change counts where the plan ends, so that what the plan has foreseen is left out.
    """
    change = drift.after_slope(left).momentum - arrival.drift.momentum
    if drift.imbalance.any() or arrival.states.shape[0] < rest.times.size:
        return rest
    turns = arrival.states[-rest.times.size:, QUATERNION]
    held = [Drift(change).rest_speeds(turn) for turn in turns]
    return FirstOrderHold(rest.times, rest.speeds + np.array(held))


def _improved(
    plan: Following,
    situation: Situation,
    work: int,
    deadline: float,
    settings: ControllerSettings,
) -> Following:
    """Use the rest of the sample to search for an earlier arrival, with effort `work`."""
    tuning, arrival, planner = plan.planner.tuning, plan.arrival, plan.planner
    tick, period = settings.control_period, settings.period
    # At a high control rate it is searched once a sample period, just after a knot.
    to_knot = planner.grid.to_first_knot(situation.time, new_plan=False)
    between_knots = tick < period and to_knot < period - 0.5 * tick
    short = deadline - time.perf_counter() < tuning.least_search_time
    if arrival.duration < tuning.fixed_time or work == 0 or between_knots or short:
        return plan
    search = planner.search(situation, new_plan=False)
    search.start_from(arrival)
    found = search.improve(max(work, plan.unspent_effort), deadline)
    plan = replace(plan, unspent_effort=max(0, plan.unspent_effort - search.work))
    if found is None or found is arrival:
        return plan
    precise = planner.solve(situation, found.goal, found.duration, found.hold, new_plan=False)
    return replace(plan, arrival=precise) if precise.error <= tuning.arrival_error else plan
