# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Error-state extended Kalman filter on late and noisy poses and the rotor speeds sent.

The state lives on the plane times SO(3): it stays a unit quaternion and its error is a vector of
five numbers (`sphere_nmpc.model.error_state`). The plant's constants and lag are five more states
of the same filter, so that each pose is used once, and the parameters are estimated from the whole
path instead of from noisy differences between neighbouring poses.

A pose is fused at the time at which it was measured. One that arrives out of order is inserted
where it belongs, and the later ones are fused again. A pose outside the gate is rejected as an
outlier, but several outliers in a row that agree with each other restart the filter there: then
something other than the rotors has moved the robot.
"""

import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Generic

import numpy as np

from sphere_nmpc.estimation.drift import NO_DRIFT, Drift
from sphere_nmpc.estimation.filter_state import (
    PUSHED,
    REST_NOISE,
    DriftFilterState,
    FilterState,
    Kind,
    PoseNoise,
)
from sphere_nmpc.estimation.plant_parameters import ParameterDistribution, ParameterScaling
from sphere_nmpc.estimation.sent_inputs import SentInputs
from sphere_nmpc.model.state import Vector

AGREEING_OUTLIERS = 3
"""Outliers in a row that restart the filter if they agree with each other."""
MAX_OUTLIERS = 8
"""Outliers in a row after which the filter restarts from the newest pose in any case."""
HISTORY = 64
"""Poses kept to be fused again after one that arrives out of order."""
_AGES = (2, 5, 10, 16)
"""Ages of a push that are tried, in poses."""
_SUSPICIOUS = 1.1
"""Average innovation ratio above which a push is looked for."""
_SPACING = 2
"""Poses between two searches, each of which fuses some thirty poses again."""
_GAIN = 10.0
"""Logarithm of the ratio of likelihoods above which a push is taken as the cause."""
_REPEATED = 3.0
"""Time after a push [s] within which another one is not believed: rather slope and imbalance are
wrong, and all of the drift but the momentum is learnt again."""
_COMPARED = 40
"""Poses that are compared when drift appears ..."""
_BEFORE = 12
"""... and the least number that the model without drift must have explained before a push."""


@dataclass(frozen=True, eq=False)
class Entry(Generic[Kind]):
    """A pose as measured at control time `stamp` [s], and the filter's state after it."""

    stamp: float
    pose: Vector
    after: Kind


class StateEstimator(Generic[Kind]):
    """Extended Kalman filter with the history that poses out of order need.

    `parameters` are the prior of the parameters; one without variance is taken as exact. `kind` is
    the model of the filter.
    """

    def __init__(
        self,
        sent: SentInputs,
        scaling: ParameterScaling,
        parameters: ParameterDistribution,
        noise: PoseNoise,
        kind: type[Kind],
    ) -> None:
        self._kind = kind
        self._sent = sent
        self._scaling = scaling
        self._parameters = parameters
        self.noise = noise
        """Measurement noise of the poses from now on."""
        self._history: deque[Entry[Kind]] = deque(maxlen=HISTORY)

    @property
    def newest(self) -> tuple[float, Vector] | None:
        """Control time [s] and state, shape (6,), of the newest pose; None without any."""
        return (self._history[-1].stamp, self._history[-1].pose) if self._history else None

    @property
    def parameters(self) -> ParameterDistribution:
        """Distribution of the parameters after the last pose."""
        return self._parameters

    @property
    def drift(self) -> Drift:
        """Drift after the newest pose."""
        return self._history[-1].after.drift if self._history else NO_DRIFT

    @property
    def entries(self) -> list[Entry[Kind]]:
        """Poses and states that are kept, oldest first."""
        return list(self._history)

    @property
    def likelihood(self) -> float:
        """Logarithm of the likelihood of the newest pose, up to a constant."""
        return self._history[-1].after.likelihood if self._history else 0.0

    def disturbance(self, duration: float) -> float:
        """Return the standard deviation of a robot at rest after `duration` [s], each state."""
        inflation = self._history[-1].after.inflation if self._history else 1.0
        return REST_NOISE * float(np.sqrt(inflation * duration))

    def forget(self) -> None:
        """Discard all poses, as after a jump of the clock; the parameters stay."""
        self._history.clear()

    def set_parameters(self, parameters: ParameterDistribution) -> None:
        """Continue from the estimated state with another distribution of the parameters.

        Poses older than the newest one are too old from then on.
        """
        self._parameters = parameters
        if self._history:
            last = self._history[-1]
            self._history.clear()
            after = last.after.with_parameters(parameters, last.stamp, self._sent)
            self._history.append(replace(last, after=after))

    def observe(self, stamp: float, pose: Vector) -> bool:
        """Take a pose, shape (6,), measured at control time `stamp` [s].

        Returns
        -------
        bool
            False if there is one of this time already or it is older than the history.
        """
        before = self._history.copy()
        later: list[Entry[Kind]] = []
        while self._history and self._history[-1].stamp > stamp:
            later.append(self._history.pop())
        known = bool(self._history) and self._history[-1].stamp == stamp
        if known or (later and not self._history):
            self._history = before
            return False
        try:
            self._fuse(stamp, pose)
            for entry in reversed(later):
                self._fuse(entry.stamp, entry.pose)
        except Exception:
            self._history = before
            raise
        self._parameters = self._history[-1].after.parameters
        return True

    def predict(self, time: float) -> Kind | None:
        """Return the filter's state predicted to control time `time` [s]; None without a pose."""
        return self._history[-1].after.predicted(time, self._sent) if self._history else None

    def _fuse(self, stamp: float, pose: Vector) -> None:
        if not self._history:
            after = self._at_pose(stamp, pose)
        else:
            before = self._history[-1].after
            after, fused = before.updated(stamp, pose, self.noise, self._sent)
            if not fused:
                after = self._after_outlier(after, stamp, pose)
        self._history.append(Entry(stamp, pose, after))

    def _at_pose(self, stamp: float, pose: Vector) -> Kind:
        return self._kind.at_pose(stamp, pose, self.noise, self._scaling, self._parameters)

    def _after_outlier(self, predicted: Kind, stamp: float, pose: Vector) -> Kind:
        """Return the prediction, or the state restarted from the last outliers."""
        outliers = (*predicted.outliers, (stamp, pose))
        if len(outliers) >= AGREEING_OUTLIERS:
            first, *others = outliers[-AGREEING_OUTLIERS:]
            restarted = self._at_pose(*first)
            for other in others:
                restarted, fused = restarted.updated(*other, self.noise, self._sent)
                if not fused:
                    break
            else:
                return restarted
        if len(outliers) >= MAX_OUTLIERS:
            return self._at_pose(stamp, pose)
        return replace(predicted, outliers=outliers)


