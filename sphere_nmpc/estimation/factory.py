# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Choice of the estimator by the settings."""

from sphere_nmpc.estimation.contract import Background, Estimator
from sphere_nmpc.estimation.exact_poses import ExactPoseEstimator
from sphere_nmpc.estimation.noisy_poses import NoisyPoseEstimator
from sphere_nmpc.estimation.sent_inputs import SentInputs
from sphere_nmpc.model.parameters import LumpedConstants
from sphere_nmpc.settings import ControllerSettings


def make_estimator(
    settings: ControllerSettings,
    nominal: LumpedConstants,
    sent: SentInputs,
    background: Background | None = None,
    previous: Estimator | None = None,
    acceleration: float = float("inf"),
) -> Estimator:
    """Return the estimator for the pose noise in the settings.

    Parameters
    ----------
    settings : ControllerSettings
        Pose noise, expected lag, and whether parameters are learnt.
    nominal : LumpedConstants
        Constants of the robot as built.
    sent : SentInputs
        Rotor speeds that were sent.
    background : callable, optional
        Runs tasks that the control loop does not wait for; by default they run immediately.
    previous : Estimator, optional
        The one in use so far. It is kept if it still suits the settings; otherwise its
        parameters and its newest pose are handed over.
    acceleration : float, optional
        Limit of the speeds sent [rad/s^2], which the drives may not attain; by default they do.
    """
    prior = newest = None
    if previous is not None:
        previous.change(settings)
        prior, newest = previous.parameters, previous.newest
    made: Estimator
    if settings.pose_position_noise > 0.0 or settings.pose_orientation_noise > 0.0:
        if isinstance(previous, NoisyPoseEstimator):
            return previous
        made = NoisyPoseEstimator(settings, nominal, sent, prior)
    else:
        if isinstance(previous, ExactPoseEstimator):
            return previous
        made = ExactPoseEstimator(settings, nominal, sent, background, prior, acceleration)
    if newest is not None:
        made.observe(*newest)
    return made
