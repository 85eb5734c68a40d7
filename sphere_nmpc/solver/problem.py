# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Optimal control problems (OCP_N, Eqs. 24 and 25), their solutions and settings of a solve.

The layout of the compiled solver's memory is made from the fields of these classes: the numbers
and strings that annotate an array are its shape, with N intervals.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum, IntEnum
from typing import Annotated, Any, TypeVar

import numpy as np

from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import INPUT_SIZE, POSE_SIZE, Vector, without_momentum
from sphere_nmpc.model.units import DEFAULT_MAX_STEP

_Kind = TypeVar("_Kind", bound="Shooting")


def _always(*values: float) -> Callable[[], Vector]:
    """Return a function that returns one array, which cannot be written to."""
    array = np.array(values)
    array.flags.writeable = False
    return lambda: array


_STOPPED: Vector = _always(0.0, 0.0)()

class End(IntEnum):
    """What the rotor speeds at the end of a plan are to be: those of rest, given ones, or any.

    u_N = u_f + (R^T h_N)_1,2, with the rotation R of the goal and the momentum h_N at the end: the
    sphere moves as it does at speeds u_f without momentum, but for a slow turn that the third
    component of R^T h_N causes.
    """

    REST = 0
    """Rest: u_f = 0."""
    STATE = 1
    """Given state: u_f is `Shooting.end_speeds`, and with it the velocity, as the sphere rolls."""
    FREE = 2
    """Any speeds u_N within the bounds."""


# Treated as immutable, but not frozen: that would take as long as a third of an iteration.
@dataclass(slots=True, eq=False, kw_only=True)
class Shooting:
    """Find the knots u_1 ... u_N of a first-order hold that starts at the input in force u_0.

    What both problems have in common: by single shooting x_m, the state at knot m, is that of the
    model, so Eq. 25.A holds by construction; lower <= u_m <= upper; the goal x_d, which is at
    p_d + v_d t_m where it moves; and the end. Where the momentum at the end is known before the
    motion is, u_N is fixed, at the speeds of the end, clipped to the bounds.

    Attributes
    ----------
    state : ndarray, shape (9,)
        x_0, the state at the start.
    goal : ndarray, shape (6,)
        x_d, a pose; q and -q of its orientation are different targets.
    input_in_force : ndarray, shape (2,)
        u_0 [rad/s].
    durations : ndarray, shape (N,)
        Interval lengths h_1 ... h_N [s], which need not be equal: a short first one lets the
        problem be solved again between the knots.
    constants : ndarray, shape (4,)
        Lumped constants [Rs, c1, r1, r3].
    lower, upper : ndarray, shape (N, 2)
        Bounds of the knots [rad/s]; equal ones fix a knot.
    input_scale : float
        U [rad/s].
    max_acceleration : float
        a [rad/s^2].
    max_step : float
        Longest integration step [s].
    position_scale : float
        s [1/m], what a position's error counts over that of a quaternion component.
    torques : ndarray, shape (5,)
        Slope and imbalance [rad/s^2], `sphere_nmpc.model.disturbance.Disturbance.as_array`.
    turn_weights : ndarray, shape (3,)
        w_q [-]: weights of the error of the orientation about the world's axes; 0 leaves it free.
    goal_velocity : ndarray, shape (2,)
        v_d [m/s]: velocity of the goal, which is at x_d at the start.
    end : End
        What u_N is to be.
    end_speeds : ndarray, shape (2,)
        u_f [rad/s], with `End.STATE`.
    """

    state: Annotated[Vector, 9]
    goal: Annotated[Vector, 6]
    input_in_force: Annotated[Vector, 2]
    durations: Annotated[Vector, "N"]
    constants: Annotated[Vector, 4]
    lower: Annotated[Vector, "N", 2]
    upper: Annotated[Vector, "N", 2]
    input_scale: float
    max_acceleration: float = np.inf
    max_step: float = DEFAULT_MAX_STEP
    position_scale: float = 1.0
    torques: Annotated[Vector, 5] = field(default_factory=_always(0.0, 0.0, 0.0, 0.0, 0.0))
    turn_weights: Annotated[Vector, 3] = field(default_factory=_always(1.0, 1.0, 1.0))
    goal_velocity: Annotated[Vector, 2] = field(default_factory=_always(0.0, 0.0))
    end: End = End.REST
    end_speeds: Annotated[Vector, 2] = field(default_factory=_always(0.0, 0.0))

    @classmethod
    def of(
        cls: type[_Kind], robot: RobotParameters, state: Vector, goal: Vector, durations: Vector,
        input_in_force: Vector = _STOPPED, **others: Any,
    ) -> _Kind:
        """Return the problem of a robot as built, with the limits of its drives.

        The state, shape (9,), has no momentum where it is a pose, shape (6,). `others` are further
        fields.
        """
        state, durations = np.asarray(state), np.asarray(durations)
        limit = np.full((durations.size, INPUT_SIZE), robot.max_rotor_speed)
        fields: dict[str, Any] = {
            "state": without_momentum(state) if state.size == POSE_SIZE else state, "goal": goal,
            "input_in_force": input_in_force, "durations": durations,
            "constants": robot.lumped.as_array(), "lower": -limit, "upper": limit,
            "input_scale": robot.max_rotor_speed,
            "max_acceleration": robot.max_rotor_acceleration,
        }
        return cls(**fields | others)

    @property
    def intervals(self) -> int:
        """N, the number of intervals and of free knots."""
        return int(self.durations.size)

    @property
    def disturbed(self) -> bool:
        """Whether there is momentum or a torque that changes it: the paper's model has neither."""
        return bool(self.state[6:].any() or self.torques.any())


