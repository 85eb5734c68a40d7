# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Estimator of the state and the plant from poses and the rotor speeds sent.

A moving horizon is fitted to all poses up to a knot by tasks of a worker, or in line. From its
last result on, the newest poses are fused as they arrive by a Kalman filter of the state alone.
"""

from bisect import bisect_left
from dataclasses import dataclass

import numpy as np

from sphere_nmpc.estimation.estimate import Estimate, PlantEstimate
from sphere_nmpc.estimation.interval import Interval
from sphere_nmpc.estimation.moving_horizon import MovingHorizon
from sphere_nmpc.estimation.posterior import Posterior
from sphere_nmpc.estimation.sent_inputs import SentInputs
from sphere_nmpc.estimation.settings import TABLE_1_NUMBERS, EstimatorSettings
from sphere_nmpc.estimation.tracker import Tracker
from sphere_nmpc.estimation.unknowns import KNOT, Scaling
from sphere_nmpc.model.disturbance import Disturbance
from sphere_nmpc.model.parameters import LumpedConstants
from sphere_nmpc.model.state import MOMENTUM, NO_MOMENTUM, Vector
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.worker.contract import Reply, Store, Task, Worker
from sphere_nmpc.worker.in_line import InLine

_KEY = "estimator"
_SAME = 1e-9
"""Time [s] below which two are the same."""
SHORT_GAP = 0.1
"""Share of the mean spacing of poses [-] below which two are of a bunch."""
_FEWEST = 3
"""Number of poses from which on their mean spacing is taken."""
_MOST_PENDING = 4
"""Tasks that wait for the worker at most; where it is slower, intervals become longer."""


@dataclass(frozen=True, eq=False)
class Begin:
    """Task that makes a moving horizon; attributes as for `MovingHorizon`."""

    scaling: Scaling
    begun: Posterior
    pose_deviations: Vector
    momentum: bool

    def __call__(self, store: Store) -> Posterior:
        """Make it in the worker."""
        made = store[_KEY] = MovingHorizon(
            self.scaling, self.begun, self.pose_deviations, self.momentum
        )
        return made.result


@dataclass(frozen=True, eq=False)
class Observe:
    """Task that takes an interval, or with `interval` None a pose after a gap, into account."""

    interval: Interval | None
    time: float
    pose: Vector

    def __call__(self, store: Store) -> Posterior | None:
        """Update the moving horizon; None where the worker has lost it."""
        horizon: MovingHorizon | None = store.get(_KEY)
        if horizon is None:
            return None
        if self.interval is None:
            horizon.start_at(self.time, self.pose)
        else:
            horizon.observe(self.interval, self.time)
        return horizon.result


class Estimator:
    """Estimator of the state and of the plant's parameters.

    Constants are estimated also where learning is off; they are then not used, but their noise is.

    Parameters
    ----------
    settings : ControllerSettings
        Noise of the poses, and whether constants and momentum are estimated.
    nominal : LumpedConstants
        Constants of the robot as built.
    sent : SentInputs
        The rotor speeds sent.
    worker : Worker, optional
        Fits the moving horizon beside the control loop; by default it is fitted in line.
    acceleration : float, optional
        Limit of the speeds sent [rad/s^2], which drives may not attain.
    """

    def __init__(
        self,
        settings: ControllerSettings,
        nominal: LumpedConstants,
        sent: SentInputs,
        worker: Worker | None = None,
        acceleration: float = float("inf"),
    ) -> None:
        self._settings = settings
        self._numbers: EstimatorSettings = TABLE_1_NUMBERS.of(settings.units)
        self._scaling = Scaling(nominal, acceleration, self._numbers)
        self._sent = sent
        self._worker = worker or InLine()
        self._poses: list[tuple[float, Vector]] = []
        self._knot: float | None = None
        self._tracker: Tracker | None = None
        self._replies: list[Reply[Posterior | None]] = []
        self._kept: tuple[Posterior, ControllerSettings, PlantEstimate] | None = None
        self._has_diverged = False
        """Whether a result was not valid since the last estimate."""
        self._result = Posterior.initial(settings.drive_lag, self._scaling)
        self._begin(self._result)

    @property
    def newest(self) -> tuple[float, Vector] | None:
        """Control time [s] of the newest pose, and the pose, shape (6,); None without any."""
        return self._poses[-1] if self._poses else None

    @property
    def plant(self) -> PlantEstimate:
        """The plant parameters estimated so far, also without a pose."""
        self._collect()
        result, settings = self._result, self._settings
        if self._kept is not None and self._kept[0] is result and self._kept[1] is settings:
            return self._kept[2]
        plant = self._plant_of()
        self._kept = result, settings, plant
        return plant

    def _plant_of(self) -> PlantEstimate:
        result, scaling, settings = self._result, self._scaling, self._settings
        common, covariance = result.common, result.covariance
        deviations = np.sqrt(np.diag(covariance)[KNOT : KNOT + 4]) * scaling.nominal.as_array()
        noise = max(self._numbers.pose, result.noise)
        slippery = result.slipped < self._numbers.slippery
        if not settings.learning:
            return PlantEstimate(
                scaling.nominal, settings.drive_lag, noise, deviations, slippery=slippery
            )
        return PlantEstimate(
            scaling.lumped(common), scaling.significant_lag(common), noise, deviations,
            scaling.attained(common), slippery,
        )

    @property
    def momentum(self) -> Vector:
        """Momentum at the newest knot, shape (3,); kept without poses."""
        result = self._result
        return NO_MOMENTUM if result.undisturbed else result.knot[MOMENTUM]

    @property
    def disturbance(self) -> Disturbance:
        """Slope and imbalance as estimated so far."""
        return self._result.slope_and_imbalance

    @property
    def stamp_deviation(self) -> float:
        """Standard deviation of the stamps of poses that the motion shows [s]."""
        return self._result.pose_noise.time

    def observe(self, time: float, pose: Vector) -> bool:
        """Take a pose, shape (6,), measured at control time `time` [s]; False if outdated.

        Noisy poses may arrive out of order, within the interval that has not ended.
        """
        poses = self._poses
        if not poses or time > poses[-1][0]:
            if self._is_bunched(time):
                # Of a bunch that was held up on its way the newest pose is the least late.
                poses.pop()
                self._tracker = None
            poses.append((time, pose))
            if self._tracker is not None:
                self._tracker.observe(time, pose)
            return True
        place = self._index(time)
        if not self._is_noisy or place == 0 or poses[place][0] == time:
            return False
        poses.insert(place, (time, pose))
        self._tracker = None
        return True

    def _is_bunched(self, time: float) -> bool:
        """Return whether a pose at `time` [s] comes just after the newest, which is no knot."""
        poses = self._poses
        if len(poses) < _FEWEST or poses[-1][0] == self._knot:
            return False
        mean = (poses[-1][0] - poses[0][0]) / (len(poses) - 1)
        return time - poses[-1][0] < SHORT_GAP * mean

    def estimate(self, time: float) -> Estimate | None:
        """Return the estimate at control time `time` [s]; None without a pose.

        Where it raises the control loop falls back to the plan in force.
        """
        if not self._poses:
            return None
        self._learn()
        if self._has_diverged:
            self._has_diverged = False
            raise ArithmeticError("the estimate is not a distribution, and begins anew")
        plant = self.plant  # First, as it takes over a result that has arrived.
        tracker = self._tracked()
        state, covariance = tracker.predict(time)
        known = covariance if self._is_noisy else None
        return Estimate(state, plant, known, tracker.disturbance)

    def change(self, settings: ControllerSettings) -> None:
        """Take over changed settings; estimates that they do not concern are kept.

        A changed ``drive_lag`` restarts the estimate of the lag from this prior mean.
        """
        before, self._settings = self._settings, settings
        result = self._result
        if settings.drive_lag != before.drive_lag:
            result = result.with_lag(settings.drive_lag, self._scaling)
        if settings.momentum and not before.momentum:
            result = result.with_unknown_momentum(self._numbers)
        elif before.momentum and not settings.momentum:
            result = result.without_disturbance(self._numbers)
        estimation = ("drive_lag", "momentum", "pose_position_noise", "pose_orientation_noise")
        if any(getattr(settings, name) != getattr(before, name) for name in estimation):
            self._begin(result)
        self._tracker = None

    def forget(self) -> None:
        """Discard all poses, as after a jump of the clock.

        Estimated parameters and disturbance stay; the momentum may have changed meanwhile.
        """
        self._poses.clear()
        self._knot = self._tracker = None

    @property
    def _is_noisy(self) -> bool:
        given = self._settings
        declared = given.pose_position_noise > 0.0 or given.pose_orientation_noise > 0.0
        return declared or any(self._result.pose_noise)

    @property
    def _is_known(self) -> bool:
        """Whether more knots would tell no more of the constants."""
        variances = np.diag(self._result.covariance)[KNOT : KNOT + 4]
        return self._is_noisy or bool(np.max(variances) < self._numbers.known**2)

    @property
    def _pose_deviations(self) -> Vector:
        given = self._settings
        noise = [given.pose_position_noise] * 2 + [given.pose_orientation_noise] * 3
        deviations: Vector = np.maximum(noise, self._numbers.pose)
        return deviations

    def _begin(self, known: Posterior) -> None:
        """Continue from what is known, in a new moving horizon."""
        self._result = known
        self._replies = []
        self._is_begun = self._submit(
            Begin(self._scaling, known, self._pose_deviations, self._settings.momentum)
        )
        # Intervals on their way to a worker that has ended are lost.
        self._knot = known.time if self._poses and self._poses[0][0] == known.time else None
        self._collect()

    def _submit(self, task: Task[Posterior | None]) -> bool:
        """Return whether the worker takes a task."""
        reply = self._worker.submit(task)
        if reply.error:
            return False
        self._replies.append(reply)
        return True

    def _collect(self) -> None:
        """Take over the results that have arrived."""
        self._worker.poll()
        replies, lost = self._replies, False
        while replies and not replies[0].pending:
            reply = replies.pop(0)
            result = reply.result
            if result is None:
                lost = lost or reply.ready
                continue
            self._tracker = None
            if not result.is_valid:
                # All that follows it would fail, too.
                self._has_diverged = True
                self._begin(Posterior.initial(self._settings.drive_lag, self._scaling))
                return
            self._result = result
        if lost:
            self._is_begun = False

    def _learn(self) -> None:
        """Submit the intervals since the last knot that are long enough."""
        if not self._is_begun:
            self._begin(self._result)
        if self._knot is None and self._submit(Observe(None, *self._poses[0])):
            self._knot = self._poses[0][0]
        while self._knot is not None and self._submit_interval(self._knot):
            self._collect()
        # Those since the last result are fused again from the next one on. What is older than
        # the intervals that can wait is of no use either.
        longest, knot = self._numbers.longest, self._poses[0][0]
        if self._knot is not None:
            knot = max(min(self._result.time, self._knot), self._knot - longest)
        del self._poses[: self._index(max(knot, self._poses[-1][0] - _MOST_PENDING * longest))]

    def _submit_interval(self, since: float) -> bool:
        """Submit the interval from the knot at `since` [s]; return whether that could be done."""
        poses, numbers = self._poses, self._numbers
        now, vacant = poses[-1][0], _MOST_PENDING - len(self._replies)
        if vacant <= 0:
            return False
        spacing = max(
            numbers.spacing if self._is_known else numbers.first_spacing, (now - since) / vacant
        )
        outliers = self._tracked().outliers
        long_enough = self._index(since + spacing - _SAME)
        ends = (i for i in range(long_enough, len(poses)) if poses[i][0] not in outliers)
        end = next(ends, None)
        if end is None:
            return False
        time, pose = poses[end]
        # Rotor speeds measured until then may still be on their way.
        if self._sent.is_pending(time, now):
            return False
        interval = None
        if time - since <= numbers.longest:
            within = poses[self._index(since) + 1 : end] if self._is_noisy else []
            kept = [one for one in within if one[0] not in outliers]
            interval = self._interval(since, [*kept, (time, pose)])
        if not self._submit(Observe(interval, time, pose)):
            return False
        self._knot = time
        return True

    def _index(self, time: float) -> int:
        """Return the index of the first pose at `time` [s] or later."""
        return bisect_left(self._poses, time, key=lambda one: one[0])

    def _interval(self, since: float, poses: list[tuple[float, Vector]]) -> Interval:
        """Return the interval from `since` [s] to the last of its poses, with some of them."""
        end, numbers = poses[-1][0], self._numbers
        used = poses[-1:]
        # Poses in quick succession tell little more, and a long interval is to take no longer.
        apart = numbers.pose_spacing * max(1.0, 0.5 * (end - since) / numbers.spacing)
        for one in reversed(poses[:-1]):
            if min(used[0][0] - one[0], one[0] - since) > apart - _SAME:
                used.insert(0, one)
        after, measured = zip(*used, strict=True)
        # A pose with an early stamp shows the effect of speeds sent after that.
        durations, speeds = self._sent.pieces(since - numbers.lead, end + numbers.longest_lag)
        return Interval(
            np.array(after) - since, np.array(measured), durations, speeds, numbers.lead
        )

    def _tracked(self) -> Tracker:
        """Return the tracker of the newest poses, from the last result on."""
        if self._tracker is None:
            plant = self.plant  # First, as it takes over a result that has arrived.
            self._tracker = Tracker(
                self._result, plant, self._poses, self._sent,
                self._pose_deviations, self._scaling, self._settings.longest_step,
                self._is_noisy,
            )
        return self._tracker
