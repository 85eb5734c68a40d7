# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Routes: shortest ways to a goal on a floor, and what is in sight there.

Nodes are corners of the floor's cells. One counts as free where the distance there misses what is
needed by no more than half the diagonal of four nodes: a path with enough clearance passes near
free nodes alone, so that a place without a way is not connected to the goal. Whether the sphere
gets through where nodes lack clearance is not sure, and such a way is a last resort.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sphere_nmpc.floor.floor import MOST_FINE, Floor, finest_cell, kept_with_floor
from sphere_nmpc.floor.occupancy import Grid
from sphere_nmpc.model.state import Vector
from sphere_nmpc.solver.native.library import library

_SPACING = 2.0 * finest_cell(1.0)
"""Spacing of the nodes [Rs], unless there would be more than `_MOST_NODES`."""
_MOST_NODES = MOST_FINE * (finest_cell(1.0) / _SPACING) ** 2
"""Nodes on a floor at most: those of one of `MOST_FINE` cells."""
_ROOM_WITHOUT_COST = 0.5
"""Clearance beyond the needed one [Rs] below which a unit of the way costs more."""
_NARROW_COST = 1.0
"""Share by which a unit of the way costs more where there is no more than the needed clearance:
the sphere needs longer there."""
_MIN_SURE_ROOM = 0.015
"""Clearance beyond the needed one [Rs] without which it is not sure that the sphere gets
through."""
_UNSURE_COST = 40.0
"""Cost of a unit of the way where it is not sure that the sphere gets through [-]: another way is
taken, unless it is that much longer."""
_STEPS = ((0, 1), (1, 0), (1, 1), (1, -1), (1, 2), (1, -2), (2, 1), (2, -1))
"""Half of the neighbours of a node; the others are opposite."""
_MAX_WAYS = 2
"""Goals whose ways are kept."""


@dataclass(frozen=True, eq=False)
class Route:
    """Shortest ways to a goal from everywhere on a floor.

    Attributes
    ----------
    grid : Grid
        Cells of the floor, which is not referred to, as it keeps the ways.
    stride : int
        Spacing of the nodes [cells].
    lengths : ndarray of float32, shape (R, C)
        Lengths of the ways from the nodes [m, those in narrow places longer]; infinite where there
        is none.
    following : ndarray of int32, shape (R, C)
        Index of the next node on each way.
    goal : ndarray, shape (2,)
        The goal [m].
    """

    grid: Grid
    stride: int
    lengths: NDArray[np.float32]
    following: NDArray[np.int32]
    goal: Vector

    def length(self, place: Vector) -> float:
        """Return the length of the way from a place [m], infinite where there is none."""
        node = self._nearest(place)
        if node is None:
            return float("inf")
        away = float(np.linalg.norm(self._places(np.array([node]))[0] - place))
        return float(self.lengths.flat[node]) + away

    def path(self, place: Vector) -> Vector:
        """Return the way from a place to the goal, shape (K, 2) [m]; empty where there is none."""
        node = self._nearest(place)
        if node is None:
            return np.empty((0, 2))
        nodes, following = [node], self.following.ravel()
        while following[nodes[-1]] != nodes[-1]:
            nodes.append(int(following[nodes[-1]]))
        places = self._places(np.array(nodes))
        places[-1] = self.goal
        return places

    def _places(self, nodes: NDArray[np.intp]) -> Vector:
        rows, columns = np.divmod(nodes, self.lengths.shape[1])
        return self.grid.world(self.stride * np.column_stack((columns, rows)).astype(float))

    def _nearest(self, place: Vector) -> int | None:
        """Return the node near a place from which the way is shortest."""
        column, row = np.rint(self.grid.local(place) / self.stride).astype(int)
        columns = self.lengths.shape[1]
        near = slice(max(0, row - 2), row + 3), slice(max(0, column - 2), column + 3)
        block = self.lengths[near]
        if block.size == 0 or not np.isfinite(block).any():
            return None
        i, j = np.unravel_index(int(np.argmin(block)), block.shape)
        return int((near[0].start + i) * columns + near[1].start + j)


class StraightRoute:
    """Ways to a goal, shape (2,) [m], where nothing stands: straight lines."""

    def __init__(self, goal: Vector) -> None:
        self.goal = goal

    def length(self, place: Vector) -> float:
        """Return the length of the way from a place [m]."""
        return float(np.linalg.norm(self.goal - place))

    def path(self, place: Vector) -> Vector:
        """Return the way from a place to the goal, shape (2, 2) [m]."""
        return np.array((place, self.goal))


