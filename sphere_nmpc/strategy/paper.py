# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Algorithm 1 of the paper as printed: a short horizon with nearly all weight at its end.

Stage cost ||x - x_d||^2 + alpha ||u||^2, terminal cost beta ||x - x_d||^2 (Eq. 34) on the raw
difference of quaternions, warm start shifted by one knot with zero as its last knot (step 6).

Between two knots the same problem is solved with its first interval shortened, so that a higher
control rate corrects a disturbance earlier. At the paper's rate this never happens.

The model is the paper's, without momentum.
"""

import numpy as np

from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import INPUT_SIZE, Vector
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.solver.hold_solver import HoldSolver
from sphere_nmpc.solver.problem import HoldProblem, HoldSolution, SolverSettings, SolveStatus
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.plan import Plan, PlanStatus

_SHORTEST_INTERVAL = 1e-6
"""Time to a knot [s] below which it counts as passed."""


class PaperStrategy:
    """Receding-horizon strategy of the paper; see `sphere_nmpc.strategy.contract.Strategy`.

    Parameters
    ----------
    settings : ControllerSettings
        Horizon N, sample period T, weights alpha and beta.
    robot : RobotParameters
        Limits of the drives.
    input_weight_factor : float, optional
        Factor on alpha.
    """

    def __init__(
        self,
        settings: ControllerSettings,
        robot: RobotParameters,
        input_weight_factor: float = 1.0,
    ) -> None:
        self._robot = robot
        self._input_weight_factor = input_weight_factor
        self.change(settings)
        self.reset()

    def change(self, settings: ControllerSettings) -> None:
        """Use other weights, horizon and cap on iterations; the warm start is kept."""
        self._settings = settings
        self._solver = HoldSolver(SolverSettings(max_iterations=settings.max_iterations))

    def reset(self) -> None:
        """Forget the warm start and the grid of knots."""
        self._last: FirstOrderHold | None = None
        self._origin: float | None = None

    def plan(self, situation: Situation) -> Plan:
        """Solve OCP_N (Eq. 25) and return its inputs as a hold."""
        times = self._knot_times(situation.time)
        problem = self._problem(situation, times)
        solution = self._solve(problem, times, situation.time_budget)
        if solution.status is SolveStatus.NOT_FINITE:
            raise ArithmeticError("the optimal control problem has no finite cost")
        capped = solution.status is not SolveStatus.CONVERGED
        settings = self._settings
        initial = float(np.sum((situation.state - situation.goal) ** 2))
        return Plan(
            PlanStatus.BEST_SO_FAR if capped else PlanStatus.SOLVED,
            FirstOrderHold(times, solution.inputs),
            solution.states,
            # The solver's cost is divided by beta and lacks the stage cost of the initial state.
            cost=settings.terminal_weight * solution.cost + initial,
            iterations=solution.iterations,
            kkt_residual=solution.kkt_residual,
            solve_time=solution.solve_time,
            message=solution.status.value,
        )

    def _solve(self, problem: HoldProblem, times: Vector, time_budget: float) -> HoldSolution:
        start = self._warm_start(self._last, times[1:], problem.input_reference)
        solution = self._solver.solve(problem, start, time_budget)
        self._last = FirstOrderHold(times, solution.inputs)
        return solution

    def _knot_times(self, now: float) -> Vector:
        period = self._settings.period
        if self._origin is None:
            self._origin = now
        passed = np.floor((now - self._origin + _SHORTEST_INTERVAL) / period)
        knots = self._origin + period * (passed + np.arange(1, self._settings.horizon + 1))
        return np.concatenate(([now], knots))

    def _warm_start(self, last: FirstOrderHold | None, times: Vector, rest: Vector) -> Vector:
        """Return the last plan at the new knots, `rest` beyond its end (step 6), shape (N, 2)."""
        if last is None:
            return np.tile(rest, (times.size, 1))
        known = times <= last.end + _SHORTEST_INTERVAL
        return np.array([last.at(t) if k else rest for t, k in zip(times, known, strict=True)])

    def _problem(self, situation: Situation, times: Vector) -> HoldProblem:
        settings, limit = self._settings, self._robot.max_rotor_speed
        input_weight = self._input_weight_factor * settings.input_weight
        durations = np.diff(times)
        upper = np.full((durations.size, INPUT_SIZE), limit)
        # The first ramp is the one that is sent: it keeps the acceleration limit exactly.
        reach = self._robot.max_rotor_acceleration * durations[0]
        in_force = situation.input_in_force
        lower = -upper
        upper[0] = np.minimum(np.maximum(in_force + reach, -limit), limit)
        lower[0] = np.minimum(np.maximum(in_force - reach, -limit), limit)
        return HoldProblem(
            state=situation.state,
            goal=situation.goal,
            input_in_force=in_force,
            durations=durations,
            constants=situation.constants.as_array(),
            lower=lower,
            upper=upper,
            input_scale=limit,
            terminal_weight=1.0,
            stage_weight=1.0 / settings.terminal_weight,
            input_weight=input_weight * limit**2 / settings.terminal_weight,
            max_step=settings.integration_step,
        )
