# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Guard of the loop on a floor: goals that are refused, and plans without a certificate.

Whatever the strategy is, a goal that is refused leads to a stop, and so does a plan that has no
certificate (`sphere_nmpc.strategy.clearance`); for commands see `Commands`. What changes on the
floor without touching the plan in force is no reason for another one.
"""

import math
from dataclasses import replace

from sphere_nmpc.estimation.pose_filter import Estimate
from sphere_nmpc.floor.floor import Floor
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.reporting.conditions import Kind
from sphere_nmpc.strategy.clearance import Margin, clearance_of, refusal
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.in_force import InForce
from sphere_nmpc.strategy.plan import Plan, PlanStatus
from sphere_nmpc.strategy.rest import come_to_rest, stop


def stop_if_refused(situation: Situation, robot: RobotParameters) -> Plan | None:
    """Return a stop where the goal is refused, whatever a plan would be; None where it is not."""
    refused = refusal(situation, situation.floor)
    if refused is None:
        return None
    lasting = refusal(situation, situation.floor.lasting)
    kind = Kind.GIVEN_UP if lasting is None else lasting[0]
    return stop(situation, robot, "no way to the goal").giving_up(refused[1], kind)


def clear_plan(situation: Situation, plan: Plan, robot: RobotParameters, strategy: str) -> Plan:
    """Return a plan of a strategy with its clearance; a stop in place of one without.

    On a floor a stop is that of the loop as well, since none is certified.
    """
    if plan.stops:
        if situation.floor.is_empty:
            return plan
        if plan.status is PlanStatus.SATURATED:
            own = come_to_rest(situation, robot, "")
        else:
            own = stop(situation, robot, "")
        return replace(plan, hold=own.hold, states=own.states)
    if not plan.hold.speeds.any():
        return plan
    hold = plan.hold
    # It is sent with a stop at its end. Rotors that turn there may hold a large momentum, at rest.
    if hold.speeds[-1].any() and situation.has_small_momentum:
        hold = hold.stop(hold.end, robot.max_rotor_acceleration)
    clearance = clearance_of(situation, hold, Margin.KEPT)
    if not math.isnan(clearance):
        return replace(plan, clearance=clearance)
    stopped = stop(situation, robot, "not clear").giving_up(
        f"the goal: plans of the strategy {strategy} do not lead around what is occupied, those "
        "of time_optimal do"
    )
    if plan.status is PlanStatus.HOLDING:  # what a small error takes to be corrected
        return replace(plan, hold=stopped.hold, states=stopped.states)
    return stopped


def kept_on_floor(
    in_force: InForce, time: float, estimate: Estimate, floor: Floor, robot: RobotParameters
) -> InForce:
    """Return a plan in force as one for another floor, if what is left of it is certified there.

    It is returned as it is otherwise, and then no longer stands.
    """
    plan, made_for = in_force.plan, replace(in_force.situation, floor=floor)
    rest = plan.rest(time)
    now = replace(
        made_for, time=time, state=estimate.state, covariance=estimate.covariance, in_force=rest
    )
    found = clear_plan(now, replace(plan, hold=rest), robot, "")
    if found.hold is not rest or refusal(now, floor) is not None:
        return in_force
    plan = replace(plan, clearance=found.clearance)
    return replace(in_force, plan=plan, situation=made_for)
