# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The fixed-time problem behind the strategy: end at the goal, at rest, after a given time.

At rest the rotors turn at the speeds that hold the momentum. A slope changes it by a known amount
until then; with a centre of mass beside the centre it depends on the path, and the problem is
solved again with the momentum of its last solution until both agree.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from sphere_nmpc.model import rotation
from sphere_nmpc.model.disturbance import (
    UNDISTURBED,
    Disturbance,
    after_slope,
    is_zero,
    rest_speeds,
)
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import (
    INPUT_SIZE,
    MOMENTUM,
    QUATERNION,
    Vector,
    flipped_sign,
    without_momentum,
)
from sphere_nmpc.solver.hold_solver import HoldSolver
from sphere_nmpc.solver.problem import HoldProblem, SolverSettings, SolveStatus
from sphere_nmpc.solver.roll_out import roll_out
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.rest import speeds_of_rest
from sphere_nmpc.strategy.time_optimal.settings import TimeOptimalSettings
from sphere_nmpc.strategy.time_optimal.steady_rolling import SteadyRolling, steady_interval

_REGULARISATION = 1e-12
"""Input weight that only keeps the normal equations regular."""
_LEAST_DECREASE = 1e-6
"""Decrease of the cost by an iteration [of the cost] below which a solve stops."""
_CALL_WORK = 60
"""Work of a call apart from its iterations."""
_SOLVES = 3
"""Solves at most until the speeds of rest agree with the momentum at the end."""


@dataclass(frozen=True, eq=False)
class Arrival:
    """Rotor speeds that lead to the goal in a given time, the solution of a fixed-time problem.

    Attributes
    ----------
    hold : FirstOrderHold
        Knots from time 0 (now) to the arrival [s].
    states : ndarray, shape (K, 9)
        Predicted states at the knots.
    goal : ndarray, shape (6,)
        Goal with the quaternion sign that is aimed at.
    error : float
        Predicted terminal error, norm in R^6: square root of the cost, which also contains what
        exceeds the acceleration limit; inf where it is not finite, so that nothing is reached.
    iterations : int
        Solver iterations used.
    kkt_residual : float
        First-order optimality.
    work : int
        Iterations times intervals: cost of the solve, the same on every machine.
    disturbance : Disturbance
        Slope and imbalance that it was planned with.
    turns : int
        Whole turns of steady rolling that were left out of the problem.
    """

    hold: FirstOrderHold
    states: Vector
    goal: Vector
    error: float
    iterations: int
    kkt_residual: float
    work: int
    disturbance: Disturbance
    turns: int = 0

    @property
    def duration(self) -> float:
        """Time to the arrival [s]."""
        return self.hold.end

    @property
    def momentum(self) -> Vector:
        """Predicted momentum at the arrival, shape (3,) [rad/s; world frame]."""
        return self.states[-1, MOMENTUM]

    def speeds(self, factor: float) -> Vector:
        """Return rotor speeds at the knots [rad/s], (K, 2), for rolling `factor` times as fast.

        The sphere rolls in proportion to their difference from those that hold the momentum.
        """
        held = np.array([rest_speeds(x[MOMENTUM], x[QUATERNION]) for x in self.states])
        speeds: Vector = held + factor * (self.hold.speeds - held)
        return speeds


@dataclass(frozen=True)
class Accuracy:
    """Limits of a single solve.

    Attributes
    ----------
    max_iterations : int
        Cap on solver iterations.
    max_step : float
        Longest integration step [s].
    error : float
        Terminal error [norm in R^6] at which the solve stops.
    rest_speed : float
        Error of the rotor speeds at rest [rad/s] above which the problem is solved again.
    """

    max_iterations: int
    max_step: float
    error: float
    rest_speed: float = np.inf


