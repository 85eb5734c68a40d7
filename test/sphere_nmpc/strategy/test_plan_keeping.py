# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The strategy `plan_keeping` in closed loop."""

import numpy as np
import pytest

from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector, angle_error, flipped_sign
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.plan_keeping import PlanKeepingStrategy
from sphere_sim.evaluation.metrics import settling_index, state_errors
from sphere_sim.scenario.scenarios import PAPER_CASES
from sphere_sim.world.plant.rolling_plant import RollingPlant

ROBOT = RobotParameters()
SETTINGS = ControllerSettings(strategy="plan_keeping")
STEPS = 10


def roll(start: Vector, goal: Vector, samples: int) -> tuple[Vector, Vector]:
    """Return the states every 50 ms, (K, 6), and the inputs at the samples, (samples + 1, 2)."""
    strategy, plant = PlanKeepingStrategy(SETTINGS, ROBOT), RollingPlant(ROBOT, start)
    states, inputs = [plant.state], [plant.rotor_speeds]
    period = SETTINGS.period
    for k in range(samples):
        now = Situation(k * period, plant.state, goal, inputs[-1], ROBOT.lumped)
        hold = strategy.plan(now).hold
        for i in range(1, STEPS + 1):
            plant.advance(hold.at(now.time + i * period / STEPS), period / STEPS)
            states.append(plant.state)
        inputs.append(plant.rotor_speeds)
    return np.array(states), np.array(inputs)


@pytest.mark.parametrize(("case", "latest"), [(1, 9.5), (2, 9.0), (3, 3.5), (4, 4.0)])
def test_cases_settle_in_about_half_the_time_of_the_paper(case: int, latest: float) -> None:
    # Algorithm 1 takes 12.3, 12.5, 6.6 and 8.7 s. Rounding decides which local minimum is found,
    # with a difference of a second: 7.4 to 8.6, 6.4 to 8.1, 2.6 and 3.0 s were measured.
    scenario = PAPER_CASES[case]
    states, inputs = roll(scenario.start, scenario.goal, 24)
    index = settling_index(state_errors(states, scenario.goal))
    assert index is not None and index * SETTINGS.period / STEPS < latest
    assert np.abs(inputs).max() <= ROBOT.max_rotor_speed
    slopes = np.diff(inputs, axis=0) / SETTINGS.period
    assert np.abs(slopes).max() <= ROBOT.max_rotor_acceleration * (1.0 + 1e-12)


def test_either_sign_of_the_goal_leads_to_the_same_motion() -> None:
    scenario = PAPER_CASES[3]
    states, _ = roll(scenario.start, scenario.goal, 10)
    mirrored, _ = roll(scenario.start, flipped_sign(scenario.goal), 10)
    assert angle_error(states[-1], mirrored[-1]) < 1e-2


def test_reset_forgets_both_plans() -> None:
    scenario, strategy = PAPER_CASES[1], PlanKeepingStrategy(SETTINGS, ROBOT)
    first = Situation(0.0, scenario.start, scenario.goal, np.zeros(2), ROBOT.lumped)
    fresh = strategy.plan(first).hold.speeds
    strategy.plan(first)
    strategy.reset()
    np.testing.assert_array_equal(strategy.plan(first).hold.speeds, fresh)
