# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The paper's problem, solved so that its plans are carried out.

Horizon, weights and cost are those of `sphere_nmpc.strategy.paper`. The differences are both
quaternion signs of the goal, and a minimisation that does not change a plan which is about to
reach the goal. A sample takes tens of microseconds: this is the strategy for high control rates
and small processors.

Aiming at the nearer one of q and -q may switch between them with each new state and make no
progress. Here each sign has a warm start of its own, and the sign whose solution costs less is
followed. While the followed plan is about to reach the goal the other sign is not solved for: it
can be better by no more than the cost that is left.

With momentum the model and the end are those of a sphere that has it: the goal is the nearest one
that the rotors can hold, and inputs are weighed by their difference from the speeds of rest there.
"""

from dataclasses import replace

from sphere_nmpc.model.disturbance import after_slope, is_zero
from sphere_nmpc.model.state import QUATERNION, Vector, angle_error, flipped_sign
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.solver.problem import LeastSquaresProblem, SolverSettings
from sphere_nmpc.solver.solve import solve
from sphere_nmpc.strategy.at_rest import (
    SATURATED,
    changed_orientation,
    holdable_goal,
    is_saturated,
)
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.paper import SETTLED_COST, PaperStrategy, SignedSolutions
from sphere_nmpc.strategy.plan import Plan, PlanStatus
from sphere_nmpc.strategy.rest import speeds_of_rest

PLAN_KEEPING = SolverSettings(max_iterations=30, decrease_floor=5e-6, initial_damping=0.02)
"""Settings for a receding horizon that carries out its plans.

Where only the terminal cost of a short horizon counts, exact minimisation finds another plan at
every sample: one with smaller inputs that reaches the goal later. An initial damping above the
curvature of the input cost (twice its weight) and below that of the terminal cost changes the warm
start only where this reduces the terminal error, and `decrease_floor` stops the iteration once the
error is small. Over 300 drawn scenarios the median settling time is 7.5 s, with exact minimisation
13 s, in a sixth of the iterations; measurement noise has less effect, too. The local minimum that
is found is sensitive: a disturbance of 1e-5 changes the settling time of a case by up to 1.5 s.
"""
OTHER_SIGN_ITERATIONS = 10
"""Cap on the iterations for the sign that is not followed; it converges over several samples."""


class PlanKeepingStrategy(PaperStrategy):
    """Receding-horizon strategy that keeps its plans; parameters as for `PaperStrategy`."""

    def change(self, settings: ControllerSettings) -> None:
        """Use other weights, horizon and cap on iterations; the warm starts are kept."""
        super().change(settings)
        self._both_settings = plan_keeping_settings(settings.max_iterations)

    def plan(self, situation: Situation) -> Plan:
        """Solve the problem for both signs of the goal that the rotors can hold."""
        if is_zero(situation.momentum, situation.disturbance):  # the same in half the time
            return super().plan(situation)
        end = self._momentum_at_end(situation)
        situation = situation.nearest_to(situation.state)
        given = situation.goal.pose
        goal = holdable_goal(given, end, situation.disturbance)
        plan = super().plan(situation.aimed_at(situation.aim(goal)))
        status, given_up = plan.status, changed_orientation(angle_error(goal, given))
        if is_saturated(situation.momentum, goal[QUATERNION], self._robot.max_rotor_speed):
            status, given_up = PlanStatus.SATURATED, SATURATED
        return replace(plan, status=status).giving_up(given_up)

    def _rest(self, situation: Situation) -> Vector:
        """Return the speeds of rest at the end of the horizon [rad/s], shape (2,)."""
        end, limit = self._momentum_at_end(situation), self._robot.max_rotor_speed
        return speeds_of_rest(end, situation.goal.pose[QUATERNION], limit)

    def _problem(self, situation: Situation, times: Vector) -> LeastSquaresProblem:
        problem = super()._problem(situation, times)
        problem.state, problem.torques = situation.state, situation.disturbance.as_array()
        return problem

    def _momentum_at_end(self, situation: Situation) -> Vector:
        """Return the momentum at the end of the horizon, shape (3,)."""
        duration = self._settings.horizon * self._settings.period
        return after_slope(situation.momentum, situation.disturbance, duration)

    def _solve(
        self, problem: LeastSquaresProblem, starts: tuple[Vector, Vector], followed: int,
        time_budget: float,
    ) -> SignedSolutions:
        """Solve for both signs of the goal's quaternion."""
        return solve_both_signs(self._both_settings, problem, starts, followed, time_budget)


def plan_keeping_settings(
    max_iterations: int = PLAN_KEEPING.max_iterations,
) -> tuple[SolverSettings, SolverSettings]:
    """Return the settings for the followed sign and for the other one, with a cap of both."""
    caps = (PLAN_KEEPING.max_iterations, OTHER_SIGN_ITERATIONS)
    followed, other = (
        replace(PLAN_KEEPING, max_iterations=min(max_iterations, cap)) for cap in caps
    )
    return followed, other


def solve_both_signs(
    settings: tuple[SolverSettings, SolverSettings],
    problem: LeastSquaresProblem,
    starts: tuple[Vector, Vector],
    followed: int,
    time_budget: float = float("inf"),
) -> SignedSolutions:
    """Solve for the followed sign and, unless that plan reaches the goal, for the other one.

    `problem` has the goal's quaternion as given; `starts` are the warm starts for it and for its
    negative, (N, 2) each [rad/s]; `followed` is the sign that was followed until now, 0 or 1. Each
    of the two solves may take `time_budget` of wall time [s].
    """
    solution = solve(_signed(problem, followed), starts[followed], settings[0], time_budget)
    if solution.cost <= SETTLED_COST:
        return SignedSolutions(solution, None, followed)
    other = 1 - followed
    second = solve(_signed(problem, other), starts[other], settings[1], time_budget)
    # Written so that a cost that is not a number is never followed.
    if second.cost < solution.cost or not solution.cost < float("inf"):
        return SignedSolutions(second, solution, other)
    return SignedSolutions(solution, second, followed)


def _signed(problem: LeastSquaresProblem, sign: int) -> LeastSquaresProblem:
    return replace(problem, goal=flipped_sign(problem.goal)) if sign else problem
