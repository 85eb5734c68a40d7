# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""What is believed about state, constants and lag at a time, with its covariance."""

from dataclasses import dataclass, replace

import numpy as np

from sphere_nmpc.estimation import unknowns as known
from sphere_nmpc.estimation.sent_inputs import SentInputs
from sphere_nmpc.estimation.unknowns import LAG_PRIOR, Unknowns
from sphere_nmpc.model.state import Vector
from sphere_nmpc.model.tangent import (
    DEVIATION_SIZE,
    carried,
    deviated,
    deviation_between,
    state_rates,
)

SIZE = DEVIATION_SIZE + known.SIZE
"""Deviation of the state, then the scaled unknowns."""
GATE = 27.0
"""Squared Mahalanobis distance of a pose that is left out: one in 16000 true ones is beyond."""
REST_NOISE = 5e-5
"""Disturbance of a robot at rest [m or rad over the root of a second]."""
ROLLING_NOISE = 1e-3
"""Disturbance of a rolling one over its speed [root of a second]: 0.1 % of the way of a second."""
WANDER = 1e-4
"""Change of the constants over their nominal values while the rotors turn [1 / sqrt(s)]."""
CALM, ALARMED = 1.2, 1.6
"""Squared innovations over their expectation that let the process noise fall or rise ..."""
FALL, RISE = 0.9, 1.5
"""... by these factors a pose ..."""
MOST = 1e4
"""... up to this one."""
_AVERAGED = 12.0
"""Poses in the average of the squared innovations."""
_CAP = 4.0
"""Largest ratio that counts in it: a lone outlier that passes the gate raises no alarm."""
_TURNING = 1.0
"""Rotor speed [rad/s] below which nothing wanders."""

State = slice(0, DEVIATION_SIZE)
Rest = slice(DEVIATION_SIZE, SIZE)


@dataclass(frozen=True)
class PoseNoise:
    """Standard deviations of a measured pose about each axis: position [m], angle [rad]."""

    position: float
    angle: float

    @property
    def covariance(self) -> Vector:
        """Covariance of the deviation of a pose, shape (5, 5)."""
        matrix: Vector = np.diag([self.position**2] * 2 + [self.angle**2] * 3)
        return matrix