class ArrivalSolver:
    """Solver of fixed-time problems.

    Parameters
    ----------
    robot : RobotParameters
        Limits of the drives.
    period : float
        Sample period: spacing of the knots [s].
    accuracy : Accuracy
        Limits of each solve.
    settings : TimeOptimalSettings
        Spacing of the knots, share of the acceleration limit, weight of the penalty.
    """

    def __init__(
        self, robot: RobotParameters, period: float, accuracy: Accuracy,
        settings: TimeOptimalSettings,
    ) -> None:
        self._max_speed = robot.max_rotor_speed
        self._acceleration = settings.acceleration_share * robot.max_rotor_acceleration
        self._period = period
        self._max_step = accuracy.max_step
        self._rest_speed = accuracy.rest_speed
        self._settings = settings
        self._solver = HoldSolver(
            SolverSettings(
                max_iterations=accuracy.max_iterations,
                gradient_tolerance=0.0,
                decrease_tolerance=_LEAST_DECREASE,
                target_cost=accuracy.error**2,
            )
        )

    def solve(
        self, situation: Situation, goal: Vector, duration: float, guess: FirstOrderHold,
        to_first_knot: float, unaware: bool = False,
    ) -> Arrival:
        """Find rotor speeds that end at `goal` after `duration`, or as near as possible.

        Parameters
        ----------
        situation : Situation
            State of the robot and speeds of its rotors at the start.
        goal : ndarray, shape (6,)
            Goal with the quaternion sign that is aimed at.
        duration : float
            Time to the arrival [s].
        guess : FirstOrderHold
            Initial guess; it is stretched in time to end at `duration`.
        to_first_knot : float
            Time to the first knot [s].
        unaware : bool, optional
            Whether the guess is for a sphere without momentum: what holds the momentum along its
            motion is then added, so that the same motion results but for a turn about the body's
            z axis.
        """
        durations = knot_durations(
            duration, self._period, to_first_knot, self._settings,
            everywhere=not self._settings.is_small(situation),
        )
        rolling = SteadyRolling.of(situation.constants, self._max_speed)
        steady, turns = (0, 0)
        if self._settings.is_small(situation):
            steady, turns = steady_interval(durations, rolling)
        if turns:
            # It bends the way to the near goal by less than what is corrected on it.
            situation = replace(
                situation, state=without_momentum(situation.state), disturbance=UNDISTURBED
            )
        times = np.concatenate(([0.0], np.cumsum(durations)))
        scaled = times[1:] * (guess.end / duration)
        start = np.column_stack([np.interp(scaled, guess.times, row) for row in guess.speeds.T])
        if unaware and not is_zero(situation.momentum, situation.disturbance):
            start = start + self._compensation(situation, durations, start)
        momentum = self._momentum_at_end(situation, durations, start)
        # A turn of the shell changes the sign of the quaternion.
        target = flipped_sign(goal) if turns % 2 else goal
        iterations = 0
        for _ in range(_SOLVES):
            rest = speeds_of_rest(momentum, goal[QUATERNION], self._max_speed)
            problem = self._problem(situation, target, durations, rest)
            if steady:
                self._roll_steadily(problem, rolling, start, steady, turns)
            solution = self._solver.solve(problem, start)
            iterations += solution.iterations
            if not situation.disturbance.imbalance.any():
                break
            momentum = solution.states[-1, MOMENTUM]
            ended = speeds_of_rest(momentum, goal[QUATERNION], self._max_speed)
            if np.max(np.abs(ended - rest)) <= self._rest_speed:
                break
            start = solution.inputs[1:]
        if turns % 2:
            solution.states[steady + 1 :, QUATERNION] *= -1.0
        finite = solution.status is not SolveStatus.NOT_FINITE
        error = math.sqrt(solution.cost) if finite else math.inf
        return Arrival(
            FirstOrderHold(times, solution.inputs), solution.states, goal,
            error, iterations, solution.kkt_residual,
            _CALL_WORK + (iterations + 1) * problem.intervals,
            situation.disturbance, turns,
        )

    def _compensation(self, situation: Situation, durations: Vector, knots: Vector) -> Vector:
        """Return the speeds that hold the momentum along knots u_1 ... u_N [rad/s], (N, 2)."""
        inputs = np.vstack((situation.input_in_force, knots))
        states = roll_out(
            without_momentum(situation.state), inputs, durations,
            situation.constants.as_array(), self._max_step,
        )
        momenta = (
            after_slope(situation.momentum, situation.disturbance, float(time))
            for time in np.cumsum(durations)
        )
        return np.array([
            rest_speeds(momentum, state[QUATERNION])
            for momentum, state in zip(momenta, states[1:], strict=True)
        ])

    def _momentum_at_end(self, situation: Situation, durations: Vector, knots: Vector) -> Vector:
        """Return the momentum after knots u_1 ... u_N [rad/s], shape (N, 2)."""
        disturbance = situation.disturbance
        if disturbance.imbalance.any():
            inputs = np.vstack((situation.input_in_force, knots))
            states = roll_out(
                situation.state, inputs, durations, situation.constants.as_array(),
                self._max_step, disturbance,
            )
            return states[-1, MOMENTUM]
        return after_slope(situation.momentum, disturbance, float(np.sum(durations)))

    def _momentum_row(self, situation: Situation, goal: Vector) -> Vector:
        """Return what lets a plan end without momentum along the body's z axis, shape (3,).

        On the way an imbalance changes that component; all else leaves it as it is. Where poses
        are noisy its estimate changes from sample to sample by more than a plan can follow, and
        it is left to the tilt at rest.
        """
        balanced = not self._settings.is_out_of_balance(situation)
        if balanced or situation.uncertainty > 0.0:
            return np.zeros(3)
        row: Vector = self._settings.momentum_weight * rotation.matrix(goal[QUATERNION])[:, 2]
        return row

    def _roll_steadily(
        self, problem: HoldProblem, rolling: SteadyRolling, guess: Vector, interval: int,
        turns: int,
    ) -> None:
        """Fix the knots of `interval` to the limits that are nearest to those of the guess."""
        knots = slice(interval - 1, interval + 1)
        corner = np.copysign(self._max_speed, np.sum(guess[knots], axis=0))
        problem.lower[knots] = problem.upper[knots] = corner
        problem.steady_interval, problem.whole_turns = interval, turns * rolling.turn_time
        # A tilt t bends the path to a circle of the radius Rs / t. It counts as much as the angle
        # by which the direction to the end of that circular path differs.
        way = rolling.speed * float(problem.durations[interval])
        weight = way / (2.0 * problem.constants[0])
        problem.steady_axis = weight * corner / np.linalg.norm(corner)

    def _problem(
        self, situation: Situation, goal: Vector, durations: Vector, rest: Vector
    ) -> HoldProblem:
        """Return the problem that ends with rotor speeds `rest` [rad/s], shape (2,)."""
        upper = np.full((durations.size, INPUT_SIZE), self._max_speed)
        lower = -upper
        # The acceleration limit of the first and the last ramp is exact, as a bound on the knot
        # whose neighbour is fixed; between other knots it is a penalty.
        in_force = np.clip(situation.input_in_force, -self._max_speed, self._max_speed)
        first, last = self._acceleration * durations[0], self._acceleration * durations[-1]
        upper[0] = np.minimum(upper[0], in_force + first)
        lower[0] = np.maximum(lower[0], in_force - first)
        if durations.size > 1:
            stop_upper = np.minimum(upper[-2], rest + last)
            stop_lower = np.maximum(lower[-2], rest - last)
            compatible = stop_lower <= stop_upper
            upper[-2] = np.where(compatible, stop_upper, upper[-2])
            lower[-2] = np.where(compatible, stop_lower, lower[-2])
        upper[-1] = lower[-1] = rest
        return HoldProblem(
            state=situation.state,
            goal=goal,
            input_in_force=situation.input_in_force,
            durations=durations,
            constants=situation.constants.as_array(),
            lower=lower,
            upper=upper,
            input_scale=self._max_speed,
            input_weight=_REGULARISATION,
            slew_weight=self._settings.slew_weight,
            max_acceleration=self._acceleration,
            max_step=self._max_step,
            disturbance=situation.disturbance,
            momentum_row=self._momentum_row(situation, goal),
        )


