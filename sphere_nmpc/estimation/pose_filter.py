# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Kalman filter of the state over the measured poses since a result of the moving horizon."""

from bisect import bisect_left
from dataclasses import dataclass
from functools import cached_property
from itertools import takewhile
from typing import NamedTuple

import numpy as np

from sphere_nmpc.estimation.hypotheses import noise_variance
from sphere_nmpc.estimation.motion import pose_rate
from sphere_nmpc.estimation.posterior import (
    CONSTANTS,
    DISTURBANCE,
    IMBALANCE,
    KNOT,
    LOCAL,
    MOMENTUM_ERROR,
    SLOPE_ERROR,
    Posterior,
    Scaling,
    disturbance_of,
)
from sphere_nmpc.estimation.rotor_history import RotorHistory
from sphere_nmpc.model.disturbance import UNDISTURBED, Disturbance
from sphere_nmpc.model.error_state import (
    ERROR_SIZE,
    POSE_ERROR,
    apply_error,
    error_between,
    state_deviation,
    with_block,
)
from sphere_nmpc.model.first_order_hold import SAME
from sphere_nmpc.model.plant import PlantEstimate
from sphere_nmpc.model.state import MOMENTUM, POSE, STATE_SIZE, Vector
from sphere_nmpc.reporting.stamps import SHORT_GAP
from sphere_nmpc.solver.roll_out import propagate, roll_out


@dataclass(frozen=True, eq=False)
class Estimate:
    """State and plant parameters at a sampling instant."""

    state: Vector
    """Predicted state, shape (9,); its momentum is zero without evidence of any."""
    plant: PlantEstimate
    """Parameters of the plant; the same object until there are others."""
    covariance: Vector | None = None
    """Covariance of the error state, shape (5, 5): position [m; world frame], rotation vector
    [rad; body frame]. None where poses are trusted exactly."""
    disturbance: Disturbance = UNDISTURBED
    """Slope and imbalance, zero without evidence; the same object until there are others."""

    @cached_property
    def uncertainty(self) -> float:
        """Standard deviation of the error of the state in R^6 [mixed units]; 0 if trusted."""
        return 0.0 if self.covariance is None else state_deviation(self.covariance)


class Belief(NamedTuple):
    """Gaussian distribution of the state at the time of a pose."""

    state: Vector
    """Mean, shape (9,)."""
    covariance: Vector
    """Covariance of the local unknowns, (19, 19); without meaning where poses are exact."""


@dataclass(eq=False)
class MeasuredPose:
    """Pose, shape (6,), measured at a control time [s], and what is known with it."""

    time: float
    pose: Vector
    belief: Belief | None = None
    """Belief by this pose and those before it; None as long as that has not been asked for."""
    is_outlier: bool = False
    """Whether it was left out as improbable."""


