# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Solver of plans that lead to the goal and end at rest there.

A trial ends as near to the goal as possible in a given time, by least squares on a coarse grid of
knots, from a guess far away. A plan is a local solution of the minimum-time problem on the
knots of its guess, with every limit exact; at its end the rotors hold the momentum.
"""

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, TypeVar

import numpy as np

from sphere_nmpc.model import rotation
from sphere_nmpc.model.course import Leg
from sphere_nmpc.model.disturbance import UNDISTURBED, after_slope, is_zero, rest_speeds
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.goal import Goal, Orientation, moved
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import (
    INPUT_SIZE,
    POSITION,
    QUATERNION,
    Vector,
    nearer_sign,
    state_error,
    without_momentum,
)
from sphere_nmpc.solver.problem import (
    End,
    LeastSquaresProblem,
    MinimumTimeProblem,
    Solution,
    SolverSettings,
    SolveStatus,
)
from sphere_nmpc.solver.roll_out import roll_out
from sphere_nmpc.solver.solve import solve_all
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.plan import Made, Plan
from sphere_nmpc.strategy.time_optimal.initial_guesses import Guess
from sphere_nmpc.strategy.time_optimal.knots import Grid
from sphere_nmpc.strategy.time_optimal.settings import TimeOptimalSettings
from sphere_nmpc.strategy.time_optimal.steady_rolling import SteadyRolling, steady_interval

_Kind = TypeVar("_Kind", LeastSquaresProblem, MinimumTimeProblem)

_REGULARISATION = 1e-12
"""Input weight of a trial that only keeps the normal equations regular."""
_MIN_GAIN = 1e-4
"""Decrease of the duration by a step [of the unit of time] below which an arrival is converged."""
_FIRST_PROXIMAL = 1.0
"""First proximal weight of a minimum-time problem [of the unit of time]."""
_KEEPING_PROXIMAL = 100.0
"""First proximal weight where a guess is to change little [of the unit of time]."""
_CALL_WORK = 30
"""Work of a call apart from its iterations."""
_STEP_WORK = 6
"""Work of an iteration of a minimum-time problem for each interval."""
RAISES = (1.0, 5.0, 25.0, 125.0)
"""Factors by which the weight of the error is raised while an error is left."""


class Trial(NamedTuple):
    """Motion of the duration of a guess that ends as near to the goal as possible.

    Attributes
    ----------
    found : Guess
        The motion, as a guess of an arrival.
    error : float
        Distance from the goal at its end [-], infinite where it is not finite.
    work : int
        Work of the solve in microseconds or so.
    """

    found: Guess
    error: float
    work: int

    @property
    def duration(self) -> float:
        """Duration of the motion [s]."""
        return float(self.found.times[-1])


class ArrivalSolver:
    """Solver of trials and of minimum-time problems.

    Parameters
    ----------
    robot : RobotParameters
        Limits of the drives.
    grid : Grid
        Spacing of the knots, units of the robot.
    settings : TimeOptimalSettings
        Tuning of both problems.
    """

    def __init__(
        self, robot: RobotParameters, grid: Grid, settings: TimeOptimalSettings
    ) -> None:
        self.robot, self.grid, self.settings = robot, grid, settings
        self.near_distance = settings.near_distance(robot)
        """Distance [m] beyond which whole turns are left out of a search."""
        self._max_speed = robot.max_rotor_speed
        self._acceleration = robot.max_rotor_acceleration
        self._trial = SolverSettings(
            max_iterations=settings.trial_iterations, gradient_tolerance=0.0
        )

    def trials(
        self, situation: Situation, guesses: Sequence[Guess], budget: float = math.inf,
        aware: bool = False,
    ) -> list[Trial]:
        """Return the motions of the durations of guesses that end nearest to the goal.

        Parameters
        ----------
        situation : Situation
            State of the robot and speeds of its rotors at the start, and the goal.
        guesses : sequence of Guess
            Rotor speeds for a sphere without momentum, at knots that are kept. What holds the
            momentum along their motion is added, so that the same motion results but for a turn
            about the body's z axis.
        budget : float, optional
            Wall time of all of them [s].
        aware : bool, optional
            Whether the guesses have that already.
        """
        goal, orientation = situation.goal, _demanded(situation, situation.goal)
        compensated = not aware and not is_zero(situation.momentum, situation.disturbance)
        problems, starts = list[LeastSquaresProblem](), list[Vector]()
        for times, speeds, pose in guesses:
            durations, knots = times[1:] - times[:-1], speeds[1:]
            if compensated:
                knots = knots + self._compensation(situation, durations, knots)
            problems.append(self._problem(
                LeastSquaresProblem, situation, moved(pose, goal.rate, times[-1]), orientation,
                durations, self.grid.spacing, input_weight=_REGULARISATION,
            ))
            starts.append(knots)
        trials = list[Trial]()
        found = solve_all(problems, starts, self._trial, budget) if problems else []
        for guess, problem, solution in zip(guesses, problems, found, strict=True):
            member = orientation.nearest(problem.goal, solution.states[-1])
            speeds, pose = solution.inputs, moved(member, goal.rate, -guess.times[-1])
            is_finite = solution.status is not SolveStatus.NOT_FINITE
            trials.append(Trial(
                Guess(guess.times, speeds, pose),
                math.sqrt(solution.cost) if is_finite else math.inf,
                _CALL_WORK + (solution.iterations + 1) * problem.intervals,
            ))
        return trials

    def solve(
        self, situation: Situation, goal: Goal, guess: FirstOrderHold, factor: float = 1.0,
        budget: float = math.inf, kept: bool = False, coarse: bool = False,
        iterations: int | None = None, asked: float = -math.inf,
    ) -> Plan:
        """Return the fastest motion near a guess that ends at the goal.

        Parameters
        ----------
        situation : Situation
            State of the robot and speeds of its rotors at the start.
        goal : Goal
            The goal; the sign of the quaternion does not matter.
        guess : FirstOrderHold
            Initial guess, whose knots are kept in units of the duration.
        factor : float, optional
            Factor on the time that the terminal error is worth.
        budget : float, optional
            Wall time of the solve [s].
        kept : bool, optional
            Whether the guess is to change no more than it takes to lead to the goal; by default
            the duration is minimised.
        coarse : bool, optional
            Whether it is integrated in steps twice as long.
        iterations : int, optional
            Another cap on iterations than that of the settings.
        asked : float, optional
            Time [s] up to which the motors are spared; by default it is as early as possible.
        """
        tuning = self.settings
        durations = guess.durations
        steady, turns, rolling = 0, 0, SteadyRolling.of(situation.constants, self._max_speed)
        orientation = _demanded(situation, goal)
        if situation.has_small_momentum:
            steady, turns = steady_interval(guess, rolling, self._max_speed)
        if turns:
            # It bends the way to the near goal by less than what is corrected on it.
            situation = replace(
                situation, state=without_momentum(situation.state), disturbance=UNDISTURBED
            )
        max_step = (2.0 if coarse else 1.0) * self.grid.fine
        # A goal that moves: its place at the arrival, its orientation at the end of the guess.
        there = np.concatenate((goal.at(guess.start)[POSITION], goal.at(guess.end)[QUATERNION]))
        problem = self._problem(
            MinimumTimeProblem, situation, there, orientation, durations, max_step,
            goal_velocity=goal.rate[POSITION],
            error_weight=factor * tuning.error_weight * self.grid.unit,
        )
        if asked > guess.start:
            problem.effort_weight = tuning.effort_weight
            problem.least_duration = asked - guess.start
        if situation.is_out_of_balance and not situation.uncertainty > 0.0:
            # Where poses are noisy the estimate of this component changes from sample to sample
            # by more than a plan can follow, and it is left to the tilt at rest.
            body_z = rotation.matrix(there[QUATERNION])[:, 2]
            problem.momentum_row = tuning.momentum_weight * body_z
        if turns:
            self._roll_steadily(problem, rolling, guess.speeds[1:], steady, turns)
        settings = SolverSettings(
            max_iterations=iterations or tuning.iterations,
            decrease_floor=_MIN_GAIN * self.grid.unit,
            initial_damping=(_KEEPING_PROXIMAL if kept else _FIRST_PROXIMAL) * self.grid.unit,
            target_cost=tuning.arrival_error * problem.error_weight if kept else 0.0,
        )
        (solution,) = solve_all((problem,), (guess.speeds[1:],), settings, budget)
        error = problem.terminal_error(solution)
        if turns % 2:
            solution.states[steady + 1 :, QUATERNION] *= -1.0
        work = _CALL_WORK + (_STEP_WORK * solution.iterations + 1) * durations.size
        return _plan(goal, orientation, guess.start, solution, error, work, turns)

    def solves(
        self, situation: Situation, known: Plan, deadline: float = math.inf,
        iterations: int | None = None, asked: float = -math.inf,
    ) -> Iterator[Plan]:
        """Yield solutions from a known plan on, the last of which has no error if one has none.

        The error weighs more from one to the next. `deadline` is a steady clock reading [s],
        `iterations` another cap than that of the settings, `asked` as for `solve`.
        """
        for factor in RAISES:
            known = self.solve(
                situation, known.leg.goal, known.hold, factor, deadline - time.perf_counter(),
                iterations=iterations, asked=asked,
            )
            yield known
            if known.error <= self.settings.arrival_error:
                return

    def spared(
        self, situation: Situation, plan: Plan, slower: FirstOrderHold, deadline: float
    ) -> Iterator[Plan]:
        """Yield motions as long as a plan that is slowed: one of little effort, and that one.

        `deadline` is a steady clock reading [s].
        """
        guess, cap = replace(plan, hold=slower), self.settings.sparing_iterations
        *_, found = self.solves(situation, guess, deadline, cap, slower.end)
        yield found
        yield self.solve(situation, plan.leg.goal, slower, kept=True, asked=slower.end)

    def _compensation(self, situation: Situation, durations: Vector, knots: Vector) -> Vector:
        """Return the speeds that hold the momentum along knots u_1 ... u_N [rad/s], (N, 2)."""
        inputs = np.vstack((situation.speeds, knots))
        states = roll_out(
            without_momentum(situation.state), inputs, durations,
            situation.constants.as_array(), self.grid.spacing,
        )
        momenta = (
            after_slope(situation.momentum, situation.disturbance, float(time))
            for time in np.cumsum(durations)
        )
        return np.array([
            rest_speeds(momentum, state[QUATERNION])
            for momentum, state in zip(momenta, states[1:], strict=True)
        ])

    def _roll_steadily(
        self, problem: MinimumTimeProblem, rolling: SteadyRolling, guess: Vector, interval: int,
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
        self, kind: type[_Kind], situation: Situation, goal: Vector, orientation: Orientation,
        durations: Vector, max_step: float, **others: Any,
    ) -> _Kind:
        """Return a problem with the bounds of the drives, and with other fields."""
        upper = np.full((durations.size, INPUT_SIZE), self._max_speed)
        end_speeds = np.array(situation.course.legs[situation.leg].speeds)
        return kind(
            state=situation.state, goal=goal, input_in_force=situation.speeds,
            durations=durations, constants=situation.constants.as_array(), lower=-upper,
            upper=upper, end=End.STATE, end_speeds=end_speeds, input_scale=self._max_speed,
            max_acceleration=self._acceleration,
            max_step=max_step, torques=situation.disturbance.as_array(),
            turn_weights=orientation.weights, **others,
        )


def rolled_out(plan: Plan, situation: Situation, hold: FirstOrderHold) -> Plan:
    """Return what follows from a hold, what remains of a plan as it is, in a situation."""
    states = roll_out(
        situation.state, hold.speeds, hold.durations, situation.constants.as_array(),
        disturbance=situation.disturbance,
    )
    goal = replace(plan.leg.goal, pose=plan.leg.goal.nearest(states[-1], hold.end), since=hold.end)
    error = state_error(states[-1], nearer_sign(goal.pose, states[-1]))
    return replace(
        plan, hold=hold, states=states, leg=replace(plan.leg, goal=goal), error=error,
        made=replace(plan.made, cost=error**2, turns=0),
    )


def _demanded(situation: Situation, goal: Goal) -> Orientation:
    """Return what is demanded of the orientation: with momentum all, to rest there."""
    return goal.orientation if situation.has_small_momentum else Orientation.FULL


def _plan(
    goal: Goal, demanded: Orientation, start: float, solution: Solution, error: float, work: int,
    turns: int = 0,
) -> Plan:
    hold = FirstOrderHold(start + solution.times, solution.inputs)
    pose = demanded.nearest(goal.at(hold.end), solution.states[-1])
    return Plan(
        hold, solution.states, leg=Leg(replace(goal, pose=pose, since=hold.end)), error=error,
        made=Made(error**2, solution.iterations, solution.kkt_residual, work, turns=turns),
    )
