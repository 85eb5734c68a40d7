# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Tuning of the strategy `time_optimal`."""

from dataclasses import dataclass

import numpy as np

from sphere_nmpc.model.parameters import LumpedConstants, RobotParameters
from sphere_nmpc.model.state import Vector, angle_error, position_error
from sphere_nmpc.strategy.time_optimal.steady_rolling import SteadyRolling

_TABLE_1 = RobotParameters()


@dataclass(frozen=True)
class TimeOptimalSettings:
    """Numbers that decide how plans are searched for, followed and ended.

    They are not parameters of a node: the defaults suit the robot of Table 1 and are what the
    results in ``docs/results.md`` were obtained with. Errors are norms in R^6 (metres and
    quaternion components together), as in the metrics of a study.
    """

    # Knots of a plan

    spacing: float = 0.437
    """Spacing of the knots [1 / (c1 u_max)], but at least half of a ramp to the largest speed."""

    # Trials and minimum-time problems

    trial_iterations: int = 12
    """Cap on solver iterations of a trial."""
    error_weight: float = 10.0
    """Time that a unit of the terminal error is worth [1 / (c1 u_max)] at first; raised while an
    error is left."""
    iterations: int = 8
    """Cap on iterations of a minimum-time problem, before the error weighs more."""
    effort_weight: float = 0.1
    """Time that a second of effort is worth [-] where the motors are spared: so little that the
    arrival is no later than it may be, and so much that a step towards less effort counts."""
    sparing_iterations: int = 100
    """Cap on its iterations there: it begins farther away."""
    momentum_weight: float = 0.02
    """Error [-] that 1 rad/s of momentum along the body's z axis at the end counts as, where an
    imbalance lets the plan change it: it turns the sphere at 0.05 rad/s."""
    arrival_error: float = 2e-5
    """Predicted terminal error [-] with which a plan leads to the goal, and what remains of it is
    kept as it is."""

    # Search for an early arrival

    half_motions: int = 3072
    """Half motions that are drawn at a time for either end, a multiple of 16. More: better guesses
    for more work."""
    tried_guesses: int = 16
    """Guesses of each such draw that are tried."""
    polished: int = 3
    """Trials that are polished in a round: those of the least sum of duration and what their error
    is worth. As many guesses of random speeds are tried besides: with little acceleration the
    rotors are hardly at their limits."""
    window: float = 4.0
    """Time [1 / (c1 u_max)] by which the longest guess exceeds the lower bound of the duration;
    doubled where no half motions meet."""
    turn_weight: float = 22.0
    """Weight of the orientation in the distance by which two half motions miss each other [Rs^2]:
    of the squared distance of quaternions. Guesses are tried in the order of their durations with
    the time that this distance takes to roll."""
    mean_switch: float = 1.75
    """Mean time from the end to a switch of a half motion [1 / (c1 u_max)]."""
    near_radii: float = 10.0
    """Distance [Rs] beyond which whole turns of steady rolling are left out of a search."""

    # Following a plan

    noisy_share: float = 0.2
    """Predicted terminal error that is not corrected where there is noise [of what the noise adds
    to the dead band]."""
    largest_growth: float = 8.0
    """Largest factor [-] on the planning effort, and on the longest wall time, of a search from
    rest: doubled after each search without an arrival. Such a search has to end before a worker
    that does not answer is replaced."""
    failed_searches: int = 10
    """Number of such searches in succession without an earlier arrival after which none follows:
    the way to a distant goal takes hundreds of samples."""

    # Searches from rest and slip

    search_ahead: float = 0.1
    """Time [s] from the request of a search beside the control loop to the start of its plan,
    where the sphere moves; doubled after a search that took longer."""
    longest_search: float = 0.2
    """Wall time [s] after which such a search stops."""
    slip_acceleration: float = 0.43
    """Share [-] of the acceleration limit that a new plan uses where the sphere has slipped. On
    floors of friction 0.15 to 0.2 one that uses all of it slips with every plan and never
    arrives."""

    attained_share: float = 0.97
    """Share [-] that plans use of the acceleration that the drives are found to attain: a limit of
    torque allows a few per cent less in some orientations. The limit of plans is kept while that
    acceleration changes by no more than the rest."""

    # Holding at the goal

    largest_change_of_goal: float = 0.2
    """Change of the goal aimed at [Rs, rad] up to which a plan is changed, and above which it is
    dropped: a goal that moves is not the predicted one, and where the momentum cannot be held at
    the goal another orientation is aimed at."""
    tracked_error: float = 0.15
    """Error [-] up to which a goal that moves is tracked, and above which a plan leads to it."""
    unloading_share: float = 0.8
    """Share of the speed limit [-] at which a rotor of a sphere out of balance is unloaded, until
    the momentum along the loaded direction is zero."""
    turning_time: float = 1.2
    """Time constant [s] with which a tilt of up to twice the dead band lets the momentum correct a
    turn about body z. The more momentum, the faster a tilt that is not known turns the sphere."""
    least_dead_band: float = 2e-3
    """Error [-] below which the rotors stay at rest at the goal where there is no noise."""
    noise_factor: float = 50.0
    """Dead band over the standard deviation of the process noise [-]."""
    uncertainty_factor: float = 3.0
    """Dead band over the standard deviation of the state estimate [-]: no plan ends closer."""
    leaving_error: float = 8e-3
    """Error [-] up to which the sphere stays at rest in any case: a plan to correct less leads
    through errors above 1e-2. With momentum it also comes to rest there, as the momentum lets all
    of the error be corrected without another manoeuvre. Noise for which the dead band is larger
    lets errors grow, which are then corrected by rolling."""
    correction_weight: float = 100.0
    """Factor [-] on the input weight of the paper's problem that does so. Large, so that it
    corrects what rolling itself corrects and leaves alone what takes a manoeuvre."""

    def near_distance(self, robot: RobotParameters) -> float:
        """Return the distance [m] beyond which whole turns are left out of a search."""
        rolling = SteadyRolling.of(robot.lumped, robot.max_rotor_speed)
        ramps = 2.0 * max(0.0, robot.ramp_time - _TABLE_1.ramp_time)
        return self.near_radii * robot.shell_radius + ramps * rolling.speed

    def is_near(self, goal: Vector, other: Vector, constants: LumpedConstants) -> bool:
        """Return whether a plan to one goal, shape (6,), is changed to another, not dropped."""
        if np.array_equal(goal, other):  # as at nearly every sample, in a fifth of the time
            return True
        allowed = self.largest_change_of_goal
        near = position_error(goal, other) < allowed * constants.shell_radius
        return near and angle_error(goal, other) < allowed

    def growth(self, failed: int) -> float:
        """Return the factor [-] on the effort after that many searches without an arrival."""
        return min(2.0 ** min(failed, 60), self.largest_growth)

    def dead_band(self, noise: float, uncertainty: float) -> float:
        """Return the error [-] within which the sphere rests at the goal.

        Parameters
        ----------
        noise : float
            Standard deviation of the process noise [m, -; a sample].
        uncertainty : float
            Standard deviation of the state estimate's error in R^6.
        """
        return max(
            self.noise_factor * noise, self.uncertainty_factor * uncertainty, self.least_dead_band
        )

    def leaving_band(self, uncertainty: float) -> float:
        """Return the error [-] beyond which a sphere that came to rest now is to leave again."""
        return max(self.leaving_error, self.uncertainty_factor * uncertainty)
