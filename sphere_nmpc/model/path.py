# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Paths of the centre: smooth curves through places, by arc length.

A polyline is passed with rounded corners: between its sides, of which it takes up to a half, a
corner is replaced by a parabola that stays within a share of the tolerance. Through places that
lie close, as on a sampled curve, the parabolas join to a quadratic spline. A mean over a short
length then makes the curvature continuous.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sphere_nmpc.errors import InvalidStateError
from sphere_nmpc.model.state import Vector

_SPACING = 1.0 / 60.0
"""Spacing of the curve [Rs]."""
_MAX_SPACING_RATIO = 0.25
"""The same over the tolerance at most: the mean cuts a corner by up to 2.3 times the spacing."""
_HALF_WINDOW = 4
"""Places of the curve over which its mean is taken, to either side."""
_CORNER_SHARE = 0.4
"""Share of the tolerance by which a corner is cut: the rest is for what follows the path."""
_CUSP = math.radians(135.0)
"""Turn [rad] from which on a corner is the end of one path and the start of another: a sphere that
goes back rests in between."""
_MAX_PLACES = 500_000
"""Places of a curve at most: 2.5 km for Table 1 and a tolerance of 2 cm."""


@dataclass(frozen=True)
class Tracking:
    """How a path is followed at an instant.

    Attributes
    ----------
    way : float
        Length of the path up to the place that is nearest [m].
    way_left : float
        Length from there on [m].
    deviation : float
        Distance of the centre from it [m], positive to its left.
    heading_error : float
        Planned direction of the velocity from that of the path [rad]; nan without a plan.
    speed : float
        Planned speed of the centre [m/s]; nan without a plan.
    """

    way: float
    way_left: float
    deviation: float
    heading_error: float
    speed: float


@dataclass(frozen=True, eq=False)
class Path:
    """Curve of the centre.

    Attributes
    ----------
    curve : ndarray, shape (K, 4)
        x, y [m], direction [rad; not wrapped] and curvature [1/m] at equal lengths.
    spacing : float
        These lengths [m].
    tolerance : float
        Largest distance from the given places' polyline that is allowed [m].
    """

    curve: Vector
    spacing: float
    tolerance: float

    @classmethod
    def through(cls, places: Vector, tolerance: float, radius: float) -> "tuple[Path, ...]":
        """Return the paths through places, one after the other: the sphere rests between them.

        There is none where all places are the same.

        Parameters
        ----------
        places : ndarray, shape (P, 2)
            Places [m]; those that are the same as the one before count once.
        tolerance : float
            Largest distance from their polyline [m].
        radius : float
            Radius of the sphere [m], the unit of length.

        Raises
        ------
        InvalidStateError
            If it is too long.
        """
        spacing = min(_SPACING * radius, _MAX_SPACING_RATIO * tolerance)
        return tuple(
            cls(*_curve_of(part, spacing, tolerance), tolerance)
            for part in _without_cusps(places, 1e-3 * spacing)
        )

    def __post_init__(self) -> None:
        self.curve.flags.writeable = False

    @cached_property
    def places(self) -> Vector:
        """The places of the curve, shape (K, 2) [m]."""
        return self.curve[:, :2]

    @cached_property
    def length(self) -> float:
        """Length of the path [m]."""
        return self.spacing * (len(self.curve) - 1)

    def at(self, way: float) -> Vector:
        """Return x, y [m], direction [rad] and curvature [1/m] at a length [m]; shape (4,)."""
        share = min(max(way / self.spacing, 0.0), len(self.curve) - 1.0)
        index = min(int(share), len(self.curve) - 2)
        rest = share - index
        found: Vector = (1.0 - rest) * self.curve[index] + rest * self.curve[index + 1]
        return found

    def nearest(self, place: Vector, first: float, last: float) -> float:
        """Return the length [m], of those from `first` to `last`, at which it is nearest."""
        low = min(max(int(first / self.spacing), 0), len(self.curve) - 2)
        high = max(low + 2, math.ceil(last / self.spacing) + 1)
        nodes = self.places[low:high]
        sides = np.diff(nodes, axis=0)
        shares = np.sum((place - nodes[:-1]) * sides, axis=1) / np.sum(sides * sides, axis=1)
        shares = np.clip(shares, 0.0, 1.0)
        away = np.linalg.norm(nodes[:-1] + shares[:, None] * sides - place, axis=1)
        best = int(np.argmin(away))
        return self.spacing * (low + best + float(shares[best]))

    def equals(self, other: "Path | None") -> bool:
        """Return whether it is the same path."""
        return other is not None and np.array_equal(self.curve, other.curve)


