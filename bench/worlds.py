# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Random worlds with walls, doorways, discs, mazes, traps and corridors, and a judge of paths.

The judge knows the world's rectangles and discs, not the map that is made of them, and integrates
the equations of motion by itself: the constraint of rolling and the conserved angular momentum
about the contact point, solved at each evaluation, by the classical Runge-Kutta method.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from sphere_nmpc.floor.floor import Floor
from sphere_nmpc.floor.occupancy import Grid
from sphere_nmpc.floor.route import route_to
from sphere_nmpc.model.parameters import LumpedConstants, RobotParameters
from sphere_nmpc.model.rotation import random_quaternion
from sphere_nmpc.model.state import POSITION, Vector

KINDS = ("discs", "rooms", "doors", "maze", "trap", "corridor")
SPEED = 0.742
"""Greatest speed of steady rolling [m/s]."""
SIDE = 10.0
"""Side of a world [m]."""
_CELL = 0.05
_WALL = 0.1
"""Thickness of walls [m]."""
_RADIUS = RobotParameters().shell_radius


@dataclass
class World:
    """World of a kind.

    Attributes
    ----------
    kind : str
        One of `KINDS`.
    walls : list of tuple
        Rectangles (x0, y0, x1, y1) [m].
    discs : list of tuple
        Discs (x, y, radius) [m].
    gap : float
        Least width of its doorways beyond the diameter of the sphere [m]; nan where it has none.
    """

    kind: str
    walls: list[tuple[float, float, float, float]] = field(default_factory=list)
    discs: list[tuple[float, float, float]] = field(default_factory=list)
    gap: float = math.nan

    def distances(self, places: Vector) -> Vector:
        """Return the exact distances of places, (P, 2), to walls, discs and the edge [m]."""
        x, y = places[:, 0], places[:, 1]
        least = np.minimum(np.minimum(x, SIDE - x), np.minimum(y, SIDE - y))
        for x0, y0, x1, y1 in self.walls:
            dx = np.maximum(np.maximum(x0 - x, x - x1), 0.0)
            dy = np.maximum(np.maximum(y0 - y, y - y1), 0.0)
            least = np.minimum(least, np.hypot(dx, dy))
        for cx, cy, radius in self.discs:
            least = np.minimum(least, np.hypot(x - cx, y - cy) - radius)
        return least

    def grid(self) -> Grid:
        """Return the map: each cell occupied that a wall or a disc touches."""
        count = round(SIDE / _CELL)
        occupied = np.zeros((count, count), dtype=bool)
        low = _CELL * np.arange(count)
        for x0, y0, x1, y1 in self.walls:
            columns = (low + _CELL > x0 + 1e-9) & (low < x1 - 1e-9)
            rows = (low + _CELL > y0 + 1e-9) & (low < y1 - 1e-9)
            occupied |= rows[:, None] & columns[None, :]
        for cx, cy, radius in self.discs:
            dx = np.maximum(np.maximum(low - cx, cx - low - _CELL), 0.0)
            dy = np.maximum(np.maximum(low - cy, cy - low - _CELL), 0.0)
            occupied |= np.hypot(dx[None, :], dy[:, None]) <= radius
        return Grid(occupied, _CELL)


def draw_world(kind: str, rng: np.random.Generator, gap: float | None = None) -> World:
    """Draw a world; with `gap` [m] all its doorways are that much wider than the sphere."""
    world = World(kind)
    if kind == "discs":
        _draw_discs(world, rng)
    elif kind in ("rooms", "doors"):
        _draw_rooms(world, rng, (0.5, 1.2) if kind == "rooms" else (0.1, 0.3), gap)
    elif kind == "maze":
        _draw_maze(world, rng, gap)
    elif kind == "trap":
        _draw_trap(world, rng)
    else:
        _draw_corridor(world, rng, gap)
    return world


