# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Mounting, offset of stamps and noise of an IMU, from readings beside a motion that is known."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from sphere_nmpc.errors import Description, InvalidInputError
from sphere_nmpc.model import rotation
from sphere_nmpc.model.disturbance import GRAVITY
from sphere_nmpc.model.state import Vector
from sphere_sim.evaluation.series import Series
from sphere_sim.identification.fitting import fitted

Value: TypeAlias = tuple[Vector, Vector]
"""Numbers, and their standard deviations."""
_FEWEST = 100
_REST = 41
"""Readings in a row, those around one, in which the shell rests."""
_STILL = 5e-3
"""Angular velocity below which the shell rests [rad/s]."""
_ABOUT_ONE_AXIS = 0.03
"""Share of the rotation about a second axis up to which the axes of the IMU are not seen [-]."""
_MEAN_OF = 5
"""Readings whose forces are taken together."""
_UNEXPLAINED = 0.5
"""Share of a gyro's rates that no mounting explains, from which on they are of something else."""
_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class Readings:
    """Readings of an IMU at times [s], shape (N,), rising: rates and forces, (N, 3), its axes."""

    times: Vector
    rates: Vector
    forces: Vector


@dataclass(frozen=True, eq=False)
class Track:
    """Known motion of the shell, in parts.

    Attributes
    ----------
    times : ndarray, shape (N,)
        Rising [s].
    quaternions, rates : ndarray, shapes (N, 4) and (N, 3)
        Orientations, and angular velocities [rad/s; body frame].
    parts : ndarray of int, shape (N,)
        Number of the part that a time belongs to, from 0 on.
    """

    times: Vector
    quaternions: Vector
    rates: Vector
    parts: NDArray[np.intp]

    def part_at(self, times: Vector, margin: float) -> NDArray[np.intp]:
        """Return in which part times are, -1 within a margin [s] of its ends or outside."""
        before = self._part(times - margin)
        return np.where(before == self._part(times + margin), before, -1)

    def _part(self, times: Vector) -> NDArray[np.intp]:
        after = np.clip(np.searchsorted(self.times, times), 1, self.times.size - 1)
        inside = (times >= self.times[0]) & (times <= self.times[-1])
        inside &= self.parts[after] == self.parts[after - 1]
        return np.where(inside, self.parts[after], -1)

    def rates_at(self, times: Vector) -> Vector:
        """Return the angular velocities at times within the parts [rad/s; body frame]."""
        return Series(self.times, self.rates).interpolated(times)

    def quaternions_at(self, times: Vector) -> Vector:
        """Return the orientations at times within the parts."""
        after = np.clip(np.searchsorted(self.times, times), 1, self.times.size - 1)
        share = (times - self.times[after - 1]) / (self.times[after] - self.times[after - 1])
        begin, end = self.quaternions[after - 1], self.quaternions[after]
        found = begin + share[:, None] * (rotation.nearer_sign(end, begin) - begin)
        unit: Vector = found / np.linalg.norm(found, axis=1, keepdims=True)
        return unit


@dataclass(frozen=True, eq=False)
class Mounted:
    """What readings beside a known motion show of an IMU; deviations are standard deviations.

    Attributes
    ----------
    offset : tuple of float
        Time by which its stamps are late against those of the motion [s].
    orientation : tuple of ndarray
        Quaternion that takes vectors in its axes to the body frame, and deviations of the rotation
        about the axes of the body [rad], shape (3,).
    position : tuple of ndarray
        Place in the body frame [m].
    gyro_bias, gyro_scale, accelerometer_bias, accelerometer_scale : tuple of ndarray
        In its axes [rad/s, -, m/s^2, -].
    noises : ndarray, shape (2,)
        Noise densities of gyro [rad/s/sqrt(Hz)] and accelerometer [m/s^2/sqrt(Hz)].
    count : int
        Number of readings that show these.
    at_rest : bool
        Whether the noises are those at rest; otherwise they include what the motion leaves.
    """

    offset: tuple[float, float]
    orientation: Value
    position: Value
    gyro_bias: Value
    gyro_scale: Value
    accelerometer_bias: Value
    accelerometer_scale: Value
    noises: Vector
    count: int
    at_rest: bool

    def with_scatter(self, others: Sequence["Mounted"], larger: "Mounted") -> "Mounted":
        """Return the mounting, with deviations as large as others show (delete-one jackknife).

        Each of the others is from all data but one of as many parts, and that with a `larger`
        radius, by its deviation, adds to the deviation of the place.
        """
        names = ("position", "gyro_bias", "gyro_scale", "accelerometer_bias",
                 "accelerometer_scale", "offset")
        factor = (len(others) - 1) / math.sqrt(len(others))
        changes: dict[str, Any] = {}
        for name in names:
            value, deviation = getattr(self, name)
            scatter = factor * np.std([getattr(one, name)[0] for one in others], axis=0)
            changes[name] = value, np.maximum(deviation, scatter)
        value, deviation = changes["position"]
        changes["position"] = value, np.hypot(deviation, larger.position[0] - value)
        back = rotation.conjugate(self.orientation[0])
        turns = [rotation.logarithm(rotation.product(one.orientation[0], back)) for one in others]
        scatter = factor * np.std(turns, axis=0)
        changes["orientation"] = self.orientation[0], np.maximum(self.orientation[1], scatter)
        return replace(self, **changes)


