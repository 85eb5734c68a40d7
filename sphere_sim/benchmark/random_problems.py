# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Random problems: costs of the solver and of IPOPT from the same initial guess."""

from collections.abc import Iterator

import numpy as np

from sphere_nmpc.solver.problem import SolverSettings
from sphere_nmpc.solver.solve import solve
from sphere_sim.benchmark.nlp_solvers import CasadiSolver
from sphere_sim.benchmark.problem import HORIZON, LIMIT, paper_problem
from sphere_sim.scenario.scenarios import draw_scenarios

NOT_WORSE = 1e-6
"""Relative excess of the cost up to which a solution counts as not worse [-]."""

STARTS = 8
"""Initial guesses of the multi-start: the common one and seven random ones."""

_OFFLINE = SolverSettings(max_iterations=300)
_JUDGED = SolverSettings(max_iterations=0)
"""Only the cost of the initial guess is computed."""


class Comparison:
    """Costs of the solver and of IPOPT on the same random problems."""

    def __init__(self) -> None:
        self.costs: list[tuple[float, float, float]] = []
        """Cost from the common initial guess, the least of `STARTS` guesses, and IPOPT's."""
        self.times: list[tuple[float, float]] = []
        """Wall time of the first two [s]."""

    def run(self, ipopt: CasadiSolver, number: int, seed: int) -> Iterator[None]:
        """Solve problems with both solvers; yield after each.

        Goals are as in `draw_scenarios`, states within 1 m of them in x and y. IPOPT starts at
        rest; `seed` is that of the problems and of the initial guesses.
        """
        rng = np.random.default_rng(seed)
        for scenario in draw_scenarios(number, seed):
            in_force = rng.uniform(-LIMIT, LIMIT, 2)
            # Within reach of the horizon: farther away all solutions run at full speed.
            state = scenario.start.copy()
            state[0:2] = scenario.goal[0:2] + rng.uniform(-1.0, 1.0, 2)
            problem = paper_problem(state, scenario.goal, in_force)
            starts = rng.uniform(-LIMIT, LIMIT, (STARTS, HORIZON, 2))
            starts[0] = 0.0
            parameters = np.concatenate((state, scenario.goal, in_force))
            v, _ = ipopt.minimise(np.zeros(2 * HORIZON), parameters)
            knots = LIMIT * np.clip(v, -1.0, 1.0).reshape(-1, 2)
            theirs = solve(problem, knots, _JUDGED).cost
            answers = [solve(problem, start, _OFFLINE) for start in starts]
            least = min(answer.cost for answer in answers)
            self.costs.append((answers[0].cost, least, theirs))
            took = [answer.solve_time for answer in answers]
            self.times.append((took[0], sum(took)))
            yield

    def summary(self) -> dict[str, float]:
        """Return the shares of not worse and of better costs, and the excess of the others."""
        result: dict[str, float] = {"problems": float(len(self.costs))}
        costs, times = np.array(self.costs), np.array(self.times)
        for i, name in enumerate(("same_start", f"{STARTS}_starts")):
            excess = (costs[:, i] - costs[:, 2]) / costs[:, 2]
            worse = excess[excess > NOT_WORSE]
            result[f"{name}_not_worse"] = float(np.mean(excess <= NOT_WORSE))
            result[f"{name}_better"] = float(np.mean(excess < -NOT_WORSE))
            result[f"{name}_excess_median_where_worse"] = (
                float(np.median(worse)) if worse.size else 0.0
            )
            result[f"{name}_median_ms"] = 1e3 * float(np.median(times[:, i]))
        return result