_Entry = Entry[DriftFilterState]


class DriftStateEstimator(StateEstimator[DriftFilterState]):
    """`StateEstimator` whose model has drift.

    A push leaves a few poses inside the gate until the motion shows. So where poses fit badly, the
    newest ones are fused again after a jump of the momentum before them, and the better history is
    kept (a generalised likelihood ratio test).
    """

    def __init__(
        self,
        sent: SentInputs,
        scaling: ParameterScaling,
        parameters: ParameterDistribution,
        noise: PoseNoise,
    ) -> None:
        super().__init__(sent, scaling, parameters, noise, DriftFilterState)
        self._since_tried = 0
        self._pushed_at = -math.inf
        self._before: DriftFilterState | None = None

    @property
    def drift(self) -> Drift:
        """Drift after the newest pose, or before the poses were forgotten."""
        return super().drift if self._before is None else self._before.drift

    def forget(self) -> None:
        """Discard all poses; parameters and drift stay, the momentum with a large variance."""
        if self._history:
            self._before = self._history[-1].after
        self._pushed_at = -math.inf
        super().forget()

    def _at_pose(self, stamp: float, pose: Vector) -> DriftFilterState:
        begun = super()._at_pose(stamp, pose)
        known, self._before = self._before, None
        return begun if known is None else begun.with_drift_of(known)

    def adopt(self, paper: StateEstimator[FilterState]) -> None:
        """Continue from the filter of the paper's model and a push if that explains the poses.

        They have to be more likely since the push and in all. A filter that has had little motion
        to learn from takes a push for a slope.
        """
        count = min(len(paper.entries), len(self._history), _COMPARED)
        entries, own = paper.entries[-count:], list(self._history)[-count:]
        tried: list[tuple[float, list[_Entry]]] = []
        for age in _AGES:
            if age + _BEFORE < count:
                base = entries[-age - 1]
                before = _likelihood(entries[:-age]) - _likelihood(own[:-age])
                pushed = DriftFilterState.from_paper(base.after, PUSHED)
                for start in (pushed, pushed.doubted()):
                    begun = Entry(base.stamp, base.pose, start)
                    found = self._fused_again(begun, entries[-age:])
                    since = _likelihood(found[1:]) - _likelihood(own[-age:])
                    tried.append((min(since, since + before), found))
        if not tried:
            return
        gain, found = max(tried, key=lambda one: one[0])
        if gain > 0.0:
            self._pushed_at = found[-1].stamp
            self._history.clear()
            self._history.extend(found)
            self._parameters = found[-1].after.parameters

    def _fuse(self, stamp: float, pose: Vector) -> None:
        before = list(self._history)
        super()._fuse(stamp, pose)
        newest = self._history[-1]
        self._since_tried += 1
        suspicious = newest.after.ratio > _SUSPICIOUS or bool(newest.after.outliers)
        if not suspicious or self._since_tried < _SPACING:
            return
        self._since_tried = 0
        entries = [*before, newest]
        ages = [age for age in _AGES if age < len(entries)]
        if not ages:
            return
        pushed, doubted = DriftFilterState.pushed, DriftFilterState.doubted
        again = stamp - self._pushed_at < _REPEATED
        tried = [self._changed(entries, age, doubted if again else pushed) for age in ages]
        if not again:
            tried.append(self._changed(entries, ages[-1], doubted))
        gain, found = max(tried, key=lambda one: one[0])
        if gain > _GAIN:
            self._pushed_at = stamp
            self._history.clear()
            self._history.extend(found)

    def _changed(
        self,
        entries: list[_Entry],
        age: int,
        change: Callable[[DriftFilterState], DriftFilterState],
    ) -> tuple[float, list[_Entry]]:
        """Return the entries with a change `age` poses ago, and the likelihood gained by it."""
        base, again = entries[-age - 1], entries[-age:]
        found = self._fused_again(replace(base, after=change(base.after)), again)
        gain = _likelihood(found[1:]) - _likelihood(again)
        return gain, [*entries[: -age - 1], *found]

    def _fused_again(self, base: _Entry, later: Sequence[Entry[Kind]]) -> list[_Entry]:
        """Return `base` and the entries after it, fused again."""
        found, state = [base], replace(base.after, outliers=())
        for entry in later:
            state, _ = state.updated(entry.stamp, entry.pose, self.noise, self._sent)
            found.append(Entry(entry.stamp, entry.pose, state))
        return found


def _likelihood(entries: Sequence[Entry[Kind]]) -> float:
    return sum(entry.after.likelihood for entry in entries)
