# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Estimator of the state and the plant from poses and the rotor speeds sent.

A moving horizon is fitted to all poses up to a knot by tasks of a worker, or in line. From its
last result on, the newest poses are fused by a Kalman filter of the state alone.
"""

from dataclasses import dataclass

import numpy as np

from sphere_nmpc.estimation.motion import Interval
from sphere_nmpc.estimation.moving_horizon import MovingHorizon
from sphere_nmpc.estimation.pose_filter import (
    Estimate,
    MeasuredPose,
    PoseFilter,
)
from sphere_nmpc.estimation.posterior import KNOT, Posterior, Scaling
from sphere_nmpc.estimation.rotor_history import RotorHistory
from sphere_nmpc.estimation.settings import TABLE_1_NUMBERS, EstimatorSettings
from sphere_nmpc.model.disturbance import Disturbance
from sphere_nmpc.model.error_state import EXPECTED_DEVIATIONS
from sphere_nmpc.model.first_order_hold import SAME
from sphere_nmpc.model.parameters import LumpedConstants
from sphere_nmpc.model.plant import PlantEstimate
from sphere_nmpc.model.state import MOMENTUM, NO_MOMENTUM, Vector
from sphere_nmpc.reporting.conditions import Condition, Kind
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.worker.contract import Reply, Store, Worker
from sphere_nmpc.worker.in_line import InLine

_KEY = "estimator"
_NAMES = ("shell_radius", " m"), ("c1", ""), ("r1", ""), ("r3", "")
_MAX_DIFFERENCE = 0.2
"""Difference of a learnt constant from that given, relative to it, above which the robot is taken
for another one [-]: what the prior expects of sizes and masses."""
_MOST_PENDING = 4
"""Tasks that wait for the worker at most; where it is slower, intervals become longer."""


@dataclass(frozen=True, eq=False)
class Observe:
    """Task that takes an interval, or with `interval` None a pose after a gap, into account.

    It does so with a moving horizon that has `begun` anew, or with that kept in the worker.
    """

    interval: Interval | None
    time: float
    pose: Vector
    begun: MovingHorizon | None

    def __call__(self, store: Store) -> Posterior | None:
        """Update the moving horizon; None where the worker has lost it."""
        horizon: MovingHorizon | None = self.begun or store.get(_KEY)
        if horizon is None:
            return None
        store[_KEY] = horizon
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
    sent : RotorHistory
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
        sent: RotorHistory,
        worker: Worker | None = None,
        acceleration: float = float("inf"),
    ) -> None:
        self._settings = settings
        self._numbers: EstimatorSettings = TABLE_1_NUMBERS.of(settings.units)
        self._scaling = Scaling(nominal, acceleration, self._numbers)
        self._sent = sent
        self._worker = worker or InLine()
        self._filter = PoseFilter(sent, self._scaling)
        self._knot: MeasuredPose | None = None
        """Pose at the end of the newest interval that was submitted."""
        self._has_diverged = False
        """Whether a result was not valid since the last estimate."""
        self._begin(Posterior.initial(settings.drive_lag, self._scaling))

    @property
    def newest(self) -> tuple[float, Vector] | None:
        """Control time [s] of the newest pose, and the pose, shape (6,); None without any."""
        poses = self._filter.poses
        return (poses[-1].time, poses[-1].pose) if poses else None

    @property
    def plant(self) -> PlantEstimate:
        """The plant parameters estimated so far, also without a pose."""
        if self._replies:
            self._collect()
        return self._plant

    @property
    def momentum(self) -> Vector:
        """Momentum at the newest knot, shape (3,); kept without poses."""
        result = self._result
        return NO_MOMENTUM if result.undisturbed else result.knot[MOMENTUM]

    @property
    def disturbance(self) -> Disturbance:
        """Slope and imbalance as estimated so far."""
        return self._filter.disturbance

    @property
    def condition(self) -> Condition | None:
        """The warning about a constant that the motion shows to be another; None without one.

        It is that which is farthest from what was given, by more than its uncertainty, whether or
        not learning is on.
        """
        scaling = self._scaling
        given, learnt = scaling.nominal.as_array(), scaling.constants(self._result.common)
        off = np.abs(learnt - given) / given - EXPECTED_DEVIATIONS * self._plant.deviations / given
        worst = int(np.argmax(off))
        if off[worst] < _MAX_DIFFERENCE:
            return None
        name, unit = _NAMES[worst]
        return Condition(
            Kind.OTHER_ROBOT, f"given {name} = {given[worst]:.3g}{unit}, and the motion shows "
            f"{learnt[worst]:.3g}{unit}, expected at most {100.0 * _MAX_DIFFERENCE:.0f} % "
            "from it: was the params_file with the robot given to all nodes, and do the rotors "
            "turn as commanded?",
        )

    @property
    def stamp_deviation(self) -> float:
        """Standard deviation of the stamps of poses that the motion shows [s]."""
        return self._result.pose_noise.time

    def observe(self, time: float, pose: Vector) -> bool:
        """Take a pose, shape (6,), measured at control time `time` [s]; False if outdated.

        Noisy poses may arrive out of order, within the interval that has not ended.
        """
        return self._filter.observe(time, pose, self._knot)

    def estimate(self, time: float) -> Estimate | None:
        """Return the estimate at control time `time` [s]; None without a pose.

        Where it raises the control loop falls back to the plan in force.
        """
        poses, knot = self._filter.poses, self._knot
        if not poses:
            return None
        if self._replies:
            self._collect()
        if knot is None or poses[-1].time >= knot.time + self._spacing - SAME:
            self._learn()
        if self._has_diverged:
            self._has_diverged = False
            raise ArithmeticError("the estimate is not a distribution, and begins anew")
        return self._filter.estimate(time)

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
        else:
            self._take_over(result)

    def forget(self) -> None:
        """Discard all poses, as after a jump of the clock.

        Estimated parameters and disturbance stay; the momentum may have changed meanwhile.
        """
        self._filter.poses.clear()
        self._knot = None

    def _begin(self, known: Posterior) -> None:
        """Continue from what is known, in a new moving horizon."""
        given, least = self._settings, self._numbers.pose
        noise = [given.pose_position_noise] * 2 + [given.pose_orientation_noise] * 3
        self._pose_deviations: Vector = np.maximum(noise, least)
        self._take_over(known)
        self._begun: MovingHorizon | None = MovingHorizon(
            self._scaling, known, self._pose_deviations, given.momentum
        )
        # Intervals on their way are lost.
        self._replies: list[Reply[Posterior | None]] = []
        poses = self._filter.poses
        self._knot = poses[0] if poses and poses[0].time == known.time else None

    def _take_over(self, result: Posterior) -> None:
        """Make a result, under the present settings, the one in force."""
        self._result, settings, numbers = result, self._settings, self._numbers
        scaling, common = self._scaling, result.common
        deviations = np.sqrt(np.diag(result.covariance)[KNOT : KNOT + 4])
        declared = settings.pose_position_noise > 0.0 or settings.pose_orientation_noise > 0.0
        is_noisy = declared or any(result.pose_noise)
        # Once the constants are known, more knots would show no more of them.
        is_known = is_noisy or bool(np.max(deviations) < numbers.known)
        self._spacing = numbers.spacing if is_known else 0.5 * numbers.spacing
        learns = settings.learning
        self._plant = PlantEstimate(
            scaling.lumped(common) if learns else scaling.nominal,
            scaling.lag(common) if learns else settings.drive_lag,
            max(numbers.pose, result.noise),
            deviations * scaling.nominal.as_array(),
            scaling.attained(common) if learns else float("inf"),
            result.slipped < numbers.slippery,
        )
        self._filter.anchor(
            result, self._plant, self._pose_deviations, is_noisy, settings.longest_step
        )

    def _submit(self, interval: Interval | None, end: MeasuredPose) -> bool:
        """Return whether the worker takes an interval to a pose, or this pose after a gap."""
        reply = self._worker.submit(Observe(interval, end.time, end.pose, self._begun))
        if reply.error:
            return False
        self._begun, self._knot = None, end
        self._replies.append(reply)
        return True

    def _collect(self) -> None:
        """Take over the results that have arrived."""
        self._worker.poll()
        while self._replies and not self._replies[0].pending:
            reply = self._replies.pop(0)
            result = reply.result
            if result is None:
                if reply.ready:  # the worker has lost the moving horizon
                    self._begin(self._result)
            elif result.is_valid:
                self._take_over(result)
            else:
                # All that follows it would fail, too.
                self._has_diverged = True
                self._begin(Posterior.initial(self._settings.drive_lag, self._scaling))

    def _learn(self) -> None:
        """Submit the intervals since the last knot that are long enough."""
        if self._knot is None and self._submit(None, self._filter.poses[0]):
            self._collect()
        while self._knot is not None and self._submit_interval(self._knot):
            self._collect()
        # What is older than the intervals that can wait is of no use.
        newest = self._filter.poses[-1]
        self._filter.discard_before(newest.time - _MOST_PENDING * self._numbers.longest)

    def _submit_interval(self, knot: MeasuredPose) -> bool:
        """Submit the interval from a knot on; return whether that could be done."""
        numbers, now = self._numbers, self._filter.poses[-1].time
        vacant = _MOST_PENDING - len(self._replies)
        if vacant <= 0 or now < knot.time + self._spacing - SAME:
            return False
        # Where the worker is slow, the next interval is longer.
        spacing = max(self._spacing, (now - knot.time) / vacant)
        poses = self._filter.probable_after(knot.time)
        until = [k for k, one in enumerate(poses) if one.time >= knot.time + spacing - SAME]
        # Rotor speeds measured until then may still be on their way.
        if not until or self._sent.is_pending(poses[until[0]].time, now):
            return False
        end, interval = poses[until[0]], None
        if end.time - knot.time <= numbers.longest:
            self._judge(knot, end)
            within = poses[: until[0]] if self._filter.is_noisy else []
            interval = self._interval(knot.time, within, end)
        return self._submit(interval, end)

    def _judge(self, start: MeasuredPose, end: MeasuredPose) -> None:
        """Compare the motion between two poses with the speeds sent and with those measured.

        What was learnt from measured speeds that turn out to be wrong is dropped.
        """
        sent, numbers, lag = self._sent, self._numbers, self._plant.lag
        as_sent, as_corrected = sent.both_pieces(start.time - lag, end.time - lag)
        if not all(map(np.array_equal, as_sent, as_corrected)):
            found = [self._filter.deviation(start, end, *one) for one in (as_sent, as_corrected)]
        elif sent.contradicted and as_sent[1].any():
            found = [0.0, 0.0]
        else:
            return
        was_believed = sent.believes_measured
        sent.judge(found[0], found[1], numbers.improbable)
        if was_believed and not sent.believes_measured:
            self._begin(Posterior.initial(self._settings.drive_lag, self._scaling))

    def _interval(self, since: float, within: list[MeasuredPose], end: MeasuredPose) -> Interval:
        """Return the interval from `since` [s] to a pose, with some of those within it."""
        numbers, used = self._numbers, [end]
        # Poses in quick succession add little, and a long interval is to take no longer.
        apart = numbers.pose_spacing * max(1.0, 0.5 * (end.time - since) / numbers.spacing)
        for one in reversed(within):
            if min(used[-1].time - one.time, one.time - since) > apart - SAME:
                used.append(one)
        used.reverse()
        # A pose with an early stamp shows the effect of speeds sent after that.
        durations, speeds = self._sent.pieces(
            since - numbers.lead, end.time + numbers.longest_lag
        )
        return Interval(
            np.array([one.time for one in used]) - since, np.array([one.pose for one in used]),
            durations, speeds, numbers.lead,
        )
