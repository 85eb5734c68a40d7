# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Guard of the loop on a floor: goals that are refused, plans and commands without a certificate.

Whatever the strategy is, a goal that is refused leads to a stop, and so do a plan that has no
certificate (`sphere_nmpc.strategy.clearance`) and a command for which that does not hold any more.
"""

import math
from dataclasses import replace

import numpy as np

from sphere_nmpc.control.link import Commands
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.reporting.conditions import Kind
from sphere_nmpc.strategy.clearance import Margin, clearance_of, refusal
from sphere_nmpc.strategy.contract import Situation
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
    clearance = clearance_of(situation, plan.hold, Margin.KEPT)
    if not math.isnan(clearance):
        return replace(plan, clearance=clearance)
    stopped = stop(situation, robot, "not clear").giving_up(
        f"the goal: plans of the strategy {strategy} do not lead around what is occupied, those "
        "of time_optimal do"
    )
    if plan.status is PlanStatus.HOLDING:  # what a small error takes to be corrected
        return replace(plan, hold=stopped.hold, states=stopped.states)
    return stopped


def clear_command(
    situation: Situation, hold: FirstOrderHold, commands: Commands, start: float, period: float,
    robot: RobotParameters,
) -> FirstOrderHold:
    """Return what is sent of a plan `hold` that begins late, at `start` [s].

    It begins in another state than was planned, so that its motion is another one, unless the
    sphere rests until then and the plan is as late. Where neither is certified it is sent up to a
    stop, as the next plan, after `period` [s], corrects that; where that is not, only a stop. All
    are joined to the speeds in force, see `Commands.joined`.
    """
    durations, speeds = commands.rotors.pieces(situation.time, start)
    times, late = np.append(0.0, np.cumsum(durations)), start - hold.start
    for sent in (
        commands.joined(hold, start, period),
        commands.joined(hold.delayed(late), start, period),
        commands.joined(hold, start, period, late + period),
    ):
        motion = FirstOrderHold(
            np.append(times, sent.times[1:] - situation.time),
            np.vstack((speeds, sent.speeds[1:])),
        )
        if not math.isnan(clearance_of(situation, motion, Margin.SENT)):
            return sent
    situation = replace(situation, time=start, in_force=commands.in_force(start))
    return commands.joined(stop(situation, robot, "late").hold, start, period)