def knot_durations(
    duration: float, period: float, to_first_knot: float, settings: TimeOptimalSettings,
    everywhere: bool = False,
) -> Vector:
    """Return interval lengths [s] with knots at the sampling instants and at `duration`.

    The first interval reaches to the next sampling instant; the last is as short as the time of
    the arrival makes it. A long plan is a manoeuvre, one long interval of steady rolling and
    another manoeuvre, so that the size of the problem does not grow with the distance.

    Parameters
    ----------
    duration : float
        Time to the arrival [s], positive.
    period : float
        Sample period [s].
    to_first_knot : float
        Time to the first knot [s].
    settings : TimeOptimalSettings
        Shortest interval, length of a manoeuvre.
    everywhere : bool, optional
        Whether a long plan has knots during steady rolling, too: with momentum the rotor speeds
        change there with each turn of the shell.
    """
    last = duration - settings.shortest_interval * period
    instants: Vector = np.arange(to_first_knot, last, period, dtype=np.float64)
    manoeuvre = settings.manoeuvre_time
    if duration > 2.0 * manoeuvre + 2.0 * period and not everywhere:
        instants = instants[(instants <= manoeuvre) | (instants >= duration - manoeuvre)]
    return np.diff(np.concatenate(([0.0], instants, [duration])))
