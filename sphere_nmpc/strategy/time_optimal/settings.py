# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Tuning of the strategy `time_optimal`."""

import math
from dataclasses import dataclass, replace

import numpy as np

from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.time_optimal.steady_rolling import SteadyRolling

_TABLE_1 = RobotParameters()


def _ramp(robot: RobotParameters) -> float:
    """Return the time in which a rotor reaches its limit of speed [s]."""
    return robot.max_rotor_speed / robot.max_rotor_acceleration


@dataclass(frozen=True)
class TimeOptimalSettings:
    """Numbers that decide how plans are searched for, followed and ended.

    They are not parameters of a node: the defaults suit the robot of Table 1 and are what the
    results in ``docs/results.md`` were obtained with. Errors are norms in R^6 (metres and
    quaternion components together), as in the metrics of a study.
    """

    small_momentum: float = 1.0
    """Momentum [rad/s] that is small. A sphere with less rolls steadily and rests at the goal as
    one without, no rotor has to be ramped to hold it before the sphere counts as resting, and a
    plan for a momentum that differs by less can still be followed."""

    # Knots of a plan

    shortest_interval: float = 0.3
    """Length [sample periods] below which an interval gets no knot of its own: within a shorter
    one the rotors can hardly change their speeds."""
    manoeuvre_time: float = 2.5
    """Time [s] at either end of a long plan that has a knot every period; between the two there is
    a single interval of steady rolling. Longer: larger problems for far goals."""
    longest_manoeuvre: float = 25.0
    """Longest such time [s] of other robots, see `of`."""

    # The problem: end at the goal, at rest, after a given time

    slew_weight: float = 10.0
    """Weight [-] of accelerations beyond the limit between inner knots. Too small: they are
    exceeded where the terminal error falls by it; too large: slower convergence."""
    momentum_weight: float = 0.02
    """Error [-] that 1 rad/s of momentum along the body's z axis at the end counts as, where an
    imbalance lets the plan change it: it turns the sphere at 0.05 rad/s."""
    least_imbalance: float = 1.5
    """Imbalance [rad/s^2] below which it counts nothing: 0.3 mm for the robot of Table 1. Just
    after a push as much may be estimated where there is none."""
    acceleration_share: float = 0.998
    """Share [-] of the acceleration limit that plans use, so that what little the penalty leaves
    stays within the limit."""
    precise_iterations: int = 40
    """Cap on solver iterations of a plan that is going to be followed."""
    precise_step: float = 0.05
    """Longest integration step [s] of such a plan."""
    precise_error: float = 1e-6
    """Terminal error [-] at which the solve of such a plan stops."""
    precise_rest_speed: float = 0.05
    """Error [rad/s] of the rotor speeds of rest at which it is not solved again: a twentieth of a
    degree a second."""
    arrival_error: float = 1e-4
    """Predicted terminal error [-] up to which a plan counts as reaching the goal. Smaller: plans
    are delayed more often; larger: larger errors at rest."""

    new_plan_error: float = 4e-4
    """The same for a new plan, a fifth of the dead band: what rolling back after a push leaves, a
    longer manoeuvre would correct at once, but small delays later do as well."""

    # Search for an early arrival

    coarse_step: float = 0.25
    """Longest integration step [s] within the search. Longer: faster, but what is found may not be
    feasible when it is solved precisely."""
    coarse_target: float = 1e-4
    """Terminal error [-] at which a solve within the search stops."""
    coarse_error: float = 1e-3
    """Terminal error [-] up to which a solve within the search counts as reaching the goal ..."""
    coarse_error_share: float = 0.02
    """... and the share [-] of the error at the start, which may itself be small ..."""
    least_coarse_error: float = 2e-4
    """... but never less than this [-], which coarse solves still reach; used alone in a strict
    search."""
    trial_iterations: int = 12
    """Cap on solver iterations of the first solve from an initial guess."""
    refining_iterations: int = 16
    """Cap on solver iterations of the second solve, for guesses that are kept."""
    shortening_iterations: int = 40
    """Cap on solver iterations of each further solve, which changes the duration."""
    kept_guesses: float = 0.25
    """Share [-] of initial guesses that are solved a second time. Smaller: more guesses are tried,
    more of them given up too early."""
    delay_of_error: float = 4.0
    """Delay for each unit of the terminal error after the first solve [s]: those of the least sum
    of duration and delay are kept."""
    least_gain: float = 0.995
    """Duration [of the best arrival] below which another is worth a further solve."""
    probe: float = 0.96
    """Duration [of an arrival] of the first attempt to shorten it ..."""
    overshoot: float = 1.002
    """... and factor [-] on the duration that the last attempt predicts, for the next one."""
    least_step: float = 0.004
    """Least share [-] by which an attempt is longer than one that failed; doubled each time."""
    stretch: float = 1.5
    """Factor [-] on the first duration beyond which no attempt is made."""
    progress: float = 0.8
    """Factor [-] on the terminal error that each longer attempt has to attain at the least."""
    bracket: float = 0.99
    """Duration [of an arrival] above which an attempt that failed ends the shortening."""
    attempts: int = 12
    """Solves at most to shorten one arrival."""
    least_shortening: float = 0.01
    """Share [-] of the time of manoeuvres below which an arrival at a distant goal is not
    shortened further."""
    typical_rate: float = 0.7
    """Decrease of the terminal error with the duration [1/s] that is assumed far from the goal or
    within its tolerance ..."""
    least_rate: float = 0.15
    """... and the least one that is believed in between."""
    earlier: float = 0.97
    """Duration [of the best arrival] of the first solve from a guess, at most."""
    perturbations: int = 4
    """Perturbations of the best arrival among the guesses of a round."""
    random_guesses: int = 10
    """Guesses of random speeds in a round after one without an arrival: with much momentum, or
    little acceleration, the rotors are hardly at their limits."""
    long_ramp: float = 1.0
    """Time from rest to the limit of a rotor [s] above which there are such guesses, too."""
    largest_perturbation: float = 0.5
    """Largest perturbation of the best arrival [of the speed limit]."""

    # Initial guesses

    half_motions: int = 6144
    """Half motions that are drawn at a time for either end, a multiple of 16. More: better guesses
    for more work."""
    tried_guesses: int = 20
    """Guesses of each such draw that are tried."""
    first_half_motions: int = 1024
    """The same before the first arrival is found, so that this takes little work, and where one is
    known that is to be improved with little."""
    first_tried_guesses: int = 6
    """The same for it."""
    window: float = 3.0
    """Time [s] by which the longest guess exceeds the lower bound of the duration; doubled where
    no half motions meet."""
    longest_window: float = 24.0
    """The longest such time [s]."""
    later: float = 0.25
    """Time [s] by which the shortest guess is longer after a draw that has led to no arrival."""
    delay_of_distance: float = 1.0
    """Delay for each metre by which two half motions miss each other [s/m], at first and at the
    least; then what the solves of the last guesses predict. Guesses are tried in the order of the
    sum of duration and delay."""
    turn_weight: float = 2.0
    """Weight of the orientation in that distance [m^2]: of the squared distance of quaternions."""
    mean_switch: float = 1.0
    """Mean time from the end to a switch of a half motion [s] ..."""
    switches_anywhere: float = 0.3
    """... but for this share [-] of switches, which are uniform over the half motion."""
    switch_shares: tuple[float, float] = (0.25, 0.3)
    """Shares [-] of half motions in which a rotor does not switch, and in which it does twice."""

    # Distant goals

    near_distance: float = 3.0
    """Distance [m] beyond which whole turns of steady rolling are left out of a search. Farther:
    larger problems; nearer: the motion to the near goal is no steady rolling any more."""

    # Intermediate goals on the way to a far one

    farthest: float = 2000.0
    """Distance [m] beyond which a goal is approached by intermediate ones ..."""
    reach: float = 1500.0
    """... at this distance [m], renewed at half of it."""
    far_distance: float = 8.0
    """Distance [m] beyond which that is done with more than a small momentum ..."""
    reach_with_momentum: float = 3.0
    """... by goals at this distance [m]; also where no arrival was found."""

    # Following a plan

    delays: tuple[float, ...] = (1.0, 1.01, 1.02, 1.04, 1.08, 1.16, 1.32)
    """Factors [-] on the time left that are tried, in this order, before a new search."""
    distant_error: float = 1e-3
    """Predicted terminal error [-] up to which a plan with whole turns left is kept: it contains
    the direction of steady rolling, which is corrected on the way."""
    further_delays: tuple[float, ...] = (1.6, 2.0, 2.5)
    """Further factors [-] for the result of a search, which near the goal may be much too short
    once it is solved precisely."""
    large_delay: float = 1.03
    """Factor [-] on the time left beyond which the whole planning effort is spent again: the
    robot does not behave as the plan assumed."""
    momentum_steps: int = 8
    """Steps in which a plan is changed where the momentum is not the predicted one ..."""
    momentum_delays: tuple[float, ...] = (1.0, 1.02, 1.05, 1.1, 1.2)
    """... with these factors [-] on the time left that are tried in each."""
    improvement_divisor: int = 10
    """Each later sample spends the planning effort over this on an earlier arrival."""
    largest_growth: float = 8.0
    """Largest factor [-] on the planning effort, and on the longest wall time, of a search from
    rest: doubled after each search without an arrival. A robot whose sample period is short for it
    has large problems, and none is found with the effort for Table 1; four times that was enough
    for each robot tried. Such a search has to end before a worker that does not answer is
    replaced."""
    fruitless_searches: int = 10
    """Number of such searches in succession without an earlier arrival after which none follows:
    the way to a distant goal takes hundreds of samples."""
    least_search_time: float = 5e-3
    """Wall time left [s] below which no such search begins."""
    fixed_time: float = 1.0
    """Time left of a plan [s] below which no earlier arrival is searched for."""
    ended_time: float = 1e-3
    """Time left of a plan [s] below which it has ended."""
    last_periods: tuple[float, float] = (4.5, 1.5)
    """Time left of a plan [sample periods] below which disturbances can be corrected only in part,
    and hardly at all: too few knots are left."""
    last_errors: tuple[float, float] = (0.2, 0.7)
    """Terminal error [of the dead band] that is accepted then, rather than a delay."""

    # Searches from rest and slip

    search_ahead: float = 0.1
    """Time [s] from the request of a search beside the control loop to the start of its plan,
    where the sphere moves; doubled after a search that took longer ..."""
    search_farthest_ahead: float = 0.5
    """... up to this time [s]."""
    longest_search: float = 0.2
    """Wall time [s] after which such a search stops."""
    slip_acceleration: float = 0.43
    """Share [-] of the acceleration limit that a new plan uses where the sphere has slipped. On
    floors of friction 0.15 to 0.2 one that uses all of it slips with every plan and never
    arrives."""

    attained_share: float = 0.97
    """Share [-] that plans use of the acceleration that the drives are found to attain: a limit of
    torque allows a few per cent less in some orientations."""
    same_acceleration: float = 0.03
    """Relative change of that acceleration [-] up to which the limit of plans is kept."""

    # Holding at the goal

    held_speed_factor: float = 500.0
    """Deviation from the speeds of rest with which a sphere counts as resting beyond the small
    momentum, over the standard deviation of the state estimate [rad/s]: noise of the poses moves
    the estimate of the momentum by a few rad/s."""
    held_goal_factor: float = 60.0
    """Momentum along the body's z axis that a goal may have besides, over the same [rad/s]: with a
    momentum of 1 rad/s noise of 0.1 rad/s would tilt the goal by 6 degrees."""
    largest_change_of_goal: float = 0.2
    """Change of the orientation aimed at [rad] above which a plan is dropped, where the momentum
    cannot be held at the goal itself."""
    unloading_share: float = 0.8
    """Share of the speed limit [-] at which a rotor of a sphere out of balance is unloaded ..."""
    unloaded_share: float = -0.5
    """... until it is at this share, on the other side."""
    held_dead_band: float = 7e-3
    """Error [-] below which the sphere comes to rest at the goal with momentum, which lets all of
    the error be corrected without another manoeuvre."""
    turning_time: float = 3.0
    """Time constant [s] with which a tilt lets the momentum correct a turn about body z ..."""
    noisy_turning_time: float = 1.2
    """... and where poses are noisy: the more momentum, the faster a tilt that is not known turns
    the sphere, and near the limit of the rotors 3 s let it turn by 3 degrees."""
    largest_tilt: float = 4e-3
    """Largest such tilt [rad]; it adds 2e-3 to the error."""
    tilt_factor: float = 2.0
    """What is added to it, over the standard deviation of the state estimate [rad]."""
    rest_time: float = 1.0
    """Time [s] for which a command goes on to hold the momentum at its end."""
    least_dead_band: float = 2e-3
    """Error [-] below which the rotors stay at rest at the goal where there is no noise ..."""
    largest_dead_band: float = 6e-2
    """... and with the most noise."""
    noise_factor: float = 50.0
    """Dead band over the standard deviation of the process noise [-]."""
    uncertainty_factor: float = 3.0
    """Dead band over the standard deviation of the state estimate [-]: no plan ends closer."""
    leaving_uncertainty_factor: float = 1.5
    """Factor [-] on that part once at rest, where more poses show the true error."""
    leaving_error: float = 8e-3
    """Error [-] up to which the sphere stays at rest in any case: a plan to correct less leads
    through errors above 1e-2."""
    correction_noise: float = 2e-4
    """Process noise [m, -; a sample] above which errors within the dead band are corrected by
    rolling; below it they do not grow."""
    correction_horizon: int = 4
    """Horizon [knots] of the paper's problem that does so."""
    correction_weight: float = 100.0
    """Factor [-] on its input weight. Large, so that it corrects what rolling itself corrects and
    leaves alone what takes a manoeuvre."""

    def of(self, robot: RobotParameters) -> "TimeOptimalSettings":
        """Return the settings for a robot other than that of Table 1.

        A manoeuvre takes as long as about a turn of the shell and its ramps, over as many radii.
        """
        rolling = SteadyRolling.of(robot.lumped, robot.max_rotor_speed)
        first = SteadyRolling.of(_TABLE_1.lumped, _TABLE_1.max_rotor_speed)
        ramps = 2.0 * (_ramp(robot) - _ramp(_TABLE_1))
        manoeuvre = self.manoeuvre_time * rolling.turn_time / first.turn_time + ramps
        near = self.near_distance * robot.shell_radius / _TABLE_1.shell_radius
        return replace(
            self,
            manoeuvre_time=min(max(manoeuvre, self.manoeuvre_time), self.longest_manoeuvre),
            near_distance=near + max(0.0, ramps) * rolling.speed,
        )

    def is_small(self, situation: Situation) -> bool:
        """Return whether the momentum is small, together with what is added in the next second."""
        disturbance = situation.disturbance
        vectors = situation.momentum, disturbance.slope, disturbance.imbalance
        # On three numbers a norm by NumPy takes twice as long.
        return sum(math.sqrt(v.dot(v)) for v in vectors) < self.small_momentum

    def is_out_of_balance(self, situation: Situation) -> bool:
        """Return whether plans end without momentum along the body's z axis by an imbalance."""
        return float(np.linalg.norm(situation.disturbance.imbalance)) >= self.least_imbalance

    def growth(self, fruitless: int) -> float:
        """Return the factor [-] on the effort after that many searches without an arrival."""
        return min(2.0 ** min(fruitless, 60), self.largest_growth)

    def stretched(self, duration: float, factor: float) -> float:
        """Return a duration [s] changed by a factor [-] on what of it manoeuvres take at most."""
        return duration + (factor - 1.0) * min(duration, 2.0 * self.manoeuvre_time)

    def kept_error(self, turns: int) -> float:
        """Return the terminal error [-] up to which a plan is kept, with whole turns left out."""
        return self.distant_error if turns else self.arrival_error

    def dead_band(self, noise: float, uncertainty: float) -> float:
        """Return the error [-] within which the sphere rests at the goal.

        Parameters
        ----------
        noise : float
            Standard deviation of the process noise [m, -; a sample].
        uncertainty : float
            Standard deviation of the state estimate's error in R^6.
        """
        wanted = max(self.noise_factor * noise, self.uncertainty_factor * uncertainty)
        return min(max(wanted, self.least_dead_band), self.largest_dead_band)

    def leaving_band(self, uncertainty: float) -> float:
        """Return the error [-] beyond which a sphere that came to rest now is to leave again."""
        widened = self.leaving_uncertainty_factor * (self.uncertainty_factor * uncertainty)
        return max(self.leaving_error, widened)

    def accepted_error(self, periods_left: float) -> float:
        """Return the terminal error [of the dead band] that is accepted this near the arrival."""
        if periods_left >= self.last_periods[0]:
            return 0.0
        return self.last_errors[0 if periods_left >= self.last_periods[1] else 1]
