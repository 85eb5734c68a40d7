# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from sphere_nmpc.errors import InvalidInputError
from sphere_nmpc.solver.hold_solver import HoldSolver
from sphere_nmpc.solver.problem import SolverSettings, SolveStatus

BACKENDS = ("compiled", "numpy")
EASY = 1e-6  # a target that some of the starts reach and others do not


@pytest.fixture
def search(make_problem):
    problem = make_problem("slew", 3, unequal=False, intervals=5, max_acceleration=400.0)
    starts = np.random.default_rng(4).uniform(-60.0, 60.0, (12, problem.intervals, 2))
    return problem, starts


def test_batch_gives_what_single_solves_give(make_problem):
    kinds = ("paper", "slew", "terminal", "one interval")
    problems = [make_problem(kind, seed) for seed in range(3) for kind in kinds]
    starts = [np.full((problem.intervals, 2), 20.0) for problem in problems]
    solver = HoldSolver(SolverSettings(max_iterations=10))
    batch = solver.solve_batch(problems, starts)
    assert len(batch) == len(problems)
    for i, (problem, start) in enumerate(zip(problems, starts, strict=True)):
        alone, together = solver.solve(problem, start), batch.solution(i)
        assert np.array_equal(alone.inputs, together.inputs)
        assert np.array_equal(alone.states, together.states)
        assert (alone.cost, alone.status) == (together.cost, together.status)


def test_winner_does_not_depend_on_the_threads(search):
    problem, starts = search
    solver = HoldSolver(SolverSettings(target_cost=EASY, max_iterations=60))
    everything = solver.solve_batch(problem, starts)
    winner = everything.first_success
    assert winner is not None and winner > 0, "the search is meant not to succeed at once"
    for threads in (1, 2, 3, 8):
        for _ in range(5):
            found = solver.solve_batch(problem, starts, threads=threads, stop_at_first=True)
            assert found.first_success == winner
            assert np.array_equal(found.inputs[winner], everything.inputs[winner])
            full = solver.solve_batch(problem, starts, threads=threads)
            assert np.array_equal(full.costs, everything.costs)


def test_virtual_machine_agrees(search):
    problem, starts = search
    settings = SolverSettings(target_cost=EASY, max_iterations=12)
    ours, reference = (
        HoldSolver(settings, backend).solve_batch(problem, starts[:2]) for backend in BACKENDS
    )
    assert ours.costs == pytest.approx(reference.costs, rel=1e-6)
    assert ours.statuses == reference.statuses
    assert ours.best == reference.best


@pytest.mark.parametrize("backend", BACKENDS)
def test_what_comes_after_the_winner_is_abandoned(search, backend):
    problem, starts = search
    settings = SolverSettings(target_cost=1e6)
    batch = HoldSolver(settings, backend).solve_batch(problem, starts, stop_at_first=True)
    assert batch.first_success == 0
    assert batch.statuses[0] is SolveStatus.CONVERGED
    assert set(batch.statuses[1:]) == {SolveStatus.ABANDONED}
    assert np.all(np.isinf(batch.costs[1:]))


@pytest.mark.parametrize("backend", BACKENDS)
def test_no_time_begins_nothing(search, backend):
    problem, starts = search
    batch = HoldSolver(backend=backend).solve_batch(problem, starts, threads=2, time_budget=0.0)
    assert set(batch.statuses) == {SolveStatus.ABANDONED}
    assert batch.first_success is None


def test_best_is_the_lowest_cost_and_ignores_failures(make_problem):
    good = make_problem("paper", 1)
    bad = make_problem("paper", 1, state=np.full(6, np.nan))
    batch = HoldSolver().solve_batch([bad, good], np.zeros((2, 4, 2)))
    assert batch.best == 1
    assert batch.statuses[0] is SolveStatus.NOT_FINITE


def test_empty_batch():
    for backend in BACKENDS:
        batch = HoldSolver(backend=backend).solve_batch([], [])
        assert len(batch) == 0 and batch.first_success is None


def test_counts_must_match(make_problem):
    with pytest.raises(InvalidInputError, match="2 problems and 1 starts"):
        HoldSolver().solve_batch([make_problem()] * 2, np.zeros((1, 4, 2)))
