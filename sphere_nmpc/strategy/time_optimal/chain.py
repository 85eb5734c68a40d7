# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Motions on a floor with obstacles: parts of one are planned anew, and joined.

A motion to a distant goal is a chain: it is extended at its end until it leads to the goal, and
parts of it, between two of its states, are searched for an earlier arrival at the second one.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sphere_nmpc.model.course import Course, Leg
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.goal import Goal
from sphere_nmpc.model.state import POSE, Vector
from sphere_nmpc.solver.roll_out import roll_out
from sphere_nmpc.strategy.clearance import Margin, is_clear
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.plan import Plan
from sphere_nmpc.strategy.time_optimal.arrival import ArrivalSolver, rolled_out
from sphere_nmpc.strategy.time_optimal.search import ArrivalSearch


def later(situation: Situation, hold: FirstOrderHold, time: float, max_step: float) -> Situation:
    """Return the situation at control time `time` [s] if the rotors follow `hold` until then.

    It is predicted in integration steps of up to `max_step` [s].
    """
    now = situation.time
    if time <= now:
        return situation
    knots = hold.times[(hold.times > now) & (hold.times < time)]
    times = np.concatenate(([now], knots, [time]))
    speeds: Vector = np.array([hold.at(float(t)) for t in times])
    state = roll_out(
        situation.state, speeds, np.diff(times), situation.constants.as_array(), max_step,
        situation.disturbance,
    )[-1]
    in_force = hold.starting_at(time, speeds[-1])
    return replace(situation, time=time, state=state, in_force=in_force)


def joined(holds: Sequence[FirstOrderHold]) -> FirstOrderHold:
    """Return holds, each from time 0 on, one after the other."""
    whole = holds[0]
    for hold in holds[1:]:
        whole = whole.followed_by(hold.delayed(whole.end))
    return whole


def extended(
    situation: Situation, plan: Plan, begin: float, further: Plan, solver: ArrivalSolver
) -> Plan | None:
    """Return a plan up to `begin` [s], and from there on another one; None if it is not clear.

    It is solved as a whole, which removes the error where they meet.
    """
    before = [plan.hold.until(begin)] if begin > 0.0 else []
    hold = solver.grid.thinned(joined([*before, further.hold]))
    found = solver.solve(situation, further.leg.goal, hold, kept=True)
    is_there = found.error <= solver.settings.arrival_error
    if not (is_there and is_clear(situation, found.hold, Margin.KEPT)):
        return None
    return replace(found, leg=replace(further.leg, goal=found.leg.goal))


def replanned(
    situation: Situation, plan: Plan, begin: float, until: float, solver: ArrivalSolver,
    seed: int, deadline: float,
) -> tuple[Plan | None, int]:
    """Search between two times of a plan for an earlier arrival at its state at the second one.

    Parameters
    ----------
    situation : Situation
        That at its start, at time 0, without momentum.
    plan : Plan
        A plan from rest or in motion.
    begin, until : float
        The times [s].
    solver : ArrivalSolver
        Solver with the limits of the drives.
    seed : int
        Seed of the initial guesses.
    deadline : float
        Steady clock reading at which to stop [s].

    Returns
    -------
    plan : Plan or None
        The whole with what is found; None if that is nothing.
    work : int
        Work of the search, in microseconds or so.
    """
    hold, grid = plan.hold, solver.grid
    start, rest = later(situation, hold, begin, grid.fine), []
    leg = replace(plan.leg, goal=replace(plan.leg.goal, since=0.0))
    if until < hold.end:
        there = later(start, hold, until, grid.fine)
        leg = Leg(Goal(there.state[POSE]), speeds=tuple(there.speeds.tolist()))
        rest = [there.in_force.delayed(-until)]
    aimed = replace(start, course=Course((leg,)), leg=0).from_zero()
    part = hold.until(until).starting_at(begin, hold.at(begin)).delayed(-begin)
    known = rolled_out(replace(plan, leg=leg), aimed, grid.thinned(part))
    search = ArrivalSearch(solver, aimed, seed, known, detour=0.0)
    found = search.improve_once(deadline)
    if found is None or found is known:
        return None, search.work
    further = replace(plan, hold=joined([found.hold, *rest]))
    return extended(situation, plan, begin, further, solver), search.work
