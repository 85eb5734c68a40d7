# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Choice of the estimator by the settings."""

from sphere_nmpc.estimation.contract import Estimator
from sphere_nmpc.estimation.exact_poses import ExactPoseEstimator
from sphere_nmpc.estimation.noisy_poses import NoisyPoseEstimator
from sphere_nmpc.estimation.sent_inputs import SentInputs
from sphere_nmpc.model.parameters import LumpedConstants
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.worker.contract import Worker


def make_estimator(
    settings: ControllerSettings,
    nominal: LumpedConstants,
    sent: SentInputs,
    worker: Worker | None = None,
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
    worker : Worker, optional
        Learns beside the control loop; by default it is learnt in line.
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
        made = ExactPoseEstimator(settings, nominal, sent, worker, prior, acceleration)
    if newest is not None:
        made.observe(*newest)
    return made
