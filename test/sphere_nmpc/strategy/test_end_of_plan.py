# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Disturbances so near the end of a plan that too few knots are left to correct them."""

from dataclasses import replace

import numpy as np
import pytest

from sphere_nmpc.model.error_state import apply_error
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.solver.roll_out import roll_out
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.time_optimal.replanning import replan
from sphere_nmpc.strategy.time_optimal.states import Following
from sphere_nmpc.strategy.time_optimal.strategy import TimeOptimalStrategy
from sphere_sim.scenario.scenarios import PAPER_CASES

ROBOT = RobotParameters()
SETTINGS = ControllerSettings(strategy="time_optimal")
CASE = PAPER_CASES[3]
DISTURBANCE = 1.2e-3
"""Error [m] or [rad] that the sphere is moved by: inside the dead band of 2e-3."""


def advanced(now: Situation, hold: FirstOrderHold) -> Situation:
    """Return the situation a sample period later, with `hold` as planned."""
    ends = np.array([now.time, now.time + SETTINGS.period])
    inputs = np.array([hold.at(end) for end in ends])
    constants = ROBOT.lumped.as_array()
    state = roll_out(now.state, inputs, np.diff(ends), constants, 0.05)[-1]
    return replace(now, time=float(ends[1]), state=state, input_in_force=inputs[1])


@pytest.mark.parametrize("intervals", [1, 2, 3])
@pytest.mark.parametrize("component", range(5))
def test_plan_is_kept_where_it_ends_within_the_dead_band(intervals: int, component: int) -> None:
    strategy = TimeOptimalStrategy(SETTINGS, ROBOT)
    now = Situation(0.0, CASE.start, CASE.goal, np.zeros(2), ROBOT.lumped)
    plan = strategy.plan(now)
    while plan.arrival - now.time > (intervals + 0.5) * SETTINGS.period:
        now = advanced(now, plan.hold)
        plan = strategy.plan(now)
    arrival, now = plan.arrival, advanced(now, plan.hold)
    moved = np.zeros(5)
    moved[component] = DISTURBANCE
    kept = strategy.plan(replace(now, state=apply_error(now.state, moved)))
    # A delay by up to a third of the time left may remove the error; a new plan takes a second.
    assert kept.arrival < now.time + 1.35 * (arrival - now.time)


def test_rest_of_a_plan_without_a_finite_cost_is_no_plan() -> None:
    strategy = TimeOptimalStrategy(SETTINGS, ROBOT)
    now = Situation(0.0, CASE.start, CASE.goal, np.zeros(2), ROBOT.lumped)
    plan = strategy.plan(now)
    followed = strategy._state
    assert isinstance(followed, Following)
    near = replace(now, time=plan.arrival - SETTINGS.period, state=np.full(6, np.nan))
    assert replan(followed, near, 2e-3, np.inf, SETTINGS) is None