def identified_mounting(
    readings: Readings, track: Track, radius: float, margin: float
) -> Mounted:
    """Return how an IMU is mounted in a shell of this radius [m] whose motion is known.

    Stamps may differ by up to `margin` [s]. `InvalidInputError` is raised where the motion does
    not show it.
    """
    period = float(np.median(np.diff(readings.times)))
    part = track.part_at(readings.times, margin + period)
    chosen = np.flatnonzero(part >= 0)
    if chosen.size < _FEWEST:
        raise InvalidInputError(
            "readings of the IMU", Description(f"{chosen.size} beside poses"), f"{_FEWEST} or more"
        )
    times, rates, groups = readings.times[chosen], readings.rates[chosen], part[chosen]
    start = _axes(track.rates_at(times), rates)

    def turn(values: Vector) -> Vector:
        """Return the matrix that takes vectors in the axes of the IMU to the body frame."""
        return rotation.matrix(rotation.exponential(values)) @ start

    def of_gyro(values: Vector) -> Vector:
        seen = track.rates_at(times - np.clip(values[9], -margin, margin)) @ turn(values[:3])
        return np.ravel(seen * (1.0 + values[3:6]) + values[6:9] - rates)

    units = np.array([*(0.1,) * 3, *(0.01,) * 3, *(0.01,) * 3, 0.01])
    gyro, of, _ = fitted(of_gyro, np.zeros(10), units, np.repeat(groups, 3))
    late, axes = float(gyro[9]), turn(gyro[:3])

    forces = Forces(readings, track, part, late, axes)

    def of_accelerometer(values: Vector) -> Vector:
        return forces.left(radius, values[:3], values[3:6], values[6:9])

    units = np.array([*(0.01,) * 3, *(0.01,) * 3, *(0.1,) * 3])
    place, about, left = fitted(
        of_accelerometer, np.zeros(9), units, np.repeat(forces.groups, 3)
    )
    slow = np.linalg.norm(track.rates_at(times - late), axis=1) < _STILL
    resting = chosen[np.convolve(slow, np.ones(_REST), mode="same") > _REST - 0.5]
    at_rest = resting.size >= _FEWEST
    noises: Vector = np.array([
        np.std(of_gyro(gyro)) * math.sqrt(period), left * math.sqrt(period * forces.number)
    ])
    if at_rest:
        # Between neighbours, as tilt and bias differ from rest to rest.
        after = resting[1:][np.diff(resting) == 1]
        noises = np.array([
            np.sqrt(0.5 * period * np.mean((given[after] - given[after - 1]) ** 2))
            for given in (readings.rates, readings.forces)
        ])
    return Mounted(
        (late, float(of[9])), (rotation.from_matrix(axes), of[:3]), (place[:3], about[:3]),
        (gyro[6:9], of[6:9]), (gyro[3:6], of[3:6]), (place[6:9], about[6:9]),
        (place[3:6], about[3:6]), noises, resting.size if at_rest else chosen.size, at_rest,
    )


