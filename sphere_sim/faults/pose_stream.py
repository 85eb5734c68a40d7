# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Disturbances of a stream of poses: changed, lost, duplicated and delayed samples."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sphere_nmpc.quantity import NANOSECONDS


@dataclass(frozen=True)
class PoseSample:
    """A pose between publisher and subscriber.

    Attributes
    ----------
    stamp : int
        Time of the measurement [ns].
    values : tuple of float
        x, y, then the quaternion w, x, y, z [m, -]; need not be finite.
    frame : str
        Frame of the pose.
    """

    stamp: int
    values: tuple[float, ...]
    frame: str


Arrival = tuple[int, PoseSample]
"""Time at which a sample arrives [ns], and the sample."""
Disturbance = Callable[[Arrival, np.random.Generator], list[Arrival]]


def dropped(share: float) -> Disturbance:
    """Drop a share of the samples."""
    return lambda arrival, rng: [] if rng.random() < share else [arrival]


def delayed(by: float) -> Disturbance:
    """Delay all samples by `by` [s]."""
    late = round(by * NANOSECONDS)
    return lambda arrival, rng: [(arrival[0] + late, arrival[1])]


def shuffled(within: float) -> Disturbance:
    """Delay each sample by a random time up to `within` [s], so that they overtake each other."""
    return lambda arrival, rng: [
        (arrival[0] + round(rng.uniform(0.0, within) * NANOSECONDS), arrival[1])
    ]


def duplicated(times: int) -> Disturbance:
    """Deliver each sample several times."""
    return lambda arrival, rng: [arrival] * times


def stamped(ahead: float) -> Disturbance:
    """Move the stamps into the future by `ahead` [s]."""
    return _changed(
        lambda sample, rng: replace(sample, stamp=sample.stamp + round(ahead * NANOSECONDS))
    )


def not_finite(share: float = 1.0) -> Disturbance:
    """Replace one number by NaN or infinity in a share of the samples."""

    def corrupt(sample: PoseSample, rng: np.random.Generator) -> PoseSample:
        if rng.random() >= share:
            return sample
        values = list(sample.values)
        values[rng.integers(len(values))] = rng.choice([np.nan, np.inf, -np.inf])
        return replace(sample, values=tuple(values))

    return _changed(corrupt)


def sign_flipped() -> Disturbance:
    """Flip the sign of every other quaternion, at random: the same rotation."""
    return _changed(
        lambda sample, rng: _with_quaternion(sample, -1.0 if rng.random() < 0.5 else 1.0)
    )


def scaled(by: float) -> Disturbance:
    """Scale the quaternion by a factor."""
    return _changed(lambda sample, rng: _with_quaternion(sample, by))


def framed(frame: str) -> Disturbance:
    """Set another frame."""
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
    """Delay line of samples with any number of disturbances.

    Parameters
    ----------
    rng : Generator
        Source of randomness.
    """

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng
        """Source of randomness."""
        self.disturbances: list[Disturbance] = []
        """Disturbances of the samples that enter from now on, applied in this order."""
        self._pending: list[Arrival] = []

    def enter(self, now: int, sample: PoseSample) -> None:
        """Take a sample at time `now` [ns]."""
        arrivals = [(now, sample)]
        for disturb in self.disturbances:
            arrivals = [out for arrival in arrivals for out in disturb(arrival, self.rng)]
        self._pending.extend(arrivals)

    def leave(self, now: int) -> list[PoseSample]:
        """Return the samples that have arrived by `now` [ns], in the order of arrival."""
        ready = sorted((a for a in self._pending if a[0] <= now), key=lambda a: a[0])
        self._pending = [arrival for arrival in self._pending if arrival[0] > now]
        return [sample for _, sample in ready]

    def clear(self) -> None:
        """Discard all samples that have not arrived, as when time restarts."""
        self._pending.clear()


def _changed(change: Callable[[PoseSample, np.random.Generator], PoseSample]) -> Disturbance:
    return lambda arrival, rng: [(arrival[0], change(arrival[1], rng))]


def _with_quaternion(sample: PoseSample, factor: float) -> PoseSample:
    quaternion = tuple(factor * value for value in sample.values[2:])
    return replace(sample, values=(*sample.values[:2], *quaternion))
