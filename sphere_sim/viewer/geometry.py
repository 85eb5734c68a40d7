# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Meshes and curves of the scene as arrays; lengths in m, body frame unless stated."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sphere_nmpc.model.state import Vector


class Mesh(NamedTuple):
    """Vertices (n, 3) [m] and triangles (m, 3), anticlockwise as seen from outside."""

    vertices: NDArray[np.float32]
    faces: NDArray[np.uint32]


def revolved(
    profile: Vector, axis: int, start: float = 0.0, end: float = 2.0 * np.pi, steps: int = 48
) -> Mesh:
    """Return the surface that a line sweeps about a body axis between two angles [rad].

    The line has places along the axis and distances from it, shape (n, 2) [m], in the order in
    which places fall where the surface faces away from the axis.
    """
    turn, (along, radius) = np.linspace(start, end, steps + 1), profile.T
    points = np.stack((np.tile(along, (steps + 1, 1)), np.outer(np.cos(turn), radius),
                       np.outer(np.sin(turn), radius)), axis=-1)
    corner = np.arange(points[..., 0].size, dtype=np.uint32).reshape(steps + 1, -1)
    a, b, c, d = (it.ravel() for it in (corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:],
                                        corner[1:, :-1]))
    faces = np.concatenate((np.stack((a, b, c), axis=1), np.stack((a, c, d), axis=1)))
    # A cyclic permutation of the coordinates keeps the mesh right-handed.
    return Mesh(np.roll(points.reshape(-1, 3), axis, axis=1).astype(np.float32), faces)


def _meridian(radius: float, start: float, end: float, steps: int) -> Vector:
    """Return an arc between two angles from the axis [rad], as a line for `revolved`."""
    tilt = np.linspace(start, end, steps + 1)
    return radius * np.stack((np.cos(tilt), np.sin(tilt)), axis=1)


def octants(radius: float, even: bool) -> Mesh:
    """Return the four octants of a sphere where x y z is positive; if not `even`, the others."""
    quarter = 0.5 * np.pi
    return merged([
        revolved(_meridian(radius, lower * quarter, (lower + 1) * quarter, 12), 2,
                 k * quarter, (k + 1) * quarter, 12)
        for lower in range(2) for k in range(4) if ((lower + k) % 2 == 0) == even
    ])


def cap(radius: float, axis: int, angle: float) -> Mesh:
    """Return the part of a sphere within `angle` [rad] of a body axis."""
    return revolved(_meridian(radius, 0.0, angle, 4), axis)


def sector(
    radius: float, thickness: float, axis: int, start: float = 0.0, end: float = 2.0 * np.pi
) -> Mesh:
    """Return a disc perpendicular to a body axis, or its sector between two angles [rad]."""
    half = 0.5 * thickness
    profile = np.array([[half, 0.0], [half, radius], [-half, radius], [-half, 0.0]])
    swept = revolved(profile, axis, start, end)
    last = len(swept.vertices) - 4
    # The two cut faces; those of a whole disc lie inside it.
    cuts = np.array([[0, 2, 1], [0, 3, 2], [last, last + 1, last + 2], [last, last + 2, last + 3]])
    return Mesh(swept.vertices, np.concatenate((swept.faces, cuts.astype(np.uint32))))


def merged(meshes: list[Mesh]) -> Mesh:
    """Return several meshes as one mesh."""
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = [mesh.faces + np.uint32(start) for mesh, start in zip(meshes, starts, strict=False)]
    return Mesh(np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(faces))


def great_circle(radius: float) -> Vector:
    """Return the closed circle z = 0, shape (97, 3); on the shell it is Gamma."""
    turn = np.linspace(0.0, 2.0 * np.pi, 97)
    return radius * np.stack((np.cos(turn), np.sin(turn), np.zeros_like(turn)), axis=1)


def segments(points: Vector) -> NDArray[np.float32]:
    """Return the segments of a line through points (n, 3), shape (n - 1, 2, 3)."""
    return np.stack((points[:-1], points[1:]), axis=1).astype(np.float32)


def arc(start: Vector, end: Vector, step: float) -> Vector:
    """Return the shortest arc between points of a sphere about the origin, shape (n, 3).

    It is without its start, and its points are at most `step` apart [m].
    """
    number = max(1, int(np.ceil(np.linalg.norm(end - start) / step)))
    share = np.linspace(0.0, 1.0, number + 1)[1:, None]
    chord = (1.0 - share) * start + share * end
    lengths = np.maximum(np.linalg.norm(chord, axis=1, keepdims=True), 1e-12)
    return np.asarray(chord * (np.linalg.norm(end) / lengths))


def without_repeats(points: Vector, distance: float) -> Vector:
    """Return points (n, d) without those within `distance` [m] of the one kept before."""
    kept: list[Vector] = []
    for point in points:
        if not kept or float(np.linalg.norm(point - kept[-1])) > distance:
            kept.append(point)
    return np.array(kept).reshape(-1, points.shape[1])