@dataclass(slots=True, eq=False, kw_only=True)
class LeastSquaresProblem(Shooting):
    """Problem of a given duration.

    Minimise, for the knots::

        |x_N - x_d|_s^2 + w_x sum_{m=1}^{N-1} |x_m - x_d|_s^2
            + w_u sum_{m=1}^{N} |(u_m - u_ref) / U|^2
            + sum_{m=1}^{N} |max(0, |u_m - u_{m-1}| - a h_m) / U|^2

    with ``|.|_s`` the norm in which positions are multiplied by s, and quaternions by the largest
    of the weights w_q. The paper's weights over beta: w_x = 1/beta, w_u = alpha U^2 / beta.

    By default the end is free, as in the paper. Otherwise u_N is fixed, for the momentum that the
    torque of the slope alone leads to in the given time.

    Attributes
    ----------
    stage_weight, input_weight : float
        w_x, w_u.
    input_reference : ndarray, shape (2,)
        u_ref [rad/s]: rotor speeds that cost nothing.
    """

    end: End = End.FREE
    stage_weight: float = 0.0
    input_weight: float
    input_reference: Annotated[Vector, 2] = field(default_factory=_always(0.0, 0.0))

    @classmethod
    def of_paper(
        cls, robot: RobotParameters, state: Vector, goal: Vector, input_in_force: Vector,
        horizon: int = 4, period: float = 0.5, alpha: float = 0.5, beta: float = 1e8,
        **others: Any,
    ) -> "LeastSquaresProblem":
        """Return OCP_N of the paper (Eqs. 25 and 34) with its N, T, alpha and beta.

        Its cost is the paper's over beta. The arguments are those of `of`.
        """
        scale = robot.max_rotor_speed
        return cls.of(
            robot, state, goal, np.full(horizon, period), input_in_force,
            stage_weight=1.0 / beta, input_weight=alpha * scale**2 / beta,
            max_acceleration=np.inf, **others,
        )