def _draw_discs(world: World, rng: np.random.Generator) -> None:
    share, covered = rng.uniform(0.1, 0.3), 0.0
    while True:
        radius = rng.uniform(0.15, 0.6)
        x, y = rng.uniform(0.0, SIDE, 2)
        covered += math.pi * radius**2
        if covered > share * SIDE**2:
            return
        world.discs.append((float(x), float(y), radius))


def _draw_rooms(
    world: World, rng: np.random.Generator, range_of_gaps: tuple[float, float],
    given: float | None,
) -> None:
    """Nine rooms with a doorway in each wall."""
    world.gap = math.inf
    for at in (SIDE / 3.0, 2.0 * SIDE / 3.0):
        for level in range(3):
            low, high = level * SIDE / 3.0, (level + 1) * SIDE / 3.0
            for is_vertical in (True, False):
                gap = max(_on_grid(rng.uniform(*range_of_gaps)), 2 * _CELL)
                gap = gap if given is None else given
                world.gap = min(world.gap, gap)
                width = 2.0 * _RADIUS + gap
                door = _on_grid(rng.uniform(low + 0.3, high - 0.3 - width))
                for begin, end in ((_on_grid(low), door), (door + width, _on_grid(high))):
                    flat = (_on_grid(at), begin, _on_grid(at) + _WALL, end)
                    world.walls.append(
                        flat if is_vertical else (begin, flat[0], end, flat[2])
                    )


def _draw_maze(world: World, rng: np.random.Generator, given: float | None) -> None:
    """Lanes from side to side, one into the next at their ends."""
    lanes, world.gap = 6, math.inf
    for lane in range(1, lanes):
        at = _on_grid(lane * SIDE / lanes)
        gap = max(_on_grid(rng.uniform(0.15, 0.5)), 2 * _CELL) if given is None else given
        world.gap = min(world.gap, gap)
        width = 2.0 * _RADIUS + gap
        is_right = rng.random() < 0.5 if rng.random() < 0.3 else bool(lane % 2)
        x0, x1 = (0.0, SIDE - width) if is_right else (width, SIDE)
        world.walls.append((x0, at, x1, at + _WALL))


def _draw_trap(world: World, rng: np.random.Generator) -> None:
    """Three walls around the start, open on the side away from the goal."""
    x, y, depth = 5.0, _on_grid(rng.uniform(3.0, 5.0)), 2.0
    width = _on_grid(rng.uniform(2.0, 4.0))
    world.walls += [
        (x, y, x + _WALL, y + width), (x - depth, y, x, y + _WALL),
        (x - depth, y + width, x + _WALL, y + width + _WALL),
    ]


def _draw_corridor(world: World, rng: np.random.Generator, given: float | None) -> None:
    """A room, a corridor with a right angle in it, and another room."""
    world.gap = max(_on_grid(rng.uniform(0.1, 0.3)), 2 * _CELL) if given is None else given
    width, along = 2.0 * _RADIUS + world.gap, _on_grid(rng.uniform(2.0, 4.0))
    x, y = 6.0, 3.0 + width
    world.walls += [
        # Below and beside the corridor, which leads to the right and then up.
        (3.0, 0.0, SIDE, 3.0), (x + width, 3.0, SIDE, y + along), (3.0, y, x, y + along),
        # The room of the start is on the left, that of the goal above.
        (3.0, y + along, 3.1, SIDE),
    ]


def _on_grid(value: float) -> float:
    return _CELL * round(value / _CELL)


def draw_task(
    world: World, floor: Floor, rng: np.random.Generator
) -> tuple[Vector, Vector, float]:
    """Draw a start and a connected goal, states of shape (6,), and the length of the way [m]."""
    while True:
        places = rng.uniform(0.0, SIDE, (2, 2))
        if world.kind == "corridor":
            places[:] = (1.0, rng.uniform(1.0, 9.0)), (rng.uniform(4.0, 9.0), 9.2)
        if world.kind == "trap":
            places[0] = (4.3, world.walls[0][1] + 1.0)
            places[1] = (rng.uniform(6.0, 9.0), rng.uniform(2.0, 8.0))
        length = way_length(floor, *places)
        if length is not None:
            start, goal = (np.concatenate((place, random_quaternion(rng))) for place in places)
            return start, goal, length


