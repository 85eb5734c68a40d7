# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Extended Kalman filter with drift, in which pushes are looked for."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

from sphere_nmpc.estimation.drift_filter_state import PUSHED, DriftFilterState
from sphere_nmpc.estimation.filter_state import FilterState, Kind, PoseNoise
from sphere_nmpc.estimation.plant_parameters import ParameterDistribution, ParameterScaling
from sphere_nmpc.estimation.sent_inputs import SentInputs
from sphere_nmpc.estimation.state_estimator import Entry, StateEstimator
from sphere_nmpc.model.drift import Drift
from sphere_nmpc.model.state import Vector

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

_Entry = Entry[DriftFilterState]


class DriftStateEstimator(StateEstimator[DriftFilterState]):
    """`StateEstimator` whose model has drift.

    A push leaves a few poses inside the gate until the motion shows. So where poses fit badly, the
    newest ones are fused again after a jump of the momentum before them, and the better history is
    kept (a generalised likelihood ratio test).

    Parameters
    ----------
    sent, scaling, parameters, noise
        As in `StateEstimator`.
    """

    def __init__(
        self,
        sent: SentInputs,
        scaling: ParameterScaling,
        parameters: ParameterDistribution,
        noise: PoseNoise,
    ) -> None:
        super().__init__(sent, scaling, parameters, noise, DriftFilterState)
        self.pushes = 0
        """Pushes found since the start."""
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
            self.pushes += 1
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
