# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Algorithm 1 of the paper as printed: a short horizon with nearly all weight at its end.

Stage cost ||x - x_d||^2 + alpha ||u||^2, terminal cost beta ||x - x_d||^2 (Eq. 34) on the raw
difference of quaternions, warm start shifted by one knot with zero as its last knot (step 6).

Step 1 leaves the initial guess open. It is rest, and where that leads to a stationary point short
of the goal, loops of the rotor speeds. From upright rest with the goal straight ahead, or with a
wrong heading alone, the gradient has no component across the plane of symmetry: a descent from
rest stays in that plane and converges to a saddle point of the cost. So where the horizon has
moved on by a sample period and its end is no nearer to the goal, the problem is solved from
guesses without that symmetry, too.

Between two knots the same problem is solved with its first interval shortened, so that a higher
control rate corrects a disturbance earlier. At the paper's rate this never happens.

The model is the paper's, without momentum.
"""

from dataclasses import dataclass

import numpy as np

from sphere_nmpc.model.first_order_hold import SHORTEST, FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import INPUT_SIZE, POSE, POSITION, Vector, without_momentum
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.solver.problem import LeastSquaresProblem, Solution, SolverSettings, SolveStatus
from sphere_nmpc.solver.solve import solve
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.plan import Plan

SETTLED_COST = 1e-4
"""Cost of a plan that ends within 1e-2 of the goal, the error at which a run counts as settled."""
_MIN_DECREASE = 1e-3
"""Relative decrease of the cost in a sample period below which the point counts as stationary. A
goal straight ahead exceeds it up to 700 m away; a wrong value only costs or saves a few solves."""
_AMPLITUDE = 0.3
"""Amplitude of the guesses [of the speed limit]. From stationary points of all kinds, guesses of
0.3 and 0.7 and random ones led to the same least costs."""
NO_PROGRESS = "stationary point: no initial guess leads nearer to the goal"
"""What a plan says that none of the guesses has improved."""


@dataclass(frozen=True, eq=False)
class SignedSolutions:
    """Solutions for one or both signs of the goal's quaternion.

    Attributes
    ----------
    solution : Solution
        The one to follow.
    other : Solution or None
        That for the other sign; None where it was not solved for.
    followed : int
        Sign that is followed: 0 for the quaternion as given, 1 for its negative.
    """

    solution: Solution
    other: Solution | None
    followed: int

    @property
    def solve_time(self) -> float:
        """Wall time of all solves [s]."""
        return self.solution.solve_time + (self.other.solve_time if self.other else 0.0)

    def inputs_for(self, sign: int) -> Vector:
        """Return the knots for the warm start of a sign, shape (N + 1, 2) [rad/s]."""
        found = self.solution if sign == self.followed else self.other
        return (found or self.solution).inputs


def loops(problem: LeastSquaresProblem) -> list[Vector]:
    """Return initial guesses in which the rotor speeds run through a loop, a quarter a knot.

    The loops have both directions and start along either rotor's axis, in either sense: none is
    its own mirror image, and the bracket of the two inputs turns the sphere about its third axis.

    Returns
    -------
    list of ndarray, shape (N, 2) [rad/s]
    """
    quarters = 0.5 * np.pi * np.arange(1, problem.intervals + 1)
    guesses = []
    for begin in (0.25 * np.pi, 1.25 * np.pi):
        for direction in (1.0, -1.0):
            angles = begin + direction * quarters
            loop = np.column_stack((np.cos(angles), np.sin(angles)))
            guesses.append(problem.input_reference + _AMPLITUDE * problem.input_scale * loop)
    return guesses


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
    settled_cost : float, optional
        Cost [squared error] up to which stationary points are accepted.
    """

    def __init__(
        self, settings: ControllerSettings, robot: RobotParameters,
        input_weight_factor: float = 1.0, settled_cost: float = SETTLED_COST,
    ) -> None:
        self._robot = robot
        self._input_weight_factor = input_weight_factor
        self._settled_cost = settled_cost
        self.change(settings)
        self.reset()

    def change(self, settings: ControllerSettings) -> None:
        """Use other weights, horizon and cap on iterations; the warm start is kept."""
        self._settings = settings
        self._solver_settings = SolverSettings(max_iterations=settings.max_iterations)

    def reset(self) -> None:
        """Forget the warm starts and the grid of knots."""
        self._plans: tuple[FirstOrderHold | None, FirstOrderHold | None] = (None, None)
        self._followed = 0
        self._origin: float | None = None
        self._horizon_end, self._last_cost = -np.inf, np.inf
        self._end: Vector | None = None

    def plan(self, situation: Situation) -> Plan:
        """Solve OCP_N (Eq. 25) and return its inputs as a hold."""
        # Of a set of goals that which the last plan ends next to: the nearest one to the state is
        # another one at each sample.
        situation = situation.nearest_to(situation.state if self._end is None else self._end)
        times = self._knot_times(situation.time)
        problem = self._problem(situation, times)
        answer, solve_time, message = self._best_answer(problem, times, situation.time_budget)
        solution = answer.solution
        if solution.status is SolveStatus.NOT_FINITE:
            raise ArithmeticError("the optimal control problem has no finite cost")
        self._plans = (
            FirstOrderHold(times, answer.inputs_for(0)),
            FirstOrderHold(times, answer.inputs_for(1)),
        )
        self._followed = answer.followed
        self._end = solution.states[-1]
        capped = solution.status is not SolveStatus.CONVERGED
        message = message or (solution.status.value if capped else "")
        settings = self._settings
        pose, goal = situation.state[POSE], problem.goal
        error = settings.units.scaled(pose) - settings.units.scaled(goal)
        return Plan.found(
            FirstOrderHold(times, solution.inputs), solution.states, not capped, message,
            # The solver's cost is divided by beta and lacks the first state's stage cost.
            cost=settings.terminal_weight * solution.cost + float(error @ error),
            iterations=solution.iterations, kkt_residual=solution.kkt_residual,
            solve_time=solve_time,
        )

    def _best_answer(
        self, problem: LeastSquaresProblem, times: Vector, time_budget: float
    ) -> tuple[SignedSolutions, float, str]:
        """Return the solution from the warm start or better ones, their solve time and a message.

        Further initial guesses are tried where the warm start leads to a stationary point.
        """
        rest = problem.input_reference
        starts = [self._warm_start(plan, times[1:], rest) for plan in self._plans]
        best = self._solve(problem, (starts[0], starts[1]), self._followed, time_budget)
        solve_time, message = best.solve_time, ""
        if self._is_stationary(float(times[-1]), best.solution):
            message = NO_PROGRESS
            for guess in loops(problem):
                left = time_budget - solve_time
                if left <= 0.0:
                    break
                answer = self._solve(problem, (guess, guess), best.followed, left)
                solve_time += answer.solve_time
                if answer.solution.cost < best.solution.cost:
                    best, message = answer, ""
        return best, solve_time, message

    def _is_stationary(self, horizon_end: float, solution: Solution) -> bool:
        """Record a solution from the warm start; return whether it is stationary off the goal.

        Between two knots the end of the horizon [s] stays, and so does the cost. A warm start that
        took no iteration is stationary itself.
        """
        if horizon_end <= self._horizon_end:
            return False
        last, cost = self._last_cost, solution.cost
        self._horizon_end, self._last_cost = horizon_end, cost
        stationary = solution.iterations == 0 or not cost < (1.0 - _MIN_DECREASE) * last
        return stationary and cost > self._settled_cost

    def _solve(
        self, problem: LeastSquaresProblem, starts: tuple[Vector, Vector], followed: int,
        time_budget: float,
    ) -> SignedSolutions:
        """Solve for the goal's quaternion as it is given."""
        solution = solve(problem, starts[0], self._solver_settings, time_budget)
        return SignedSolutions(solution, None, 0)

    def _knot_times(self, now: float) -> Vector:
        period = self._settings.period
        if self._origin is None:
            self._origin = now
        passed = np.floor((now - self._origin + SHORTEST) / period)
        knots = self._origin + period * (passed + np.arange(1, self._settings.horizon + 1))
        return np.concatenate(([now], knots))

    def _warm_start(self, last: FirstOrderHold | None, times: Vector, rest: Vector) -> Vector:
        """Return the last plan at the new knots, `rest` beyond its end (step 6), shape (N, 2)."""
        if last is None:
            return np.tile(rest, (times.size, 1))
        known = times <= last.end + SHORTEST
        return np.array([last.at(t) if k else rest for t, k in zip(times, known, strict=True)])

    def _rest(self, situation: Situation) -> Vector:
        """Return the rotor speeds that cost nothing [rad/s], shape (2,)."""
        return np.zeros(INPUT_SIZE)

    def _problem(self, situation: Situation, times: Vector) -> LeastSquaresProblem:
        settings, rest = self._settings, self._rest(situation)
        input_weight = self._input_weight_factor * settings.alpha
        needed = settings.units.max_speed + float(np.max(np.abs(rest)))
        limit = min(self._robot.max_rotor_speed, needed)
        durations = np.diff(times)
        upper = np.full((durations.size, INPUT_SIZE), limit)
        # The first ramp is the one that is sent: it keeps the acceleration limit exactly.
        reach = self._robot.max_rotor_acceleration * durations[0]
        in_force = situation.speeds
        lower = -upper
        upper[0] = np.minimum(np.maximum(in_force + reach, -limit), limit)
        lower[0] = np.minimum(np.maximum(in_force - reach, -limit), limit)
        goal = situation.goal
        return LeastSquaresProblem(
            state=without_momentum(situation.state),
            goal=goal.pose,
            input_in_force=in_force,
            durations=durations,
            constants=situation.constants.as_array(),
            lower=lower,
            upper=upper,
            input_scale=limit,
            stage_weight=1.0 / settings.terminal_weight,
            input_weight=input_weight * limit**2 / settings.terminal_weight,
            max_step=settings.longest_step,
            input_reference=rest,
            position_scale=settings.units.position_scale,
            turn_weights=goal.orientation.weights,
            goal_velocity=goal.rate[POSITION],
        )