class PoseFilter:
    """Filter of the state at the newest pose, anchored at the newest result.

    The plant's parameters, slope and imbalance are those of the result: what they are off by is
    taken into account, but not estimated (a Schmidt-Kalman filter). Exact poses are the state
    themselves, and only their momentum is predicted. Of noisy ones outliers are left out, until
    there are several in a row.

    Each pose keeps the belief that it leads to. What comes out of order, or changes the anchor,
    discards those that depend on it. These poses are fused again once an estimate is asked for,
    at least the spacing apart that poses within an interval have.
    """

    def __init__(self, sent: RotorHistory, scaling: Scaling) -> None:
        self._sent, self._scaling = sent, scaling
        self.poses: list[MeasuredPose] = []
        """Poses in the order of their times, since the anchor or the first one after a gap."""
        self._fused_until = -np.inf
        """Time of the newest pose that was fused from an earlier anchor on [s]."""

    def anchor(
        self,
        result: Posterior,
        plant: PlantEstimate,
        pose_deviations: Vector,
        is_noisy: bool,
        max_step: float,
    ) -> None:
        """Continue from a result; where its knot is none of the poses, from the first of them."""
        self._lag, self._constants = plant.lag, plant.constants.as_array()
        self._plant, self._max_step, self.is_noisy = plant, max_step, is_noisy
        self._pose_deviations, self._pose_noise = pose_deviations, result.pose_noise
        self._noise_scale = result.scale
        self.disturbance = UNDISTURBED if result.undisturbed else disturbance_of(
            result.knot, result.common
        )
        """Slope and imbalance that it predicts with; `UNDISTURBED` where they are zero."""
        state, covariance = result.knot[:STATE_SIZE].copy(), result.covariance
        zero = DISTURBANCE if result.undisturbed else DISTURBANCE[5:]
        if not result.unbalanced:
            covariance = with_block(covariance, zero, np.zeros(()))
        if result.undisturbed:
            state[MOMENTUM] = 0.0
        self._anchor = Belief(state, covariance)
        for one in self.poses:
            if one.belief is not None:
                self._fused_until, one.belief = one.time, None
        place = self._place(result.time)
        if place < len(self.poses) and self.poses[place].time == result.time:
            del self.poses[:place]
            self.poses[0].belief = self._anchor

    def observe(self, time: float, pose: Vector, knot: MeasuredPose | None) -> bool:
        """Take a pose, shape (6,), measured at control time `time` [s]; False if outdated.

        Noisy poses may arrive out of order. Of a bunch that was held up on its way the newest pose
        is the least late; it takes the place of the others, unless one is the newest `knot`.
        """
        poses = self.poses
        if not poses or time > poses[-1].time:
            if len(poses) > 1 and poses[-1] is not knot:
                mean = (poses[-1].time - poses[0].time) / (len(poses) - 1)
                if time - poses[-1].time < SHORT_GAP * mean:
                    poses.pop()
            poses.append(MeasuredPose(time, pose))
            return True
        place = self._place(time)
        if not self.is_noisy or place == 0 or poses[place].time == time:
            return False
        for one in poses[place:]:
            one.belief = None
        poses.insert(place, MeasuredPose(time, pose))
        return True

    def discard_before(self, time: float) -> None:
        """Discard the poses measured before `time` [s]."""
        del self.poses[: self._place(time)]

    def probable_after(self, time: float) -> list[MeasuredPose]:
        """Return the poses after `time` [s] that are no outliers, in order."""
        self._newest()
        found = self.poses[self._place(time) :]
        return [one for one in found if one.time > time and not one.is_outlier]

    def estimate(self, time: float) -> Estimate:
        """Return the estimate at control time `time` [s]; there has to be a pose."""
        newest = self.poses[-1]
        found = self._moved(newest.belief or self._newest(), newest.time - self._lag, time)
        covariance = found.covariance[:5, :5] if self.is_noisy else None
        return Estimate(found.state, self._plant, covariance, self.disturbance)

    def deviation(
        self, start: MeasuredPose, end: MeasuredPose, durations: Vector, speeds: Vector
    ) -> float:
        """Return how far a pose is from its prediction by rotor speeds from an earlier one.

        That is the normalised square of the innovation; the speeds are given as in
        `RotorHistory.pieces`.
        """
        state, scaling = np.concatenate((start.pose, self._anchor.state[MOMENTUM])), self._scaling
        given = durations, self._constants, self._max_step, self.disturbance
        found = error_between(roll_out(state, speeds, *given)[-1][POSE], end.pose)
        motion, noise = error_between(start.pose, end.pose), self._pose_noise
        variances = scaling.pose_variance(noise.pose, self._pose_deviations)
        variances += np.square(noise.time / (end.time - start.time) * motion)
        turned = float(np.linalg.norm(motion[2:5]))
        predicted = noise_variance(turned, scaling.numbers) * self._noise_scale
        return float(np.sum(np.square(found) / (2.0 * variances + predicted)))

    def _place(self, time: float) -> int:
        """Return the index of the first pose at `time` [s] or later."""
        return bisect_left(self.poses, time, key=lambda one: one.time)

    def _newest(self) -> Belief:
        """Return the belief at the newest pose; those since the last belief are fused."""
        poses, known = self.poses, len(self.poses) - 1
        while known > 0 and poses[known].belief is None:
            known -= 1
        newest, last = poses[-1], poses[known]
        last.belief = belief = last.belief or self._began_at(last)
        if self.is_noisy:
            for one in poses[known + 1 :]:
                # Where poses are fused again, those in quick succession add little.
                apart = one.time - last.time > self._scaling.numbers.pose_spacing - SAME
                if apart or one.time > self._fused_until or one is newest:
                    one.belief = belief = self._fused(belief, last.time, one)
                    last = one
        elif last is not newest:
            # Exact poses before the newest add nothing.
            if self.disturbance is not UNDISTURBED:
                belief = self._moved(belief, last.time - self._lag, newest.time - self._lag)
            state = np.concatenate((newest.pose, belief.state[MOMENTUM]))
            newest.belief = belief = Belief(state, belief.covariance)
        return belief

    def _began_at(self, first: MeasuredPose) -> Belief:
        """Return the belief at the first pose: its own, with what the anchor adds for the rest."""
        state = np.concatenate((first.pose, self._anchor.state[MOMENTUM]))
        measured = self._measured(state, first.time)
        return Belief(state, with_block(self._anchor.covariance, POSE_ERROR, measured))

    def _fused(self, before: Belief, since: float, one: MeasuredPose) -> Belief:
        """Return the belief at a noisy pose from that at an earlier one, of time `since` [s]."""
        state, covariance = self._moved(before, since - self._lag, one.time - self._lag)
        innovation = error_between(state[POSE], one.pose)
        measured = self._measured(state, one.time)
        expected = covariance[:5, :5] + measured
        square = float(innovation @ np.linalg.solve(expected, innovation))
        one.is_outlier = not square < self._scaling.numbers.improbable
        if not one.is_outlier:
            known = covariance[:5]
            gain = np.linalg.solve(expected, known[:, :ERROR_SIZE]).T
            fused = covariance.copy()
            fused[:ERROR_SIZE] -= gain @ known
            fused[:, :ERROR_SIZE] = fused[:ERROR_SIZE].T
            return Belief(apply_error(state, gain @ innovation), fused)
        earlier = reversed(self.poses[: self._place(one.time) + 1])
        in_a_row = list(takewhile(lambda other: other.is_outlier, earlier))
        if len(in_a_row) <= self._scaling.numbers.most_outliers:
            return Belief(state, covariance)
        # Something else has moved the sphere there.
        for other in in_a_row:
            other.is_outlier = False
        state = apply_error(state, np.concatenate((innovation, np.zeros(3))))
        return Belief(state, with_block(covariance, POSE_ERROR, measured))

    def _measured(self, state: Vector, time: float) -> Vector:
        """Return the covariance of a pose measured at `time` [s] in a state, shape (5, 5)."""
        speeds = self._sent.at(time - self._lag)
        rate = pose_rate(state, speeds, self._constants, self.disturbance)
        return self._scaling.pose_covariance(self._pose_noise, self._pose_deviations, rate)

    def _moved(self, before: Belief, since: float, until: float) -> Belief:
        """Return the belief once the speeds sent from `since` to `until` [s] took effect."""
        if until <= since:
            return before
        durations, speeds = self._sent.pieces(since, until)
        state, covariance = before
        given = speeds, durations, self._constants, self._max_step, self.disturbance
        if not self.is_noisy:
            return Belief(roll_out(state, *given)[-1], covariance)
        end, numbers = propagate(state, *given), self._scaling.numbers
        by = np.eye(LOCAL)
        by[:ERROR_SIZE, :ERROR_SIZE] = end.by_start
        by[:ERROR_SIZE, KNOT:][:, CONSTANTS] = end.by_constants * self._scaling.nominal.as_array()
        by[:ERROR_SIZE, SLOPE_ERROR] = end.by_torques[:, :2]
        by[:ERROR_SIZE, KNOT:][:, IMBALANCE] = end.by_torques[:, 2:]
        turned = float(np.linalg.norm(error_between(state, end.state)[2:5]))
        # A random walk that comes as far within an interval as the moving horizon expects.
        share = (until - since) / numbers.spacing
        variances = np.zeros(LOCAL)
        variances[POSE_ERROR] = noise_variance(turned / share, numbers) * self._noise_scale * share
        if self.disturbance is not UNDISTURBED:
            variances[MOMENTUM_ERROR] = numbers.momentum_walk**2 * (until - since)
            variances[SLOPE_ERROR] = numbers.slope_walk**2 * (until - since)
        return Belief(end.state, by @ covariance @ by.T + np.diag(variances))
