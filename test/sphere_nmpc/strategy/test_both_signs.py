# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Choice between the two quaternion signs of a goal."""

from dataclasses import fields, replace

import numpy as np
import pytest

from sphere_nmpc.model.state import flipped_sign
from sphere_nmpc.solver.problem import SolveStatus
from sphere_nmpc.solver.roll_out import roll_out
from sphere_nmpc.strategy.both_signs import plan_keeping_solvers, solve_both_signs

REST = (np.zeros((4, 2)), np.zeros((4, 2)))


@pytest.fixture(scope="module")
def solvers():
    return plan_keeping_solvers()


@pytest.mark.parametrize("seed", range(6))
def test_the_cheaper_sign_is_followed(solvers, make_problem, seed):
    problem = make_problem("paper", seed)
    for followed in (0, 1):
        answer = solve_both_signs(solvers, problem, REST, followed)
        costs = [np.inf if s is None else s.cost for s in answer.solutions]
        assert answer.solution.cost == min(costs)
        assert answer.solution is answer.solutions[answer.followed]


def test_each_solution_aims_at_its_own_sign(solvers, make_problem):
    problem = make_problem("paper", 1)
    answer = solve_both_signs(solvers, problem, REST, 0)
    mirrored = solve_both_signs(
        solvers, replace(problem, goal=flipped_sign(problem.goal)), REST, 1
    )
    # The same two problems, and the followed one is the same in both.
    for sign in (0, 1):
        assert np.array_equal(answer.inputs_for(sign), mirrored.inputs_for(1 - sign))


@pytest.mark.parametrize("followed", (0, 1))
def test_other_sign_is_not_solved_for_just_before_the_goal(solvers, make_problem, followed):
    problem = make_problem("paper", input_in_force=np.zeros(2))
    goal = flipped_sign(problem.state) if followed else problem.state
    answer = solve_both_signs(solvers, replace(problem, goal=goal), REST, followed)
    assert answer.followed == followed
    assert answer.solutions[1 - followed] is None
    assert answer.inputs_for(1 - followed) is answer.solution.inputs


def test_goal_that_is_reached_with_the_other_sign_needs_no_motion(solvers, make_problem):
    problem = make_problem("paper", input_in_force=np.zeros(2))
    problem = replace(problem, goal=flipped_sign(problem.state))
    answer = solve_both_signs(solvers, problem, REST, 0)
    assert answer.followed == 1
    assert answer.solution.cost == 0.0


def test_failure_with_both_signs_shows_in_the_status(solvers, make_problem):
    problem = make_problem("paper", state=np.full(6, np.nan))
    answer = solve_both_signs(solvers, problem, REST, 0)
    assert answer.solution.status is SolveStatus.NOT_FINITE


def test_plan_that_reaches_the_goal_is_kept(solvers, make_problem):
    """It is not replaced by one with smaller inputs that reaches the goal later."""
    problem = make_problem("paper", 2, unequal=False)
    start = np.random.default_rng(0).uniform(-80.0, 80.0, (4, 2))
    inputs = np.vstack((problem.input_in_force, start))
    end = roll_out(problem.state, inputs, problem.durations, problem.constants)[-1]
    kept = solvers[0].solve(replace(problem, goal=end), start)
    assert np.max(np.abs(kept.inputs[1:] - start)) < 5.0
    assert np.linalg.norm(kept.states[-1] - end) < 1e-2


def test_problem_aimed_at_another_goal_differs_in_nothing_else(make_problem):
    problem = make_problem("drift", 2)
    goal = flipped_sign(problem.goal)
    found, wanted = problem.aimed_at(goal), replace(problem, goal=goal)
    assert all(getattr(found, f.name) is getattr(wanted, f.name) for f in fields(problem))
