# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Single problems drawn at random: how the costs compare with IPOPT's from the same start."""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from sphere_nmpc.model.state import Vector
from sphere_nmpc.solver.hold_solver import HoldSolver
from sphere_nmpc.solver.problem import HoldProblem, SolverSettings
from sphere_nmpc.solver.roll_out import roll_out
from sphere_sim.benchmark.contender import HORIZON, LIMIT, paper_problem
from sphere_sim.benchmark.nlp_peers import CasadiSolver
from sphere_sim.scenario.scenarios import draw_scenarios

NOT_WORSE = 1e-6
"""Relative excess of cost up to which a solution counts as not worse."""

STARTS = 8
"""The common start and seven random ones; some eighth of what IPOPT takes for the one."""

_OFFLINE = SolverSettings(max_iterations=300)


@dataclass(eq=False)
class Comparison:
    """Costs of the same problems, from the same start.

    Attributes
    ----------
    ours, ours_many, ipopt : list of float
        Cost from the common start, the best of `STARTS` starts, and IPOPT's.
    ours_s, ours_many_s : list of float
        Wall time [s].
    """

    ours: list[float] = field(default_factory=list)
    ours_many: list[float] = field(default_factory=list)
    ipopt: list[float] = field(default_factory=list)
    ours_s: list[float] = field(default_factory=list)
    ours_many_s: list[float] = field(default_factory=list)

    def summary(self) -> dict[str, float]:
        """Return the shares that are not worse and how much worse the others are."""
        result: dict[str, float] = {"problems": float(len(self.ipopt))}
        peer = np.array(self.ipopt)
        for name, costs, times in (
            ("same_start", self.ours, self.ours_s),
            (f"{STARTS}_starts", self.ours_many, self.ours_many_s),
        ):
            excess = (np.array(costs) - peer) / peer
            worse = excess[excess > NOT_WORSE]
            result[f"{name}_not_worse"] = float(np.mean(excess <= NOT_WORSE))
            result[f"{name}_better"] = float(np.mean(excess < -NOT_WORSE))
            result[f"{name}_excess_median_where_worse"] = (
                float(np.median(worse)) if worse.size else 0.0
            )
            result[f"{name}_median_ms"] = 1e3 * float(np.median(times))
        return result


def compare(peer: CasadiSolver, number: int, seed: int, comparison: Comparison) -> Iterator[None]:
    """Fill `comparison` problem by problem; starts are at rest, poses as in `draw_scenarios`."""
    solver = HoldSolver(_OFFLINE)
    rng = np.random.default_rng(seed)
    for scenario in draw_scenarios(number, seed):
        in_force = rng.uniform(-LIMIT, LIMIT, 2)
        # Within reach of the horizon, or every solution is the same run at full speed.
        state = scenario.start.copy()
        state[0:2] = scenario.goal[0:2] + rng.uniform(-1.0, 1.0, 2)
        problem = paper_problem(state, scenario.goal, in_force)
        starts = rng.uniform(-LIMIT, LIMIT, (STARTS, HORIZON, 2))
        starts[0] = 0.0
        parameters = np.concatenate((state, scenario.goal, in_force))
        v, _ = peer.minimise(np.zeros(2 * HORIZON), parameters)
        comparison.ipopt.append(_cost(problem, np.clip(v, -1.0, 1.0)))
        answers = [solver.solve(problem, start) for start in starts]
        comparison.ours.append(answers[0].cost)
        comparison.ours_s.append(answers[0].solve_time)
        comparison.ours_many.append(min(answer.cost for answer in answers))
        comparison.ours_many_s.append(sum(answer.solve_time for answer in answers))
        yield


def _cost(problem: HoldProblem, v: Vector) -> float:
    """Return the cost of a peer's knots as this project computes it."""
    inputs = np.vstack((problem.input_in_force, problem.input_scale * v.reshape(-1, 2)))
    states = roll_out(
        problem.state, inputs, problem.durations, problem.constants, problem.max_step
    )
    miss = states[1:] - problem.goal
    stages = problem.stage_weight * float(np.sum(miss[:-1] ** 2))
    return float(miss[-1] @ miss[-1]) + stages + problem.input_weight * float(v @ v)
