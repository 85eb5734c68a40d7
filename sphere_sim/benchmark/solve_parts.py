# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Times of the parts of a solve: roll-out, expansion and iteration of the compiled code."""

import time
from dataclasses import replace

import numpy as np

from sphere_nmpc.solver.hold_solver import HoldSolver
from sphere_nmpc.solver.problem import SolverSettings
from sphere_nmpc.solver.roll_out import roll_out
from sphere_sim.benchmark.problem import paper_problem
from sphere_sim.scenario.scenarios import PAPER_CASES

REPETITIONS = 400
_ITERATIONS = 8


def measure_parts() -> dict[str, float]:
    """Return the median times of the parts of a solve of the paper's problem [us].

    ``roll_out`` is a roll-out, ``expansion`` what derivatives, gradient and Hessian add to it,
    ``iteration`` one iteration far from the goal, ``call`` what the call from Python adds.
    """
    case = PAPER_CASES[1]
    problem = paper_problem(case.start, case.goal, np.zeros(2))
    start = np.zeros((problem.intervals, 2))
    inputs = np.vstack((problem.input_in_force, start))
    none, some = (
        HoldSolver(SolverSettings(max_iterations=cap, decrease_tolerance=0.0))
        for cap in (0, _ITERATIONS)
    )
    trivial = replace(problem, durations=problem.durations * 1e-3)
    parts: dict[str, list[float]] = {"roll": [], "expand": [], "some": [], "call": [], "roll0": []}
    for _ in range(REPETITIONS):
        parts["expand"].append(none.solve(problem, start).solve_time)
        found = some.solve(problem, start)
        parts["some"].append(found.solve_time)
        for name, which in (("roll", problem), ("roll0", trivial)):
            began = time.perf_counter()
            roll_out(which.state, inputs, which.durations, which.constants, which.max_step)
            parts[name].append(time.perf_counter() - began)
        began = time.perf_counter()
        inner = none.solve(problem, start).solve_time
        parts["call"].append(time.perf_counter() - began - inner)
    middle = {name: 1e6 * float(np.median(values)) for name, values in parts.items()}
    steps = sum(max(1.0, np.ceil(h / problem.max_step - 1e-6)) for h in problem.durations)
    # The short roll-out costs one step an interval and the same call.
    per_step = (middle["roll"] - middle["roll0"]) / (steps - problem.intervals)
    return {
        "roll_out": per_step * steps,
        "expansion": middle["expand"] - per_step * steps,
        "iteration": (middle["some"] - middle["expand"]) / found.iterations,
        "call": middle["call"],
    }