def _without_cusps(places: Vector, least: float) -> Iterator[Vector]:
    """Yield parts of a polyline, shape (P, 2), that begin where it goes back, without repetition.

    Places nearer than `least` [m] to the one before are left out, but the last one.
    """
    kept = [places[0]]
    for place in places[1:]:
        if float(np.linalg.norm(place - kept[-1])) > least:
            kept.append(place)
    nodes, begin = np.array(kept), 0
    sides = np.diff(nodes, axis=0)
    for k in range(1, len(sides)):
        a, b = sides[k - 1], sides[k]
        turn = math.atan2(float(a[0] * b[1] - a[1] * b[0]), float(a @ b))
        if abs(turn) >= _CUSP:
            yield nodes[begin : k + 1]
            begin = k
    if len(sides):
        yield nodes[begin:]


def _curve_of(nodes: Vector, spacing: float, tolerance: float) -> tuple[Vector, float]:
    """Return the curve through the nodes of a polyline, (P, 2), and its spacing; see `Path`."""
    sides = np.diff(nodes, axis=0)
    lengths = np.linalg.norm(sides, axis=1)
    total = float(np.sum(lengths))
    if not total < _MAX_PLACES * spacing:
        raise InvalidStateError("length of the path", total, f"at most {_MAX_PLACES * spacing:g}")
    ahead = sides / lengths[:, None]
    pieces = [nodes[:1]]
    for k in range(1, len(nodes) - 1):
        bend = 0.5 * float(np.linalg.norm(ahead[k] - ahead[k - 1]))
        # The middle of the parabola is half of the reach times the sine of half the turn away.
        cut = 2.0 * _CORNER_SHARE * tolerance / max(bend, 1e-9)
        reach = min(0.5 * lengths[k - 1], 0.5 * lengths[k], cut)
        along = np.linspace(0.0, 1.0, max(3, math.ceil(4.0 * reach / spacing)))[:, None]
        begin, end = nodes[k] - reach * ahead[k - 1], nodes[k] + reach * ahead[k]
        pieces.append(
            (1.0 - along) ** 2 * begin + 2.0 * along * (1.0 - along) * nodes[k] + along**2 * end
        )
    pieces.append(nodes[-1:])
    fine = _by_length(np.vstack(pieces), spacing)
    places = _by_length(_mean(fine), spacing)
    direction = np.unwrap(np.arctan2(*np.gradient(places, axis=0).T[::-1]))
    step = float(np.linalg.norm(places[1] - places[0]))
    return np.column_stack((places, direction, np.gradient(direction, step))), step


def _by_length(nodes: Vector, spacing: float) -> Vector:
    """Return places of a polyline at equal lengths, about a spacing [m], from end to end."""
    at = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(nodes, axis=0), axis=1))))
    count = max(3, round(float(at[-1]) / spacing) + 1)
    along = np.linspace(0.0, at[-1], count)
    return np.column_stack([np.interp(along, at, nodes[:, axis]) for axis in (0, 1)])


def _mean(places: Vector) -> Vector:
    """Return running means of places, (K, 2): both ends, and straight lines, stay as they are."""
    reach = min(_HALF_WINDOW, len(places) - 1)
    before = 2.0 * places[0] - places[reach:0:-1]
    after = 2.0 * places[-1] - places[-2 : -2 - reach : -1]
    sums = np.cumsum(np.vstack((np.zeros((1, 2)), before, places, after)), axis=0)
    width = 2 * reach + 1
    found: Vector = (sums[width:] - sums[:-width]) / width
    return found
