# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Faults of a stream of poses: what each sample becomes on its way, and when it arrives."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

NANOSECONDS = 1_000_000_000


@dataclass(frozen=True)
class PoseSample:
    """A pose on its way.

    Attributes
    ----------
    stamp : int
        When it was measured [ns].
    values : tuple of float
        x, y, then the quaternion w, x, y, z [m, -]; need not be finite.
    frame : str
        Frame of the pose.
    """

    stamp: int
    values: tuple[float, ...]
    frame: str


Arrival = tuple[int, PoseSample]
"""When a sample arrives [ns] and what it then is."""
Disturbance = Callable[[Arrival, np.random.Generator], list[Arrival]]


def dropped(share: float) -> Disturbance:
    """Lose a share of the samples."""
    return lambda arrival, rng: [] if rng.random() < share else [arrival]


def delayed(by: float) -> Disturbance:
    """Let samples arrive later by so many seconds."""
    late = round(by * NANOSECONDS)
    return lambda arrival, rng: [(arrival[0] + late, arrival[1])]


def shuffled(within: float) -> Disturbance:
    """Delay each sample by a random time up to `within` [s], so that they overtake each other."""
    return lambda arrival, rng: [
        (arrival[0] + round(rng.uniform(0.0, within) * NANOSECONDS), arrival[1])
    ]


def duplicated(times: int) -> Disturbance:
    """Let each sample arrive several times."""
    return lambda arrival, rng: [arrival] * times


def stamped(ahead: float) -> Disturbance:
    """Move the stamps ahead by so many seconds."""
    return _changed(
        lambda sample, rng: replace(sample, stamp=sample.stamp + round(ahead * NANOSECONDS))
    )


def not_finite(share: float = 1.0) -> Disturbance:
    """Put NaN or infinity into one number of a share of the samples."""

    def spoil(sample: PoseSample, rng: np.random.Generator) -> PoseSample:
        if rng.random() >= share:
            return sample
        values = list(sample.values)
        values[rng.integers(len(values))] = rng.choice([np.nan, np.inf, -np.inf])
        return replace(sample, values=tuple(values))

    return _changed(spoil)


def sign_flipped() -> Disturbance:
    """Flip the sign of every other quaternion, at random: the same rotation."""
    return _changed(
        lambda sample, rng: _with_quaternion(sample, -1.0 if rng.random() < 0.5 else 1.0)
    )


def scaled(by: float) -> Disturbance:
    """Give the quaternion another norm."""
    return _changed(lambda sample, rng: _with_quaternion(sample, by))


def framed(frame: str) -> Disturbance:
    """Name another frame."""
    return _changed(lambda sample, rng: replace(sample, frame=frame))


DISTURBANCES: dict[str, Callable[..., Disturbance]] = {
    make.__name__: make
    for make in (
        dropped, delayed, shuffled, duplicated, stamped, not_finite, sign_flipped, scaled, framed
    )
}


def make_disturbance(options: dict[str, Any]) -> Disturbance:
    """Return the disturbance that ``options["disturbance"]`` names, with the other options."""
    rest = {key: value for key, value in options.items() if key != "disturbance"}
    return DISTURBANCES[options["disturbance"]](**rest)


class PoseStream:
    """Samples on their way through any number of disturbances.

    Parameters
    ----------
    rng : Generator
        Behind all chance.
    """

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self.disturbances: list[Disturbance] = []
        """What acts on the samples that come in from now on."""
        self._under_way: list[Arrival] = []

    def enter(self, now: int, sample: PoseSample) -> None:
        """Let a sample in at `now` [ns]."""
        arrivals = [(now, sample)]
        for disturb in self.disturbances:
            arrivals = [out for arrival in arrivals for out in disturb(arrival, self._rng)]
        self._under_way.extend(arrivals)

    def leave(self, now: int) -> list[PoseSample]:
        """Return what has arrived by `now` [ns], in the order of arrival."""
        ready = sorted((a for a in self._under_way if a[0] <= now), key=lambda a: a[0])
        self._under_way = [arrival for arrival in self._under_way if arrival[0] > now]
        return [sample for _, sample in ready]

    def clear(self) -> None:
        """Forget what is under way, as when time starts anew."""
        self._under_way.clear()


def _changed(change: Callable[[PoseSample, np.random.Generator], PoseSample]) -> Disturbance:
    return lambda arrival, rng: [(arrival[0], change(arrival[1], rng))]


def _with_quaternion(sample: PoseSample, factor: float) -> PoseSample:
    quaternion = tuple(factor * value for value in sample.values[2:])
    return replace(sample, values=(*sample.values[:2], *quaternion))