def route_to(floor: Floor, goal: Vector, needed: float = 0.0) -> Route | StraightRoute:
    """Return the ways to a goal, shape (2,) [m]; the newest ones are kept with the floor.

    `needed` is the distance that the sphere's centre keeps [m], which is rounded down to cells
    beyond that of the floor, as it varies where a radius is learnt.
    """
    if floor.is_empty:
        return StraightRoute(goal)
    side = floor.fine.resolution
    cells = max(0, int((needed - floor.needed) / side))
    return _route_to(floor, *goal.tolist(), floor.needed + side * cells)


@kept_with_floor(_MAX_WAYS)
def _route_to(floor: Floor, x: float, y: float, needed: float) -> Route:
    goal: Vector = np.array((x, y))
    fine = floor.fine
    stride = max(1, int(_SPACING * floor.radius / fine.resolution + 1e-6))
    while floor.corner_distances.size > _MOST_NODES * stride**2:
        stride += 1
    distances = floor.corner_distances[::stride, ::stride]
    spacing = stride * fine.resolution
    room = (distances - needed) / (_ROOM_WITHOUT_COST * floor.radius)
    cost = spacing * (1.0 + _NARROW_COST * np.clip(1.0 - room, 0.0, 1.0)).astype(np.float32)
    cost[distances < needed + _MIN_SURE_ROOM * floor.radius] *= _UNSURE_COST
    cost[distances < needed - np.sqrt(0.5) * spacing] = np.inf
    rows, columns = cost.shape
    column, row = np.rint(fine.local(goal) / stride).astype(int)
    lengths = np.full(cost.shape, np.inf, dtype=np.float32)
    following = np.full(cost.shape, -1, dtype=np.int32)
    if 0 <= row < rows and 0 <= column < columns:
        near = slice(max(0, row - 1), row + 2), slice(max(0, column - 1), column + 2)
        i, j = np.unravel_index(int(np.argmin(cost[near])), cost[near].shape)
        node = int((near[0].start + i) * columns + near[1].start + j)
        if np.isfinite(cost.flat[node]):
            find_routes(cost, node, lengths, following)
    return Route(fine, stride, lengths, following, goal)


def find_routes(
    cost: NDArray[np.float32], goal: int, lengths: NDArray[np.float32],
    following: NDArray[np.int32],
) -> None:
    """Fill in the lengths of the ways to a node, and the next node on each.

    `cost` is that of a unit of the way at each node, infinite at one that must not be passed.
    """
    solver = library()
    if solver is None:
        plain_routes(cost, goal, lengths, following)
        return
    cost = np.ascontiguousarray(cost, dtype=np.float32)
    heap, place = np.empty(cost.size, np.int32), np.full(cost.size, -1, np.int32)
    arrays = (cost, lengths, following, heap, place)
    solver.hold_way(*cost.shape, goal, *(array.ctypes.data for array in arrays))


def plain_routes(
    cost: NDArray[np.float32], goal: int, lengths: NDArray[np.float32],
    following: NDArray[np.int32],
) -> None:
    """Do what `find_routes` does, by SciPy."""
    from scipy import sparse  # only where the compiled library is missing
    from scipy.sparse import csgraph

    index = np.arange(cost.size).reshape(cost.shape)
    rows, columns = cost.shape
    ends, weights = [], []
    for di, dj in _STEPS:
        a = (slice(0, rows - di), slice(max(0, -dj), columns - max(0, dj)))
        b = (slice(di, rows), slice(max(0, dj), columns - max(0, -dj)))
        mean = 0.5 * np.hypot(di, dj) * (cost[a] + cost[b])
        free = np.isfinite(mean)
        ends.append(np.stack((index[a][free], index[b][free])))
        weights.append(mean[free])
    first, second = np.concatenate(ends, axis=1)
    graph = sparse.csr_array(
        (np.concatenate(weights), (first, second)), shape=(cost.size, cost.size)
    )
    found, before = csgraph.dijkstra(graph, False, goal, return_predecessors=True)
    lengths.ravel()[:] = found
    following.ravel()[:] = np.where(before < 0, -1, before)
    following.ravel()[goal] = goal


def in_sight(floor: Floor, place: Vector, targets: Vector, needed: float) -> NDArray[np.bool_]:
    """Return whether the straight ways to targets, shape (K, 2), keep a distance [m], (K,)."""
    if floor.is_empty:
        return np.ones(len(targets), dtype=np.bool_)
    step = 2.0 * floor.fine.resolution
    ways = targets - place
    longest = float(np.max(np.linalg.norm(ways, axis=1), initial=0.0))
    shares = np.linspace(0.0, 1.0, max(2, int(longest / step) + 1))
    places = place + shares[None, :, None] * ways[:, None, :]
    distances = floor.distances(places.reshape(-1, 2)).reshape(places.shape[:2])
    # Where the sphere is now it may be too near.
    wanted = np.minimum(needed, np.maximum.accumulate(distances, axis=1) - 1e-3)
    found: NDArray[np.bool_] = np.all(distances >= wanted, axis=1)
    return found
