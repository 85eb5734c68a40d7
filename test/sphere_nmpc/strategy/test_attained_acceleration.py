# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Plans for drives that attain less acceleration than their limit says."""

from dataclasses import replace

import numpy as np

from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.solver.roll_out import roll_out
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.plan import PlanStatus
from sphere_nmpc.strategy.time_optimal.settings import TimeOptimalSettings
from sphere_nmpc.strategy.time_optimal.strategy import TimeOptimalStrategy
from sphere_sim.scenario.scenarios import PAPER_CASES

ROBOT = RobotParameters()
SETTINGS = ControllerSettings(strategy="time_optimal")
CASE = PAPER_CASES[1]
START = Situation(0.0, CASE.start, CASE.goal, np.zeros(2), ROBOT.lumped)
ATTAINED = 300.0
USED = TimeOptimalSettings().attained_share * ATTAINED


def steepest(hold: FirstOrderHold) -> float:
    slopes = np.diff(hold.speeds, axis=0) / np.diff(hold.times)[:, None]
    return float(np.max(np.abs(slopes)))


def test_plan_that_is_followed_keeps_to_an_acceleration_learnt_meanwhile() -> None:
    strategy = TimeOptimalStrategy(SETTINGS, ROBOT)
    plan = strategy.plan(START)
    assert steepest(plan.hold) > 1.2 * ATTAINED
    period, in_force = SETTINGS.period, plan.hold.at(SETTINGS.period)
    inputs = np.vstack((np.zeros(2), in_force))
    constants = ROBOT.lumped.as_array()
    state = roll_out(CASE.start, inputs, np.array([period]), constants, 0.05)[-1]
    moving = replace(
        START, time=period, state=state, input_in_force=in_force, acceleration=ATTAINED
    )
    slower = strategy.plan(moving)
    assert slower.status is PlanStatus.SOLVED
    # The penalty between inner knots leaves up to a per cent beyond the limit.
    assert steepest(slower.hold) < 1.01 * USED


def test_acceleration_beyond_the_limit_changes_nothing() -> None:
    plans = [
        TimeOptimalStrategy(SETTINGS, ROBOT).plan(replace(START, acceleration=acceleration))
        for acceleration in (np.inf, 1.1 * ROBOT.max_rotor_acceleration)
    ]
    np.testing.assert_array_equal(plans[0].hold.speeds, plans[1].hold.speeds)