@dataclass(slots=True, eq=False, kw_only=True)
class MinimumTimeProblem(Shooting):
    """Problem whose durations are sigma h_m, with one factor sigma, the stretch.

    Minimise, for the knots and sigma::

        sigma sum_{m=1}^{N} h_m + w |e|_1
            + w_f sum_{m=1}^{N} |u_m - u_{m-1}|^2 / (a^2 sigma h_m)

    subject to ``|u_m - u_{m-1}| <= a sigma h_m, sigma sum_m h_m >= t_min``. The last sum is the
    effort [s]: the time for which rotors accelerate, by the square of the share of the limit. The
    terminal error e consists of s (p_N - p_d - v_d t_N), the vector part of q_N conj(q_d) times
    w_q, by component, (u_N - u_f - (R(q_d)^T h_N)_1,2) / U, and r_h . h_N with momentum or torque,
    or else t, the tilt of the axis at the start of an interval of steady rolling. By default the
    sphere rests at the end, and the third part is left out where the end is free. Without momentum
    and torques u_N is fixed, and that part is by how much u_f exceeds the bounds.

    Attributes
    ----------
    error_weight : float
        w, the time that a unit of the terminal error is worth [s]. Beyond the largest multiplier
        of e = 0 the solution has no error.
    momentum_row : ndarray, shape (3,)
        r_h [s/rad; world frame], weighs a component of the momentum at the end.
    steady_interval : int
        Index of an interval of steady rolling, whose two knots the bounds fix to the same speeds;
        0 without one. Only without momentum and torques.
    steady_axis : ndarray, shape (2,)
        a, the direction of these speeds times a weight. The tilt is t = a . k at the start of the
        interval, k the vertical in body axes: with t = 0 the sphere rolls straight on at a
        constant rate.
    whole_turns : float
        Time in that interval [s] that is not integrated, a multiple of what a turn of the shell
        takes: it leaves the orientation as it is and adds to the way in proportion.
    effort_weight : float
        w_f, the time that a second of effort is worth [-].
    least_duration : float
        t_min [s].
    """

    error_weight: float
    momentum_row: Annotated[Vector, 3] = field(default_factory=_always(0.0, 0.0, 0.0))
    steady_interval: int = 0
    steady_axis: Annotated[Vector, 2] = field(default_factory=_always(0.0, 0.0))
    whole_turns: float = 0.0
    effort_weight: float = 0.0
    least_duration: float = 0.0

    def terminal_error(self, solution: "Solution") -> float:
        """Return ``|e|_1`` of a solution [-], infinite where it is not finite."""
        if solution.status is SolveStatus.NOT_FINITE:
            return np.inf
        left = solution.cost - solution.stretch * float(np.sum(self.durations))
        if self.effort_weight > 0.0:
            left -= self.effort(solution.inputs, solution.stretch)
        return max(0.0, left) / self.error_weight

    def effort(self, inputs: Vector, stretch: float) -> float:
        """Return the effort [s] of speeds u_0 ... u_N, (N + 1, 2) [rad/s], times its weight."""
        durations = stretch * self.durations
        share = np.diff(inputs, axis=0) / (self.max_acceleration * durations[:, None])
        return self.effort_weight * float(np.sum(durations[:, None] * share * share))


Problem = LeastSquaresProblem | MinimumTimeProblem


class SolveStatus(Enum):
    """Outcome of a solve."""

    CONVERGED = "converged"
    CAPPED = "iteration cap"
    BUDGET = "time budget"
    NOT_FINITE = "not finite"
    """Cost or gradient at the best iterate are not finite."""
    STALLED = "no step lowers the cost"
    """The damping has exceeded its bound: at round-off, or where every trial is not finite."""


@dataclass(frozen=True)
class SolverSettings:
    """Stopping criteria of the iteration.

    Attributes
    ----------
    max_iterations : int
        Cap on trial steps: the same work on every machine.
    gradient_tolerance : float
        Converged when the KKT residual is below this [cost per scaled input].
    decrease_tolerance : float
        Converged when a step lowers the cost by less than this share of it.
    decrease_floor : float
        Converged when a step lowers the cost by less than this [cost]; in a minimum-time problem,
        when it is predicted to, whatever the other tolerances.
    initial_damping : float
        Levenberg-Marquardt damping of the first step [cost per squared scaled input]. In
        directions of less curvature than this the first steps stay near the initial guess. In a
        minimum-time problem the first proximal weight.
    target_cost : float
        Converged as soon as the cost is below this; for feasibility searches. In a minimum-time
        problem as soon as ``w |e|_1`` is, be it with the initial guess.
    """

    max_iterations: int = 100
    gradient_tolerance: float = 1e-8
    decrease_tolerance: float = 1e-9
    decrease_floor: float = 0.0
    initial_damping: float = 1e-4
    target_cost: float = 0.0


@dataclass(slots=True, eq=False)
class Solution:
    """Answer to a problem; the bounds hold exactly whatever the status.

    Attributes
    ----------
    inputs : ndarray, shape (N + 1, 2)
        u_0 (in force) to u_N [rad/s].
    states : ndarray, shape (N + 1, 9)
        x_0 to x_N.
    durations : ndarray, shape (N,)
        Those of the problem [s], which `stretch` multiplies.
    cost : float
        Value of the objective.
    status : SolveStatus
        How the solve ended.
    iterations : int
        Trial steps taken.
    kkt_residual : float
        Largest component of the projected gradient, P(v - g) - v with v = u / U; of a
        minimum-time problem the decrease that the last step was predicted to have [s].
    solve_time : float
        Wall time of the solve [s], steady clock.
    stretch : float
        sigma, the factor on the durations of a minimum-time problem; 1 otherwise.
    """

    inputs: Annotated[Vector, "N + 1", 2]
    states: Annotated[Vector, "N + 1", 9]
    durations: Annotated[Vector, "N"]
    cost: float
    status: SolveStatus
    iterations: int
    kkt_residual: float
    solve_time: float
    stretch: float = 1.0

    @property
    def times(self) -> Vector:
        """Times of the knots from 0 on [s], shape (N + 1,)."""
        return np.concatenate(([0.0], np.cumsum(self.stretch * self.durations)))
