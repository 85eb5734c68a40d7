# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Metrics of a run along a path: deviations from it, and when it has come to its end."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sphere_nmpc.model.state import Vector
from sphere_sim.evaluation.metrics import SETTLED_ERROR, settling_index


@dataclass(frozen=True)
class PathMetrics:
    """Metrics of a run along a path; nan where the run does not determine one.

    They are of the run from when it is first near the start of the path until it stays at its
    end, to `SETTLED_ERROR`, having followed all of it; otherwise until the run is over.

    Attributes
    ----------
    path_rms_m, path_max_m : float
        Root of the mean square of the deviation, over time, and its largest [m].
    path_time_s : float
        How long that lasts [s]; nan where it does not come to its end.
    """

    path_rms_m: float = math.nan
    path_max_m: float = math.nan
    path_time_s: float = math.nan


class Curve:
    """Curve as a polyline, shape (K, 2) [m], of two places or more."""

    def __init__(self, nodes: Vector) -> None:
        self._nodes, self._sides = nodes[:-1], np.diff(nodes, axis=0)
        self._lengths = np.linalg.norm(self._sides, axis=1)
        self._at = np.concatenate(([0.0], np.cumsum(self._lengths)))
        self.length = float(self._at[-1])

    def nearest(self, place: Vector, way: float, reach: float) -> tuple[float, float]:
        """Return distance and length [m] of what is nearest, up to `reach` [m] from a length."""
        first, last = np.searchsorted(self._at[1:-1], (way - reach, way + reach))
        part = slice(first, last + 1)
        sides, lengths = self._sides[part], self._lengths[part]
        away = place - self._nodes[part]
        along = np.sum(away * sides, axis=1) / np.maximum(lengths, 1e-12) ** 2
        along = np.minimum(np.maximum(along, 0.0), 1.0)
        distances = np.hypot(*(away - along[:, None] * sides).T)
        best = int(np.argmin(distances))
        return float(distances[best]), float(self._at[first + best] + along[best] * lengths[best])


def deviations(
    curves: Sequence[Curve], places: Vector, tolerance: float, reach: float
) -> tuple[Vector, Vector]:
    """Return distances from curves that are followed in order, and the lengths followed [m].

    Both are of all places, shape (N, 2) [m], and of the part of the curves that is up to `reach`
    [m] away from the place before, so that other parts that come near do not count. A curve is
    left, within the tolerance [m] of its end, when the next one is as near.
    """
    index, way, before = 0, 0.0, 0.0
    found = []
    for place in places:
        curve = curves[index]
        away, way = curve.nearest(place, way, reach)
        if index + 1 < len(curves) and way > curve.length - tolerance:
            other = curves[index + 1].nearest(place, 0.0, reach)
            if other[0] <= away:
                index, before = index + 1, before + curve.length
                away, way = other
        found.append((away, before + way))
    distances, ways = np.array(found).T
    return distances, ways


def measure_along(
    times: Vector, places: Vector, curves: Sequence[Vector], tolerance: float, radius: float
) -> PathMetrics:
    """Return the metrics of a run, places (N, 2) [m] at times [s], along curves, (K, 2) each [m].

    `tolerance` is that of the path, `radius` that of the sphere [m].
    """
    near = np.flatnonzero(np.hypot(*(places - curves[0][0]).T) <= tolerance)
    if not near.size:
        return PathMetrics()
    times, places = times[near[0] :] - times[near[0]], places[near[0] :]
    followed = [Curve(nodes) for nodes in curves]
    # Half a radius: far more than it rolls from one sample to the next.
    away, ways = deviations(followed, places, tolerance, 0.5 * radius)
    length = sum(curve.length for curve in followed)
    end, time = len(places), math.nan
    stays = settling_index(np.hypot(*(places - curves[-1][-1]).T))
    if stays is not None and ways[-1] > length - SETTLED_ERROR:
        end = max(stays, int(np.argmax(ways > length - SETTLED_ERROR)))
        time = float(times[end])
    away = away[: end + 1]
    return PathMetrics(float(np.sqrt(np.mean(away**2))), float(np.max(away)), time)
