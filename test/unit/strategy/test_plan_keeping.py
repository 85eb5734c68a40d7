# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The strategy `plan_keeping`: both signs of the goal, plans that are kept, and closed loops."""

from dataclasses import replace

import numpy as np
import pytest

from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import POSE, Vector, flipped_sign, without_momentum
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.solver.roll_out import roll_out
from sphere_nmpc.solver.solve import solve
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.plan_keeping import (
    PLAN_KEEPING,
    PlanKeepingStrategy,
    plan_keeping_settings,
    solve_both_signs,
)
from sphere_sim.evaluation.metrics import settling_index, state_errors
from sphere_sim.scenario.scenarios import PAPER_CASES
from sphere_sim.world.plant.rolling_plant import RollingPlant

ROBOT = RobotParameters()
SETTINGS = ControllerSettings(strategy="plan_keeping")
STEPS = 10
REST = (np.zeros((4, 2)), np.zeros((4, 2)))


def roll(start: Vector, goal: Vector, samples: int) -> tuple[Vector, Vector]:
    """Return the states every 50 ms, (K, 6), and the inputs at the samples, (samples + 1, 2)."""
    strategy, plant = PlanKeepingStrategy(SETTINGS, ROBOT), RollingPlant(ROBOT, start)
    states, inputs = [plant.state], [plant.rotor_speeds]
    period = SETTINGS.period
    for k in range(samples):
        now = Situation(k * period, without_momentum(plant.state), goal, inputs[-1], ROBOT.lumped)
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


def test_each_solution_aims_at_its_own_sign(make_problem):
    problem = make_problem("paper", 1)
    settings = plan_keeping_settings()
    answer = solve_both_signs(settings, problem, REST, 0)
    mirrored = solve_both_signs(
        settings, replace(problem, goal=flipped_sign(problem.goal)), REST, 1
    )
    # The same two problems, and the followed one is the same in both.
    for sign in (0, 1):
        assert np.array_equal(answer.inputs_for(sign), mirrored.inputs_for(1 - sign))


def test_plan_that_reaches_the_goal_is_kept(make_problem):
    """It is not replaced by one with smaller inputs that reaches the goal later."""
    problem = make_problem("paper", 2, unequal=False)
    start = np.random.default_rng(0).uniform(-80.0, 80.0, (4, 2))
    inputs = np.vstack((problem.input_in_force, start))
    end = roll_out(problem.state, inputs, problem.durations, problem.constants)[-1]
    kept = solve(replace(problem, goal=end[POSE]), start, PLAN_KEEPING)
    assert np.max(np.abs(kept.inputs[1:] - start)) < 5.0
    assert np.linalg.norm(kept.states[-1] - end) < 1e-2
