# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The paper's problem, solved so that its plans are carried out.

Horizon, weights and cost are those of `sphere_nmpc.strategy.paper`. The differences are in
`sphere_nmpc.strategy.both_signs`: both quaternion signs of the goal, and a minimisation that does
not change a plan which is about to reach the goal. A sample takes tens of microseconds: this is
the strategy for high control rates and small processors.

With momentum the model and the end are those of a sphere that has it: the goal is the nearest one
that the rotors can hold, and inputs are weighed by their difference from the speeds of rest there.
"""

from dataclasses import replace

from sphere_nmpc.model.drift import Drift
from sphere_nmpc.model.state import QUATERNION, Vector, angle_error
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.solver.problem import HoldProblem
from sphere_nmpc.strategy.both_signs import (
    SignedSolutions,
    plan_keeping_solvers,
    solve_both_signs,
)
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.holdable_goal import given_up_angle, holdable_goal
from sphere_nmpc.strategy.paper import PaperStrategy
from sphere_nmpc.strategy.plan import Plan, PlanStatus
from sphere_nmpc.strategy.rest import SATURATED, is_saturated, speeds_of_rest


class PlanKeepingStrategy(PaperStrategy):
    """Receding-horizon strategy that keeps its plans; parameters as for `PaperStrategy`."""

    def change(self, settings: ControllerSettings) -> None:
        """Use other weights, horizon and cap on iterations; the warm starts are kept."""
        super().change(settings)
        self._solvers = plan_keeping_solvers(settings.max_iterations)

    def plan(self, situation: Situation) -> Plan:
        """Solve the problem for both signs of the goal that the rotors can hold."""
        if situation.drift.is_zero:
            return super().plan(situation)
        goal = holdable_goal(situation.goal, self._drift_at_end(situation))
        plan = super().plan(replace(situation, goal=goal))
        if is_saturated(situation.drift, goal[QUATERNION], self._robot.max_rotor_speed):
            return replace(plan, status=PlanStatus.SATURATED, given_up=SATURATED)
        return replace(plan, given_up=given_up_angle(angle_error(goal, situation.goal)))

    def _problem(self, situation: Situation, times: Vector) -> HoldProblem:
        problem = super()._problem(situation, times)
        if situation.drift.is_zero:
            return problem
        end, limit = self._drift_at_end(situation), self._robot.max_rotor_speed
        rest = speeds_of_rest(end, situation.goal[QUATERNION], limit)
        return replace(problem, drift=situation.drift.as_array(), input_reference=rest)

    def _drift_at_end(self, situation: Situation) -> Drift:
        """Return the drift at the end of the horizon."""
        return situation.drift.after_slope(self._settings.horizon * self._settings.period)

    def _solve(
        self, problem: HoldProblem, starts: tuple[Vector, Vector], followed: int,
        time_budget: float,
    ) -> SignedSolutions:
        """Solve for both signs of the goal's quaternion."""
        return solve_both_signs(self._solvers, problem, starts, followed, time_budget)