@dataclass(frozen=True, eq=False)
class Belief:
    """A Gaussian on the plane times SO(3) times the unknowns; never changed, only succeeded.

    Attributes
    ----------
    time : float
        Control time of the inputs that have moved the robot so far [s]; a pose is `lag` older.
    state : ndarray, shape (6,)
    scale : ndarray, shape (5,)
        The unknowns, scaled; see `Unknowns`.
    joint : ndarray, shape (10, 10)
        Covariance of the deviation of the state and of the unknowns.
    noise : PoseNoise
        Of the poses.
    unknowns : Unknowns
        What the scaled numbers mean.
    inflation : float
        Factor on the variance of the process noise, 1 while all goes as expected.
    innovation : float
        Average of the squared innovations over their expectation.
    suspects : tuple of (float, ndarray)
        Stamps and poses that were left out since the last one that was not.
    """

    time: float
    state: Vector
    scale: Vector
    joint: Vector
    noise: PoseNoise
    unknowns: Unknowns
    inflation: float = 1.0
    innovation: float = 1.0
    suspects: tuple[tuple[float, Vector], ...] = ()

    @classmethod
    def at_pose(
        cls,
        stamp: float,
        pose: Vector,
        noise: PoseNoise,
        unknowns: Unknowns,
        learnt: "Belief | None",
        learning: bool,
    ) -> "Belief":
        """Return the belief of one who sees a pose and knows what was learnt before."""
        joint = np.zeros((SIZE, SIZE))
        joint[State, State] = noise.covariance
        scale = unknowns.centre
        if learnt is not None:
            scale = learnt.scale
            joint[Rest, Rest] = learnt.joint[Rest, Rest]
        elif learning:
            joint[Rest, Rest] = np.diag(unknowns.spread**2)
        return cls(stamp - unknowns.lag(scale), pose, scale, joint, noise, unknowns)

    @property
    def covariance(self) -> Vector:
        """Covariance of the deviation [m; world frame, rad; body frame], shape (5, 5)."""
        return self.joint[State, State].copy()

    @property
    def constants(self) -> Vector:
        """[Rs, c1, r1, r3], shape (4,)."""
        return self.unknowns.constants(self.scale)

    @property
    def uncertainty(self) -> float:
        """Standard deviation of the error of the state in R^6 [mixed units]."""
        variances = np.diag(self.joint)[State]
        # A rotation by a small angle moves its quaternion half as far.
        return float(np.sqrt(np.sum(variances[:2]) + 0.25 * np.sum(variances[2:])))

    def disturbance(self, duration: float) -> float:
        """Return what a robot at rest is disturbed by within `duration` [s], each state [m, -]."""
        return REST_NOISE * float(np.sqrt(self.inflation * duration))

    def carried_to(self, time: float, sent: SentInputs) -> "Belief":
        """Return the belief about a later time [s], given what was sent."""
        if time <= self.time:
            return self
        state, joint = self.state, self.joint
        durations, speeds = sent.pieces(self.time, time)
        slopes = self.unknowns.slopes()
        for duration, here, there in zip(durations, speeds[:-1], speeds[1:], strict=True):
            state, by_state, by_constants = carried(
                state, (here, there), float(duration), self.constants
            )
            transition = np.eye(SIZE)
            transition[State, State] = by_state
            transition[State, DEVIATION_SIZE : DEVIATION_SIZE + 4] = by_constants * slopes
            joint = transition @ joint @ transition.T
            joint += self._process_noise(float(duration), 0.5 * (here + there))
        return replace(self, time=time, state=state, joint=joint)

    def with_pose(self, stamp: float, pose: Vector, sent: SentInputs) -> tuple["Belief", bool]:
        """Fuse a pose, shape (6,), measured at `stamp` [s]; False with it where it does not fit.

        The belief returned with False is the prediction alone.
        """
        before = self.carried_to(stamp - self.unknowns.lag(self.scale), sent)
        rates = state_rates(before.state, sent.at(before.time), before.constants)
        # If the lag is longer than believed, the pose is of an earlier state.
        seen = np.zeros((DEVIATION_SIZE, SIZE))
        seen[:, State] = np.eye(DEVIATION_SIZE)
        seen[:, -1] = -LAG_PRIOR * rates
        noise = self.noise.covariance
        spread = seen @ before.joint @ seen.T + noise
        surprise = deviation_between(before.state, pose)
        square = float(surprise @ np.linalg.solve(spread, surprise))
        if square > GATE:
            return before, False
        gain = np.linalg.solve(spread, seen @ before.joint).T
        change = gain @ surprise
        kept = np.eye(SIZE) - gain @ seen
        joint = kept @ before.joint @ kept.T + gain @ noise @ gain.T
        ratio = min(square / DEVIATION_SIZE, _CAP)
        average = self.innovation + (ratio - self.innovation) / _AVERAGED
        inflation = self.inflation
        if average > ALARMED:
            inflation = min(MOST, RISE * inflation)
        elif average < CALM:
            inflation = max(1.0, FALL * inflation)
        fused = replace(
            before,
            state=deviated(before.state, change[State]),
            scale=self.unknowns.within(before.scale + change[Rest]),
            joint=0.5 * (joint + joint.T),
            inflation=inflation,
            innovation=average,
            suspects=(),
        )
        return fused, True

    def _process_noise(self, duration: float, speeds: Vector) -> Vector:
        """Return what an interval of constant speeds [rad/s] adds to the covariance."""
        turning = float(np.max(np.abs(speeds)))
        rate = float(self.constants[1] * np.linalg.norm(speeds))
        variances = np.zeros(SIZE)
        shift = REST_NOISE**2 + (ROLLING_NOISE * rate * self.constants[0]) ** 2
        turn = REST_NOISE**2 + (ROLLING_NOISE * rate) ** 2
        variances[:2], variances[2:DEVIATION_SIZE] = shift, turn
        variances *= self.inflation
        learning = self.joint[-1, -1] > 0.0
        if turning > _TURNING and learning:
            variances[DEVIATION_SIZE : DEVIATION_SIZE + 4] = WANDER**2
        noise: Vector = np.diag(variances * duration)
        return noise
