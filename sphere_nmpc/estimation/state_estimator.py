# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Where the robot is, from late and noisy poses and the rotor speeds that were really sent.

A multiplicative extended Kalman filter on the plane times SO(3): the state stays a unit
quaternion and its error is a deviation of five numbers (`sphere_nmpc.model.tangent`). The plant's
constants and lag are five more unknowns of the same filter, so that every pose counts once and
the whole way rolled, not the noisy difference of two neighbours, tells about them.

A pose is fused at the time at which it was measured. One that comes out of order is put where it
belongs and those behind it are fused again. One that cannot be is left out, but a few in a row
that agree with each other are believed: then something else has moved the robot.
"""

from collections import deque
from dataclasses import dataclass, replace

from sphere_nmpc.estimation.belief import Belief, PoseNoise
from sphere_nmpc.estimation.sent_inputs import SentInputs
from sphere_nmpc.estimation.unknowns import Unknowns, noticeable
from sphere_nmpc.model.parameters import LumpedConstants
from sphere_nmpc.model.state import Vector

AGREEING = 3
"""Poses in a row that must agree with each other to be believed against the prediction."""
STUBBORN = 8
"""Poses left out in a row after which the newest one is believed whatever it says."""
MEMORY = 64
"""Poses that can be fused again for one that comes out of order."""


@dataclass(frozen=True, eq=False)
class _Fused:
    """A pose as it was measured and what was believed once it had been looked at."""

    stamp: float
    pose: Vector
    belief: Belief


class StateEstimator:
    """Fuse poses with the inputs sent.

    Parameters
    ----------
    sent : SentInputs
        Rotor speeds that were really sent.
    nominal : LumpedConstants
        What the robot was built to.
    noise : PoseNoise
        Of the poses.
    lag : float, optional
        Lag that is expected [s].
    learning : bool, optional
        Whether constants and lag are unknowns; otherwise they are what is given.
    """

    def __init__(
        self,
        sent: SentInputs,
        nominal: LumpedConstants,
        noise: PoseNoise,
        lag: float = 0.0,
        learning: bool = True,
    ) -> None:
        self._sent = sent
        self._unknowns = Unknowns(nominal, lag)
        self._pose_noise = noise
        self._learning = learning
        self._fused: deque[_Fused] = deque(maxlen=MEMORY)
        self._learnt: Belief | None = None
        self.outliers = 0
        """Poses left out as they could not be."""
        self.jumps = 0
        """Times that poses were believed against the prediction."""

    @property
    def constants(self) -> LumpedConstants:
        """The constants as believed now."""
        return self._unknowns.lumped(self._scale)

    @property
    def lag(self) -> float:
        """How far the motion lags behind what is sent [s]."""
        return noticeable(self._unknowns.lag(self._scale))

    @property
    def surprise(self) -> float:
        """How much more than expected the robot is disturbed: factor on the process noise."""
        return self._fused[-1].belief.inflation if self._fused else 1.0

    @property
    def _scale(self) -> Vector:
        return self._unknowns.centre if self._learnt is None else self._learnt.scale

    def forget(self) -> None:
        """Forget where the robot is, as after a jump of the clock; what was learnt stays."""
        self._fused.clear()

    def observe(self, stamp: float, pose: Vector) -> bool:
        """Take a pose, shape (6,), that was measured at control time `stamp` [s].

        Returns
        -------
        bool
            False if it is known already or too old to be put where it belongs.
        """
        later: list[_Fused] = []
        while self._fused and self._fused[-1].stamp > stamp:
            later.append(self._fused.pop())
        known = bool(self._fused) and self._fused[-1].stamp == stamp
        if known or (later and not self._fused):
            self._fused.extend(reversed(later))
            return False
        self._fuse(stamp, pose)
        for entry in reversed(later):
            self._fuse(entry.stamp, entry.pose)
        self._learnt = self._fused[-1].belief
        return True

    def predict(self, time: float) -> Belief | None:
        """Return what is believed about the control time `time` [s]; None before any pose."""
        return self._fused[-1].belief.carried_to(time, self._sent) if self._fused else None

    def _fuse(self, stamp: float, pose: Vector) -> None:
        if not self._fused:
            belief = self._first(stamp, pose)
        else:
            before = self._fused[-1].belief
            belief, fits = before.with_pose(stamp, pose, self._sent)
            if not fits:
                belief = self._doubt(belief, stamp, pose)
        self._fused.append(_Fused(stamp, pose, belief))

    def _first(self, stamp: float, pose: Vector) -> Belief:
        return Belief.at_pose(
            stamp, pose, self._pose_noise, self._unknowns, self._learnt, self._learning
        )

    def _doubt(self, belief: Belief, stamp: float, pose: Vector) -> Belief:
        """Leave a pose out, or believe it with those before it that were left out."""
        self.outliers += 1
        suspects = (*belief.suspects, (stamp, pose))
        if len(suspects) >= AGREEING:
            first, *others = suspects[-AGREEING:]
            fresh = self._first(*first)
            for other in others:
                fresh, fits = fresh.with_pose(*other, self._sent)
                if not fits:
                    break
            else:
                self.jumps += 1
                return fresh
        if len(suspects) >= STUBBORN:
            self.jumps += 1
            return self._first(stamp, pose)
        return replace(belief, suspects=suspects)
