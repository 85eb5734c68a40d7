# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Benchmarked solvers by their reported names, and those of this package."""

import numpy as np

from sphere_nmpc.model.state import INPUT_SIZE, Vector
from sphere_nmpc.solver.problem import SolverSettings, SolveStatus
from sphere_nmpc.solver.solve import solve
from sphere_nmpc.strategy.plan_keeping import plan_keeping_settings, solve_both_signs
from sphere_sim.benchmark.nlp_solvers import GeneratedSqp, Slsqp, ipopt, ipopt_compiled
from sphere_sim.benchmark.problem import HORIZON, Answer, Maker, paper_problem, shifted

ALGORITHM_1, PLAN_KEEPING, IPOPT = "paper (Algorithm 1)", "plan_keeping", "casadi ipopt"
OWN = (ALGORITHM_1, PLAN_KEEPING)
"""Entries of this package: solved to convergence as by the other solvers, and stopped early to
keep the plan in force."""

_FAILURES = (SolveStatus.NOT_FINITE, SolveStatus.STALLED)
"""How a solve ends that counts as failed; one at its cap on iterations is part of a method."""


class BothSigns:
    """Plan-keeping settings, with a warm start for each sign of the goal's quaternion."""

    def __init__(self) -> None:
        self._settings = plan_keeping_settings()

    def start(self, goal: Vector) -> None:
        """Start a run without a warm start; see `BenchmarkedSolver`."""
        self._goal = goal
        rest: Vector = np.zeros((HORIZON, INPUT_SIZE))
        self._starts = (rest, rest)
        self._followed = 0

    def solve(self, state: Vector, input_in_force: Vector) -> Answer:
        """Return the next rotor speeds; see `BenchmarkedSolver`."""
        problem = paper_problem(state, self._goal, input_in_force)
        answer = solve_both_signs(self._settings, problem, self._starts, self._followed)
        self._starts = (shifted(answer.inputs_for(0)), shifted(answer.inputs_for(1)))
        self._followed = answer.followed
        solution = answer.solution
        return Answer(solution.inputs[1], solution.status not in _FAILURES)


class AlgorithmOne:
    """Algorithm 1 of the paper: one sign of the goal's quaternion, solved to convergence."""

    def start(self, goal: Vector) -> None:
        """Start a run without a warm start; see `BenchmarkedSolver`."""
        self._goal = goal
        self._start: Vector = np.zeros((HORIZON, INPUT_SIZE))

    def solve(self, state: Vector, input_in_force: Vector) -> Answer:
        """Return the next rotor speeds; see `BenchmarkedSolver`."""
        problem = paper_problem(state, self._goal, input_in_force)
        solution = solve(problem, self._start, SolverSettings(max_iterations=100))
        self._start = shifted(solution.inputs)
        return Answer(solution.inputs[1], solution.status not in _FAILURES)


QUICK: dict[str, Maker] = {
    ALGORITHM_1: AlgorithmOne,
    PLAN_KEEPING: BothSigns,
    "scipy slsqp (casadi cost)": lambda: Slsqp(exact_gradient=False),
    IPOPT: ipopt,
}
"""Solvers whose set-up takes no compilation."""

ALL: dict[str, Maker] = {
    **QUICK,
    "scipy slsqp (casadi cost and gradient)": lambda: Slsqp(exact_gradient=True),
    "casadi ipopt (compiled)": ipopt_compiled,
    "casadi sqpmethod+qrqp (generated C)": GeneratedSqp,
}