def _axes(rates: Vector, seen: Vector) -> Vector:
    """Return the axes of an IMU in the body frame, one a column, to begin with.

    `rates` are those of the body, `seen` those of the gyro, shape (N, 3).
    """
    away, other = rates - rates.mean(axis=0), seen - seen.mean(axis=0)
    sizes = np.linalg.svd(away, compute_uv=False)
    if sizes[1] < _ABOUT_ONE_AXIS * sizes[0] or sizes[0] == 0.0:
        raise InvalidInputError(
            "rotation", Description("about one axis"), "about two, which show the axes of the IMU"
        )
    u, common, v = np.linalg.svd(away.T @ other)
    sign = np.sign(np.linalg.det(u @ v))
    found: Vector = u @ np.diag([1.0, 1.0, sign]) @ v
    left = np.linalg.norm(other - away @ found) / np.linalg.norm(other)
    is_mirrored = sign < 0.0 and common[2] > _ABOUT_ONE_AXIS**2 * common[0]
    if left > _UNEXPLAINED or is_mirrored:
        given = "left-handed axes" if is_mirrored else f"{100 * left:.0f} % of it not explained"
        raise InvalidInputError(
            "angular velocity of the IMU", Description(given),
            "that of the shell [rad/s], in any right-handed axes",
        )
    return found


class Forces:
    """Mean specific forces over a few readings each, and those of a motion that is known.

    A force of one reading is a change of velocity over a hundredth of a second, in which the noise
    of the angular velocity is as large as what moves. `part` has the part of the track of each
    reading, -1 outside, `late` is the time by which stamps are late [s], and `axes` takes vectors
    in the axes of the IMU to the body frame.

    Attributes
    ----------
    groups : ndarray of int, shape (N,)
        Part of each mean.
    number : int
        Readings in a mean.
    """

    def __init__(
        self, readings: Readings, track: Track, part: NDArray[np.intp], late: float, axes: Vector
    ) -> None:
        period = float(np.median(np.diff(readings.times)))
        self.number = count = _MEAN_OF
        ends = np.concatenate([
            np.flatnonzero(part == one)[count::count] for one in np.unique(part[part >= 0])
        ])
        span, begins = count * period, ends - count
        whole = np.abs(readings.times[ends] - readings.times[begins] - span) < 0.5 * period
        whole &= part[begins] == part[ends]
        ends, begins = ends[whole], begins[whole]
        self.groups = part[ends]
        # A reading is a mean over the time since the one before it.
        turns = _turns(track, readings.times - late - 0.5 * period)
        world = np.einsum("nij,nj->ni", turns @ axes, readings.forces)
        sums = np.cumsum(world, axis=0)
        middle = _turns(track, readings.times[ends] - late - 0.5 * span) @ axes
        mean = (sums[ends] - sums[begins]) / count
        self._measured = np.einsum("nji,nj->ni", middle, mean)
        self._still = middle.transpose(0, 2, 1) @ (GRAVITY * _UP)
        times = readings.times[ends] - late
        changes = [after - before for before, after in zip(
            _velocities(track, times - span), _velocities(track, times), strict=True
        )]
        self._by_radius = np.einsum("nji,nj->ni", middle, changes[0] / span)
        self._by_place = middle.transpose(0, 2, 1) @ (changes[1] / span)

    def left(self, radius: float, place: Vector, scales: Vector, biases: Vector) -> Vector:
        """Return what is left of the forces, flat.

        They are given by the radius [m], the place of the IMU [m], relative scales and biases
        [m/s^2].
        """
        seen = self._still + radius * self._by_radius
        seen = (seen + np.einsum("nki,i->nk", self._by_place, place)) * (1.0 + scales) + biases
        return np.ravel(seen - self._measured)


def _turns(track: Track, times: Vector) -> Vector:
    """Return the matrices from the body frame to the world at times, shape (N, 3, 3)."""
    return np.moveaxis(rotation.matrix(track.quaternions_at(times).T), -1, 0)


def _velocities(track: Track, times: Vector) -> tuple[Vector, Vector]:
    """Return the velocity of the centre over the radius [1/s], and that of a place by its metres.

    They are in the world, shapes (N, 3) and (N, 3, 3).
    """
    turns, rates = _turns(track, times), track.rates_at(times)
    crossed = np.cross(rates[:, None, :], np.eye(3)[None]).transpose(0, 2, 1)
    return np.cross(np.einsum("nij,nj->ni", turns, rates), _UP), turns @ crossed