def draw_poses(
    world: World, floor: Floor, rng: np.random.Generator, count: int
) -> list[Vector]:
    """Draw two or more states, shape (6,), each connected with the one before."""
    poses = list(draw_task(world, floor, rng)[:2])
    while len(poses) < count:
        place = rng.uniform(0.0, SIDE, 2)
        if way_length(floor, poses[-1][POSITION], place) is not None:
            poses.append(np.concatenate((place, random_quaternion(rng))))
    return poses


def longest_run(length: float) -> float:
    """Return the time that a run over a way [m] lasts [s], which is ample."""
    return 10.0 + 3.0 * length / SPEED


def way_length(floor: Floor, start: Vector, goal: Vector) -> float | None:
    """Return the length of the way between places, (2,) [m]; None if near or not connected."""
    far = np.linalg.norm(goal - start) > 2.0
    if not far or np.any(floor.distances(np.stack((start, goal))) < floor.needed):
        return None
    path = route_to(floor, goal).path(start)
    if not len(path) or floor.distances(path).min() < floor.needed + 0.012:
        return None
    return float(np.sum(np.linalg.norm(np.diff(_pulled(floor, path), axis=0), axis=1)))


def _pulled(floor: Floor, path: Vector) -> Vector:
    """Return a path pulled straight where that keeps the needed distance."""
    corners, at = [0], 0
    while at < len(path) - 1:
        for then in range(len(path) - 1, at, -1):
            count = max(2, int(np.linalg.norm(path[then] - path[at]) / 0.02))
            between = np.linspace(path[at], path[then], count)
            if then == at + 1 or floor.distances(between).min() >= floor.needed:
                break
        at = then
        corners.append(at)
    return path[corners]


def integrated(
    start: Vector, times: Vector, speeds: Vector, constants: LumpedConstants
) -> Vector:
    """Return the places at given times, shape (K, 2) [m], by the judge's own integration.

    `speeds` are those of the rotors at the times, shape (K, 2) [rad/s], linear between them.
    """
    radius, gain, transverse, axial = constants.as_array()
    state, found = start.astype(float).copy(), [start[:2]]
    for k, step in enumerate(np.diff(times)):
        a, b = speeds[k], speeds[k + 1]

        def rate(x: Vector, u: Vector) -> Vector:
            w, i, j, k = x[2:6] / math.sqrt(float(x[2:6] @ x[2:6]))
            turn = np.array([
                [1 - 2 * (j * j + k * k), 2 * (i * j - w * k), 2 * (i * k + w * j)],
                [2 * (i * j + w * k), 1 - 2 * (i * i + k * k), 2 * (j * k - w * i)],
                [2 * (i * k - w * j), 2 * (j * k + w * i), 1 - 2 * (i * i + j * j)],
            ])
            # Inertia about the contact point over that of the shell's equator and the mass.
            inertia = np.eye(3) + (transverse / axial - 1.0) * np.outer(turn[:, 2], turn[:, 2])
            inertia[2, 2] -= transverse
            omega = np.linalg.solve(inertia, -gain * (turn[:, 0] * u[0] + turn[:, 1] * u[1]))
            p, q, r = omega
            return np.array([
                radius * q, -radius * p,
                0.5 * (-p * i - q * j - r * k), 0.5 * (p * w + q * k - r * j),
                0.5 * (q * w + r * i - p * k), 0.5 * (r * w + p * j - q * i),
            ])

        middle = 0.5 * (a + b)
        first = rate(state, a)
        second = rate(state + 0.5 * step * first, middle)
        third = rate(state + 0.5 * step * second, middle)
        fourth = rate(state + step * third, b)
        state = state + step / 6.0 * (first + 2.0 * (second + third) + fourth)
        found.append(state[:2].copy())
    return np.array(found)
