# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Plans: what they report of themselves, their times, what follows from their end on."""

import math
from dataclasses import replace

import numpy as np
import pytest
from given_plans import plan_of

from sphere_nmpc.model.course import Leg, LegEnd
from sphere_nmpc.model.disturbance import UNDISTURBED
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.goal import Goal
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import MOMENTUM, POSITION, upright_state, without_momentum
from sphere_nmpc.reporting.conditions import Condition, Kind
from sphere_nmpc.solver.roll_out import roll_out
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.plan import Plan, PlanStatus

ROBOT = RobotParameters()
START, THERE = upright_state(0.0, 0.0, 0.0), upright_state(0.5, 0.0, 0.0)
BEGIN, GAPS = 3.0, np.array([0.5, 0.25])
NOW = Situation.of(BEGIN, without_momentum(START), THERE, np.zeros(2), ROBOT.lumped)
ROLLS = Condition(Kind.PLANNED, "rolls")


@pytest.fixture
def plan() -> Plan:
    """A plan from 3.0 s on that arrives at 3.75 s, with its states."""
    made = plan_of(NOW, GAPS, np.array([[20.0, -10.0], [0.0, 0.0]]))
    states = roll_out(NOW.state, made.hold.speeds, GAPS, ROBOT.lumped.as_array())
    leg = Leg(Goal(THERE, since=BEGIN + GAPS.sum()))
    return replace(made, states=states, leg=leg, conditions=(ROLLS,))


@pytest.mark.parametrize(
    ("conditions", "message", "given_up", "unreachable"),
    [
        ((), "", "", None),
        ((ROLLS,), "rolls", "", None),
        ((ROLLS, Condition(Kind.GIVEN_UP, "turns")), "rolls", "turns", None),
        ((Condition(Kind.GIVEN_UP, "turns"), ROLLS), "rolls", "turns", None),
        ((ROLLS, Condition(Kind.NO_WAY, "no way there")), "rolls", "no way there", Kind.NO_WAY),
        (Kind.GOAL_OCCUPIED.conditions, "", "", Kind.GOAL_OCCUPIED),
    ],
    ids=["says nothing", "planned", "gives up", "in any order", "unreachable", "without words"],
)
def test_words_of_a_plan_are_those_of_its_conditions(
    plan, conditions, message, given_up, unreachable
) -> None:
    told = replace(plan, conditions=conditions)
    assert (told.message, told.given_up, told.unreachable) == (message, given_up, unreachable)


def test_what_is_given_up_is_added_and_nothing_is_added_for_no_reason(plan) -> None:
    assert plan.giving_up("") is plan
    told = plan.giving_up("turns")
    assert (told.message, told.given_up, told.unreachable) == ("rolls", "turns", None)
    assert told.giving_up("more").given_up == "turns", "the first counts"


def test_plan_whose_leg_is_passed_arrives_later_than_it_ends(plan) -> None:
    assert (plan.end, plan.duration, plan.arrival) == (3.75, 0.75, 3.75)
    leg = replace(plan.leg, end=LegEnd.THROUGH, time_left=4.0, way_left=2.5)
    passing = replace(plan, leg=leg)
    assert (passing.end, passing.duration, passing.arrival) == (3.75, 0.75, 7.75)
    assert passing.way_left(BEGIN) == pytest.approx(plan.way_left(BEGIN) + 2.5)
    assert passing.way_left(10.0) == 2.5


def test_plan_that_does_not_say_where_it_ends_has_no_arrival() -> None:
    silent = plan_of(NOW, GAPS, np.zeros((2, 2)))
    assert all(map(math.isnan, (silent.end, silent.duration, silent.arrival)))
    assert silent.way_left(BEGIN) == 0.0, "its states say it"
    stopping = replace(silent, states=silent.states[:1])
    assert math.isnan(stopping.way_left(BEGIN))
    assert replace(stopping, status=PlanStatus.HOLDING).way_left(BEGIN) == 0.0


def test_way_left_falls_to_zero_at_the_end(plan) -> None:
    ways = [plan.way_left(time) for time in (0.0, 3.0, 3.2, 3.6, 3.75, 9.0)]
    assert ways[0] == ways[1] > ways[2] > ways[3] > ways[4] == ways[5] == 0.0
    length = np.linalg.norm(np.diff(plan.states[:, POSITION], axis=0), axis=1).sum()
    assert ways[0] == pytest.approx(length)


def test_delayed_plan_is_the_same_later(plan) -> None:
    late = plan.delayed(-BEGIN)
    assert (late.hold.start, late.end, late.duration) == (0.0, 0.75, 0.75)
    np.testing.assert_array_equal(late.hold.speeds, plan.hold.speeds)
    there = (plan.at(3.3, ROBOT.lumped, UNDISTURBED), late.at(0.3, ROBOT.lumped, UNDISTURBED))
    np.testing.assert_allclose(*there, atol=1e-12)


def test_state_at_a_time_is_that_of_the_knot_before_rolled_on(plan) -> None:
    for knot, time in enumerate(plan.hold.times):
        found = plan.at(float(time), ROBOT.lumped, UNDISTURBED)
        np.testing.assert_allclose(found, plan.states[knot], atol=1e-12)
    np.testing.assert_array_equal(plan.momentum, plan.states[-1, MOMENTUM])
    rest = plan.rest(3.25)
    np.testing.assert_allclose(rest.speeds[0], [10.0, -5.0])
    assert (rest.start, rest.end) == (3.25, 3.75)


def test_spliced_plan_has_what_follows_and_still_ends_where_it_did(plan) -> None:
    after = FirstOrderHold(plan.hold.end + np.array([0.0, 0.5]), np.array([[0, 0], [5.0, 5.0]]))
    states = np.tile(plan.states[-1], (2, 1))
    longer = plan.spliced(after, states)
    np.testing.assert_array_equal(longer.hold.times, [3.0, 3.5, 3.75, 4.25])
    np.testing.assert_array_equal(longer.hold.speeds[-2:], after.speeds)
    np.testing.assert_array_equal(longer.states[:3], plan.states)
    assert len(longer.states) == len(longer.hold.times)
    assert longer.leg is plan.leg and longer.arrival == plan.arrival
    assert longer.way_left(BEGIN) == pytest.approx(plan.way_left(BEGIN)), "up to its end"


@pytest.mark.parametrize("status", PlanStatus)
def test_plan_stops_where_all_it_does_is_to_bring_the_rotors_to_rest(plan, status) -> None:
    told = replace(plan, status=status)
    assert told.stops is (status is PlanStatus.RAMP_TO_REST)
    short = replace(told, states=plan.states[:1])
    assert short.stops is (status in (PlanStatus.RAMP_TO_REST, PlanStatus.SATURATED))
