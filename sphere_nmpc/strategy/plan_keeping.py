# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The paper's problem, solved so that its plans are carried out.

Horizon, weights and cost are those of `sphere_nmpc.strategy.paper`. The differences are in
`sphere_nmpc.strategy.both_signs`: both quaternion signs of the goal, and a minimisation that does
not change a plan which is about to reach the goal. A sample takes tens of microseconds: this is
the strategy for high control rates and small processors.
"""

from dataclasses import replace

from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.state import Vector
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.solver.problem import HoldProblem, HoldSolution
from sphere_nmpc.strategy.both_signs import plan_keeping_solvers, solve_both_signs
from sphere_nmpc.strategy.paper import PaperStrategy


class PlanKeepingStrategy(PaperStrategy):
    """Receding-horizon strategy that keeps its plans; parameters as for `PaperStrategy`."""

    def change(self, settings: ControllerSettings) -> None:
        """Use other weights, horizon and cap on iterations; the warm starts are kept."""
        super().change(settings)
        self._solvers = plan_keeping_solvers(settings.max_iterations)

    def reset(self) -> None:
        """Forget the warm starts and the grid of knots."""
        super().reset()
        self._plans: tuple[FirstOrderHold | None, FirstOrderHold | None] = (None, None)
        self._followed = 0

    def _solve(self, problem: HoldProblem, times: Vector, time_budget: float) -> HoldSolution:
        first, second = (self._warm_start(plan, times[1:]) for plan in self._plans)
        answer = solve_both_signs(
            self._solvers, problem, (first, second), self._followed, time_budget=time_budget
        )
        self._plans = (
            FirstOrderHold(times, answer.inputs_for(0)),
            FirstOrderHold(times, answer.inputs_for(1)),
        )
        self._followed = answer.followed
        both = (solution for solution in answer.solutions if solution is not None)
        return replace(answer.solution, solve_time=sum(solution.solve_time for solution in both))
