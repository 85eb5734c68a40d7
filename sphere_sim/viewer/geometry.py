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


def octants(radius: float, even: bool) -> Mesh:
    """Return the four octants of a sphere where x y z is positive; if not `even`, the others."""
    meshes = []
    for signs in np.array(np.meshgrid([1, -1], [1, -1], [1, -1])).reshape(3, -1).T:
        is_even = bool(np.prod(signs) > 0)
        if is_even != even:
            continue
        patch = _octant(radius, 12)
        faces = patch.faces if is_even else patch.faces[:, ::-1]
        meshes.append(Mesh((patch.vertices * signs).astype(np.float32), faces))
    return merged(meshes)


def _octant(radius: float, divisions: int) -> Mesh:
    """Return the part of a sphere where no coordinate is negative, by triangles along an edge."""
    points: list[NDArray[np.float64]] = []
    index: dict[tuple[int, int], int] = {}
    for i in range(divisions + 1):
        for j in range(divisions + 1 - i):
            index[i, j] = len(points)
            # Equal steps in angle rather than in coordinates give triangles of similar size.
            point = np.sin(0.5 * np.pi * np.array([i, j, divisions - i - j]) / divisions)
            points.append(radius * point / np.linalg.norm(point))
    faces = []
    for i in range(divisions):
        for j in range(divisions - i):
            faces.append((index[i, j], index[i + 1, j], index[i, j + 1]))
            if j < divisions - i - 1:
                faces.append((index[i + 1, j], index[i + 1, j + 1], index[i, j + 1]))
    return Mesh(np.array(points, dtype=np.float32), np.array(faces, dtype=np.uint32))


def cap(radius: float, axis: int, angle: float) -> Mesh:
    """Return the part of a sphere within `angle` [rad] of a body axis."""
    rings, sides = 4, 32
    turn = np.linspace(0.0, 2.0 * np.pi, sides, endpoint=False)
    points = [np.array([[radius, 0.0, 0.0]])]
    for k in range(1, rings + 1):
        tilt = angle * k / rings
        around = np.stack((np.full(sides, np.cos(tilt)), np.sin(tilt) * np.cos(turn),
                           np.sin(tilt) * np.sin(turn)), axis=1)
        points.append(radius * around)
    faces = [(0, 1 + i, 1 + (i + 1) % sides) for i in range(sides)]
    for k in range(rings - 1):
        a, b = 1 + k * sides, 1 + (k + 1) * sides
        for i in range(sides):
            j = (i + 1) % sides
            faces += [(a + i, b + i, b + j), (a + i, b + j, a + j)]
    return _about(Mesh(np.concatenate(points).astype(np.float32),
                       np.array(faces, dtype=np.uint32)), axis)


def sector(
    radius: float, thickness: float, axis: int, start: float = 0.0, end: float = 2.0 * np.pi
) -> Mesh:
    """Return a disc perpendicular to a body axis, or its sector between two angles [rad]."""
    steps = max(3, round((end - start) / (2.0 * np.pi) * 48))
    turn = np.linspace(start, end, steps + 1)
    rim = radius * np.stack((np.zeros_like(turn), np.cos(turn), np.sin(turn)), axis=1)
    half = np.array([0.5 * thickness, 0.0, 0.0])
    n = len(rim)
    vertices = np.concatenate((rim + half, rim - half, [half, -half]))
    top, bottom = 2 * n, 2 * n + 1
    faces = []
    for i in range(n - 1):
        faces += [(top, i, i + 1), (bottom, n + i + 1, n + i)]
        faces += [(i, n + i, n + i + 1), (i, n + i + 1, i + 1)]
    # The two cut faces; those of a whole disc lie inside it.
    faces += [(top, bottom, n), (top, n, 0), (top, n - 1, 2 * n - 1), (top, 2 * n - 1, bottom)]
    return _about(Mesh(vertices.astype(np.float32), np.array(faces, dtype=np.uint32)), axis)


def _about(mesh: Mesh, axis: int) -> Mesh:
    """Return a mesh about the x axis rotated to be about another axis."""
    # A cyclic permutation of the coordinates keeps the mesh right-handed.
    return Mesh(np.roll(mesh.vertices, axis, axis=1), mesh.faces)


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
