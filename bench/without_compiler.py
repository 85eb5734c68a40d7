# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Ratio of the solve times without and with a compiler, on problems from closed loops.

    .venv/bin/python bench/without_compiler.py

Both back ends solve every problem, one after the other, in one process. Processor times are
compared, as other processes on the machine hardly change them.
"""

import copy
import time

import numpy as np

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.solver.hold_solver import HoldSolver
from sphere_nmpc.solver.problem import HoldProblem, HoldSolution, SolverSettings
from sphere_sim.evaluation.closed_loop import run_closed_loop
from sphere_sim.scenario.scenarios import draw_scenarios
from sphere_sim.world.settings import SimulatorSettings
from sphere_sim.world.simulator import Simulator

RUNS = 6
DURATION = 4.0
EACH = 40
"""Largest number of problems in each group."""
GROUPS = (("paper", 1, 4), ("time_optimal", 5, 9), ("time_optimal", 10, 19),
          ("time_optimal", 20, 60))

Solve = tuple[HoldProblem, Vector, SolverSettings]


def problems_of(strategy: str) -> list[Solve]:
    """Return the solves of a strategy in runs to random goals: problem, start, settings."""
    solves: list[Solve] = []
    solve = HoldSolver.solve

    def remember(
        solver: HoldSolver, problem: HoldProblem, start: Vector, time_budget: float | None = None
    ) -> HoldSolution:
        solves.append((copy.deepcopy(problem), start.copy(), solver.settings))
        return solve(solver, problem, start, time_budget)

    robot, settings = RobotParameters(), ControllerSettings(strategy=strategy)
    HoldSolver.solve = remember  # type: ignore[method-assign, assignment]
    try:
        for scenario in draw_scenarios(RUNS, 1):
            simulator = Simulator(SimulatorSettings(initial_state=tuple(scenario.start)), robot)
            controller = Controller(settings, robot)
            run_closed_loop(simulator, controller, scenario.goal, DURATION, settings.period)
    finally:
        HoldSolver.solve = solve  # type: ignore[method-assign]
    return solves


def times(solves: list[Solve]) -> tuple[list[float], list[float], int]:
    """Return the processor times [s] of both back ends, and the number of equal step counts."""
    found: tuple[list[float], list[float]] = ([], [])
    same = 0
    for problem, start, settings in solves:
        iterations = []
        for backend, seconds in zip(("compiled", "numpy"), found, strict=True):
            solver = HoldSolver(settings, backend)
            # The first solve builds the functions and the memory of this size.
            solver.solve(problem, start)
            began = time.thread_time()
            iterations.append(solver.solve(problem, start).iterations)
            seconds.append(time.thread_time() - began)
        same += iterations[0] == iterations[1]
    return *found, same


def main() -> None:
    print("| problems of | intervals | solved | same steps | compiled [us] | without | ratio |")
    print("|---|---|---|---|---|---|---|")
    rng = np.random.default_rng(0)
    solves = {strategy: problems_of(strategy) for strategy in ("paper", "time_optimal")}
    for strategy, least, most in GROUPS:
        fitting = [a for a in solves[strategy] if least <= a[0].intervals <= most]
        chosen = [fitting[i] for i in rng.permutation(len(fitting))[:EACH]]
        if not chosen:
            continue
        compiled, without, same = times(chosen)
        medians = 1e6 * float(np.median(compiled)), 1e6 * float(np.median(without))
        print(
            f"| {strategy} | {least} to {most} | {len(chosen)} | {same} | {medians[0]:.0f} "
            f"| {medians[1]:.0f} | {medians[1] / medians[0]:.1f} |"
        )


if __name__ == "__main__":
    main()
