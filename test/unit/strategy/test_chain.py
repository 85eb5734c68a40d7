# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Chains on a floor: each search gives a whole that takes less time, or none."""

import math
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from floor_plans import DOORWAY, SIDEWAYS, floor_of, pose

from sphere_nmpc.model.course import LegEnd
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import POSE, state_error, without_momentum
from sphere_nmpc.solver.roll_out import roll_out
from sphere_nmpc.strategy.clearance import Margin, is_clear
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.plan import Plan
from sphere_nmpc.strategy.time_optimal.chain import later, replanned
from sphere_nmpc.strategy.time_optimal.search_task import SearchTask, solver_for
from sphere_nmpc.strategy.time_optimal.settings import TimeOptimalSettings

pytestmark = pytest.mark.slow

ROBOT, TUNING = RobotParameters(), TimeOptimalSettings()
SOLVER = solver_for(ROBOT, TUNING)
LIMIT, RAMP = ROBOT.max_rotor_speed, ROBOT.max_rotor_acceleration
SITUATION = Situation.of(
    0.0, without_momentum(pose(1.0, 3.0)), pose(4.5, 0.6, SIDEWAYS), np.zeros(2), ROBOT.lumped,
    floor=floor_of([*DOORWAY, (1.8, 0.0, 1.9, 2.2)]),
).from_zero()


GAIN = 2e-3
"""Time that a part has to gain [s]."""
MOST = 200
"""Searches until one has to have found something; a tenth is usual. What is found depends on the
last digits of floats."""


def searched(seed: int, known: Plan | None = None) -> Plan | str:
    return SearchTask(ROBOT, TUNING, SITUATION, seed, 50_000, math.inf, known is None, known)()


@pytest.fixture(scope="module")
def chain() -> list[Plan]:
    """Plans from the same instant, each found from the one before, until parts gain time."""
    found, arrived = [searched(1)], list[float]()
    for seed in range(2, MOST):
        plan = searched(seed, found[-1])
        found += [plan] if isinstance(plan, Plan) else []
        if found[-1].leg.end is LegEnd.REST:
            arrived.append(found[-1].end)
            if arrived[-1] < arrived[0] - GAIN:
                break
    return found


def test_a_chain_is_extended_to_the_goal_and_takes_less_time_with_each_search(chain) -> None:
    assert all(np.diff([plan.cost for plan in chain]) < 0.0)
    assert chain[0].leg.end is LegEnd.THROUGH
    arrived = [plan.end for plan in chain if plan.leg.end is LegEnd.REST]
    assert arrived[-1] < arrived[0] - GAIN
    assert chain[-1].error < TUNING.arrival_error


def test_each_plan_of_a_chain_leads_from_the_start_within_all_limits(chain) -> None:
    for plan in chain:
        hold = plan.hold
        assert hold.start == 0.0 and np.allclose(hold.speeds[[0, -1]], 0.0)
        assert np.max(np.abs(hold.speeds)) <= LIMIT * (1.0 + 1e-9)
        slopes = np.diff(hold.speeds, axis=0) / hold.durations[:, None]
        assert np.max(np.abs(slopes)) <= RAMP * (1.0 + 1e-6)  # rounding of short intervals
        assert is_clear(SITUATION, hold, Margin.KEPT)
        states = roll_out(
            SITUATION.state, hold.speeds, hold.durations, ROBOT.lumped.as_array(), 1e-3
        )
        # Steps of a plan are of up to 62 ms, those here of 1 ms.
        assert state_error(states[-1], plan.leg.goal.nearest(states[-1], hold.end)) < 1e-2


def test_a_part_leads_from_one_state_in_motion_to_the_other(chain) -> None:
    whole = next(plan for plan in chain if plan.leg.end is LegEnd.REST)
    times, rng = whole.hold.times, np.random.default_rng(3)
    for seed in range(MOST):
        begin, until = times[np.sort(rng.choice(times.size - 1, 2, replace=False))]
        found, _ = replanned(SITUATION, whole, begin, until, SOLVER, seed, math.inf)
        if found is not None and found.end < whole.end - GAIN:
            break
    else:
        raise AssertionError("no part has gained time")
    gained = whole.end - found.end
    for before, now in ((begin, begin), (until, until - gained)):
        one, other = (
            later(SITUATION, plan.hold, at, SOLVER.grid.fine)
            for plan, at in ((whole, before), (found, now))
        )
        # What is joined is solved again for the error at the end alone, of some 1e-3.
        assert state_error(one.state, other.state[POSE]) < 2e-2
        assert np.max(np.abs(one.speeds - other.speeds)) < 5e-2 * LIMIT


def test_a_plan_is_led_on_from_where_it_leads_to_although_it_was_aimed_elsewhere(chain) -> None:
    """A millimetre off, fifty times the error with which a plan to a goal counts as there."""
    off = chain[0].leg.goal.pose + np.array((1e-3, 0.0, 0.0, 0.0, 0.0, 0.0))
    known = replace(chain[0], leg=replace(chain[0].leg, goal=replace(chain[0].leg.goal, pose=off)))
    for seed in range(MOST):
        found = searched(seed, known)
        if isinstance(found, Plan):
            break
    else:
        raise AssertionError("it has never been led on")
    assert found.cost < known.cost


def test_after_failed_searches_a_plan_is_led_on_from_its_end_too(monkeypatch, chain) -> None:
    """Also to places nearer than the farthest one in sight; without failures it is not."""
    begun = list[tuple[bool, int]]()

    def searched_from(task: SearchTask, _: float) -> None:
        at_end = state_error(task.situation.state, chain[0].states[-1, POSE]) < 1e-6
        begun.append((task.from_rest and at_end, task.failed))

    monkeypatch.setattr(SearchTask, "_new", searched_from)
    for failed, seed in product((0, 3), range(40)):
        SearchTask(ROBOT, TUNING, SITUATION, seed, 1, math.inf, False, chain[0], failed)()
    assert set(begun[:40]) == {(False, 0)}
    assert {count for _, count in begun[40:]} == {0, 1, 2, 3}
    assert {(True, 2), (False, 2)} <= set(begun[40:]) and (True, 0) not in begun[40:]
