# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Optimal control problem of a sample (OCP_N, Eqs. 24 and 25), its solution and its settings."""

from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from sphere_nmpc.model.disturbance import UNDISTURBED, Disturbance
from sphere_nmpc.model.integrator import DEFAULT_MAX_STEP
from sphere_nmpc.model.state import INPUT_SIZE, NO_MOMENTUM, Vector

_ZERO_INPUT: Vector = np.zeros(INPUT_SIZE)
_ZERO_INPUT.flags.writeable = False
_ALL_AXES: Vector = np.ones(3)
_ALL_AXES.flags.writeable = False


# Treated as immutable, but not frozen: that would take as long as a third of an iteration.
@dataclass(slots=True, eq=False)
class HoldProblem:
    """Find the knots u_1 ... u_N of a first-order hold that starts at the input in force u_0.

    Minimise, with x_m the state at knot m (single shooting, so Eq. 25.A holds by construction) and
    |.|_s the norm in which positions are multiplied by s = `position_scale`, and quaternions by
    the largest of the `turn_weights` w_q,

        w_T (|x_N - x_d|_s^2 + (r_h . h_N)^2 + t^2) + w_x sum_{m=1}^{N-1} |x_m - x_d|_s^2
            + w_u sum_{m=1}^{N} |(u_m - u_ref) / U|^2
            + w_s sum_{m=1}^{N} |max(0, |u_m - u_{m-1}| - a h_m) / U|^2

    subject to lower <= u_m <= upper. U = `input_scale`; a = `max_acceleration`; h_m the interval
    lengths, which need not be equal: a short first one lets the problem be solved again between
    the knots. t is the tilt of the axis at the start of an interval of steady rolling, and 0
    without one. Where the goal moves, x_d is at p_d + v_d t_m. The paper's weights over beta:
    w_T = 1, w_x = 1/beta, w_u = alpha U^2 / beta.

    With a positive `error_weight` w the durations are variables, too: sigma h_m with one factor
    sigma, the stretch. Then

        sigma sum_{m=1}^{N} h_m + w |e|_1

    is minimised subject to the bounds and |u_m - u_{m-1}| <= a sigma h_m. The terminal error e
    consists of s (p_N - p_d - v_d t_N), the vector part of q_N conj(q_d) times w_q, by
    component, (u_N - (R(q_d)^T h_N)_1,2) / U, with which the rotors hold the momentum, and
    r_h . h_N or t. The third part and r_h count only
    with momentum or disturbance; without, the bounds let the last knot be zero.

    Attributes
    ----------
    state : ndarray, shape (9,)
        x_0, the state at the start.
    goal : ndarray, shape (6,)
        x_d, a pose; q and -q of its orientation are different targets.
    input_in_force : ndarray, shape (2,)
        u_0 [rad/s].
    durations : ndarray, shape (N,)
        Interval lengths h_1 ... h_N [s].
    constants : ndarray, shape (4,)
        Lumped constants [Rs, c1, r1, r3].
    lower, upper : ndarray, shape (N, 2)
        Bounds of the knots [rad/s]; equal ones fix a knot.
    input_scale : float
        U [rad/s].
    terminal_weight, stage_weight, input_weight, slew_weight : float
        w_T, w_x, w_u, w_s.
    max_acceleration : float
        a [rad/s^2]; has no effect with fixed durations unless `slew_weight` is positive.
    max_step : float
        Longest integration step [s].
    position_scale : float
        s [1/m], what a position's error counts in the cost over that of a quaternion component.
    disturbance : Disturbance
        Slope and imbalance.
    momentum_row : ndarray, shape (3,)
        r_h [s/rad; world frame], weighs a component of the momentum at the end; has no effect
        with a stage cost, nor where the model is the paper's, without momentum and disturbance.
    input_reference : ndarray, shape (2,)
        u_ref [rad/s]: rotor speeds that cost nothing.
    turn_weights : ndarray, shape (3,)
        w_q [-]: weights of the error of the orientation about the world's axes; 0 leaves it free.
    goal_velocity : ndarray, shape (2,)
        v_d [m/s]: velocity of the goal, which is at x_d at the start.
    steady_interval : int
        Index of an interval of steady rolling, whose two knots the bounds fix to the same speeds;
        0 without one.
    steady_axis : ndarray, shape (2,)
        a, the direction of these speeds times a weight. The tilt t = a . k at the start of the
        interval, k the vertical in body axes, is a residual (not with a stage cost, and only
        where the model is the paper's): with t = 0 the sphere rolls straight on at a constant
        rate.
    whole_turns : float
        Time in that interval [s] that is not integrated, a multiple of what a turn of the shell
        takes: it leaves the orientation as it is and adds to the way in proportion.
    error_weight : float
        w, the time that a unit of the terminal error is worth [s]. Beyond the largest multiplier
        of e = 0 the solution has no error; 0 for a problem of fixed durations.
    """

    state: Vector
    goal: Vector
    input_in_force: Vector
    durations: Vector
    constants: Vector
    lower: Vector
    upper: Vector
    input_scale: float
    terminal_weight: float = 1.0
    stage_weight: float = 0.0
    input_weight: float = 0.0
    slew_weight: float = 0.0
    max_acceleration: float = np.inf
    max_step: float = DEFAULT_MAX_STEP
    position_scale: float = 1.0
    disturbance: Disturbance = UNDISTURBED
    input_reference: Vector = field(default_factory=lambda: _ZERO_INPUT)
    momentum_row: Vector = field(default_factory=lambda: NO_MOMENTUM)
    steady_interval: int = 0
    steady_axis: Vector = field(default_factory=lambda: _ZERO_INPUT)
    turn_weights: Vector = field(default_factory=lambda: _ALL_AXES)
    goal_velocity: Vector = field(default_factory=lambda: _ZERO_INPUT)
    whole_turns: float = 0.0
    error_weight: float = 0.0

    @property
    def intervals(self) -> int:
        """N, the number of intervals and of free knots."""
        return int(self.durations.size)


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
    time_budget : float
        Wall time after which the best iterate is returned [s]; infinite by default, as a budget
        makes results depend on the machine.
    target_cost : float
        Converged as soon as the cost is below this; for feasibility searches. In a minimum-time
        problem as soon as w |e|_1 is, be it with the initial guess.
    """

    max_iterations: int = 100
    gradient_tolerance: float = 1e-8
    decrease_tolerance: float = 1e-9
    decrease_floor: float = 0.0
    initial_damping: float = 1e-4
    time_budget: float = np.inf
    target_cost: float = 0.0


@dataclass(slots=True, eq=False)
class HoldSolution:
    """Answer to a `HoldProblem`; the bounds hold exactly whatever the status.

    Attributes
    ----------
    inputs : ndarray, shape (N + 1, 2)
        u_0 (in force) to u_N [rad/s].
    states : ndarray, shape (N + 1, 9)
        x_0 to x_N.
    cost : float
        Value of the objective of `HoldProblem`.
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

    inputs: Vector
    states: Vector
    cost: float
    status: SolveStatus
    iterations: int
    kkt_residual: float
    solve_time: float
    stretch: float = 1.0
