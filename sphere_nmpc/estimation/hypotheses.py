# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Events that the model does not predict, as labels of the intervals, and what they cost.

What happens in an interval beyond the model's motion is a Gaussian step of the knot at its end,
whose covariance depends on the label. Without any event momentum, slope and imbalance are zero, so
that a robot that nothing disturbs has the paper's model.
"""

from dataclasses import dataclass, replace
from enum import Enum
from itertools import accumulate, product
from operator import or_

import numpy as np
from numpy.typing import NDArray

from sphere_nmpc.estimation.motion import Motion
from sphere_nmpc.estimation.posterior import (
    EXACT,
    KNOT,
    LAG,
    MOMENTUM_ERROR,
    SHARE,
    SLOPE_ERROR,
    TIGHT,
    PoseNoise,
    Scaling,
)
from sphere_nmpc.estimation.settings import EstimatorSettings
from sphere_nmpc.model.error_state import POSE_ERROR
from sphere_nmpc.model.state import Vector

_NOISES = (0.0, 1e-3, 3e-3, 1e-2, 3e-2)
"""Noises beyond that given that are tried, of the poses [rad; over the radius in m] and of their
stamps [s]."""

_MIN_TRANSVERSE_RATIO = 0.25
"""Effect of a late command in other directions than that of a short delay, over that [-]."""


class Event(Enum):
    """What happened in an interval."""

    NONE = "none"
    PUSHED = "pushed"
    TILTED = "tilted"
    SLIPPED = "slipped"
    LATE = "commands late or lost"


@dataclass(frozen=True)
class Hypothesis:
    """Labels of the intervals of the window."""

    events: tuple[Event, ...] = ()
    """Label of each interval, oldest first."""
    unbalanced: bool = False
    """Whether there is an imbalance; otherwise it is zero."""
    weak: bool = False
    """Whether the drives attain less than the acceleration limit."""
    disturbed: bool = False
    """Whether there was momentum or slope before the window."""
    torques: bool = False
    """Whether slope and imbalance before the window are not those known from older intervals."""
    slippery: bool = False
    """Whether the sphere has slipped before the window, so that it will again."""
    renewed: bool = False
    """Whether the common unknowns are not those known from older intervals."""
    pose_noise: PoseNoise = EXACT
    """Noise of the poses beyond that given."""

    def has_event(self, recent: int) -> bool:
        """Return whether there is an event in one of the newest intervals."""
        return any(event is not Event.NONE for event in self.events[-recent:])

    @property
    def simpler(self) -> list["Hypothesis"]:
        """Hypotheses without what was believed: momentum, slope and imbalance; all of it."""
        torques = (Event.PUSHED, Event.TILTED)
        events = tuple(Event.NONE if event in torques else event for event in self.events)
        level = replace(self, events=events, disturbed=False, torques=False, unbalanced=False)
        found = [] if self.is_undisturbed else [level]
        if self.has_event(len(self.events)):
            nothing = (Event.NONE,) * len(self.events)
            found.append(replace(level, events=nothing, weak=False, renewed=True))
        return found

    @property
    def fixed(self) -> NDArray[np.bool_]:
        """Which common unknowns have the values `NORMAL`, shape (9,)."""
        return np.array([False] * 5 + [not self.weak] + [not self.unbalanced] * 3)

    @property
    def is_undisturbed(self) -> bool:
        """Whether momentum, slope and imbalance are zero."""
        return not (self.walks or [self.begins_disturbed])[-1]

    @property
    def begins_disturbed(self) -> bool:
        """Whether there was momentum, slope or imbalance before the window."""
        return self.disturbed or self.unbalanced or self.torques

    @property
    def walks(self) -> list[bool]:
        """Whether momentum and slope may drift at the end of each interval."""
        disturbing = (e in (Event.PUSHED, Event.TILTED) for e in self.events)
        return list(accumulate(disturbing, or_, initial=self.begins_disturbed))[1:]

    def cost(self, numbers: EstimatorSettings) -> float:
        """Return -2 log of the probability of the events."""
        count = self.events.count
        # Jumps of a sphere at rest look like a slope for a while.
        rare = count(Event.PUSHED) ** 2 + 3 * count(Event.TILTED) ** 2
        rare += self.unbalanced + self.torques + self.renewed
        rare += 2 * sum(noise > 0.0 for noise in self.pose_noise)
        again = 0
        for times, known in ((count(Event.SLIPPED), self.slippery), (count(Event.LATE), False)):
            first = int(times > 0 and not known)
            rare += first
            again += times - first
        return numbers.rare * rare + numbers.again * again

    def extended(self, slippery: bool) -> "Hypothesis":
        """Return the hypothesis with another interval without an event."""
        return replace(self, events=(*self.events, Event.NONE), slippery=slippery)

    def shortened(self) -> "Hypothesis":
        """Return the hypothesis without the oldest interval."""
        event = self.events[0] in (Event.PUSHED, Event.TILTED)
        return replace(
            self, events=self.events[1:], disturbed=self.disturbed or self.torques or event,
            torques=False,
        )

    @property
    def noises(self) -> list["Hypothesis"]:
        """Hypotheses with other noises of the poses."""
        pose, time = self.pose_noise
        noises = [PoseNoise(one, time) for one in _NOISES]
        noises += [PoseNoise(pose, one) for one in _NOISES]
        return [replace(self, pose_noise=noise) for noise in noises]

    def alternatives(self, recent: int, momentum: bool) -> list[tuple[int | None, "Hypothesis"]]:
        """Return hypotheses that differ in one respect, with the interval of which the event does.

        In place of events, noise of the poses may explain all of them. Events are changed in the
        newest `recent` intervals; without `momentum` only those that leave none are possible.
        """
        events, found = self.events, []
        for i in range(max(0, len(events) - recent), len(events)):
            for kind in Event if momentum else (Event.NONE, Event.SLIPPED, Event.LATE):
                changed = replace(self, events=(*events[:i], kind, *events[i + 1 :]))
                found.append((i, changed))
        others = self.noises
        if self.has_event(recent):
            # Several events in a row look like noise, and noise like several events.
            others += [replace(one, events=(Event.NONE,) * len(events)) for one in others]
        if momentum:
            for unbalanced, torques in product((False, True), (self.torques, True)):
                others.append(replace(self, unbalanced=unbalanced, torques=torques))
        return [one for one in [*found, *((None, other) for other in others)] if one[1] != self]


def noise_variance(turned: float, numbers: EstimatorSettings) -> float:
    """Return the variance of each component of a predicted pose's error [m^2, rad^2].

    `turned` is the angle rolled in the interval [rad].
    """
    return numbers.prediction**2 * (1.0 + turned**2)


def step_covariances(
    motions: list[Motion],
    durations: Vector,
    variances: Vector,
    hypothesis: Hypothesis,
    scaling: Scaling,
) -> Vector:
    """Return the covariances of the steps at the ends of n intervals, shape (n, 10, 10).

    `durations` [s] and `variances` of each component of the predicted poses [m^2, rad^2] have
    shape (n,).
    """
    numbers, count = scaling.numbers, len(motions)
    diagonals = np.full((count, KNOT), TIGHT**2)
    diagonals[:, POSE_ERROR] = variances[:, None]
    walks = np.array(hypothesis.walks, dtype=bool)
    diagonals[walks, MOMENTUM_ERROR] = numbers.momentum_walk**2 * durations[walks, None]
    diagonals[walks, SLOPE_ERROR] = numbers.slope_walk**2 * durations[walks, None]
    covariances, places = np.zeros((count, KNOT, KNOT)), np.arange(KNOT)
    for k, event in enumerate(hypothesis.events):
        by = motions[k].by_unknowns
        if event is Event.SLIPPED:
            diagonals[k, POSE_ERROR] += scaling.pose_variance(numbers.slip)
        elif event is Event.PUSHED:
            covariances[k] += _at_unknown_time(by, MOMENTUM_ERROR, numbers.push)
        elif event is Event.TILTED:
            covariances[k] += _at_unknown_time(by, SLOPE_ERROR, numbers.tilt)
        elif event is Event.LATE:
            effect = numbers.late / numbers.lag * by[:, KNOT + LAG]
            covariances[k] += np.outer(effect, effect)
            # The motion is not linear in it.
            across = _MIN_TRANSVERSE_RATIO * float(np.linalg.norm(effect[2:5]))
            diagonals[k, POSE_ERROR] += scaling.pose_variance(across)
        spread = numbers.share_spread * by[:, KNOT + SHARE]
        covariances[k] += np.outer(spread, spread)
    covariances[:, places, places] += diagonals
    return covariances


def _at_unknown_time(by_unknowns: Vector, jumped: slice, deviation: float) -> Vector:
    """Return the covariance of a jump of these components at a uniformly distributed time.

    Its effect on the other components grows until the end, from a jump at the start: half of it is
    the mean, with a variance of a twelfth.
    """
    effect = deviation * by_unknowns[:, jumped]
    own = np.zeros_like(effect)
    own[jumped] = deviation * np.eye(effect.shape[1])
    later = effect - own
    covariance: Vector = (own + 0.5 * later) @ (own + 0.5 * later).T + later @ later.T / 12.0
    return covariance
