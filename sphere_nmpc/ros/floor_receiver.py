# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The floor of a node, from its parameters and the topics ``map`` and ``keepout``."""

import os
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np
from geometry_msgs.msg import PolygonInstanceStamped
from nav_msgs.msg import OccupancyGrid
from rcl_interfaces.msg import SetParametersResult
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile

from sphere_nmpc.errors import SphereNmpcError
from sphere_nmpc.fault_log import FaultLog
from sphere_nmpc.floor.floor import Floor
from sphere_nmpc.floor.layers import Layers
from sphere_nmpc.floor.map_file import read_map
from sphere_nmpc.floor.occupancy import Grid, InvalidMapError
from sphere_nmpc.floor.settings import FloorSettings, OccupancySettings
from sphere_nmpc.model.state import Vector
from sphere_nmpc.ros.floor_messages import (
    CellsOf,
    floor_message,
    keepout_of_message,
    map_of_message,
)
from sphere_nmpc.ros.graph_monitor import NO_EVENTS
from sphere_nmpc.ros.guarded_node import LATCHED, GuardedNode

_KEEPOUTS = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""Of areas to keep out of, each of which is a message that a later subscriber needs, too."""
_LOOK_EVERY = 0.02
"""Wall time between two looks for a floor that is being made [s]."""
_STAYS = "the floor in force stays"

S = TypeVar("S", bound=OccupancySettings)
T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class _Given(Generic[S]):
    """What a floor is put together from, as it was given last."""

    settings: S
    cells_of: CellsOf | None
    """The map; None where there is none."""
    keepouts: Mapping[int, Vector] = field(default_factory=dict)
    """Corners of the areas to keep out of, each of shape (K, 2) [m], by their ids."""

    def layers(self) -> Layers:
        """Return the layers of the floor."""
        settings, cells = self.settings, None
        if self.cells_of is not None:
            cells = self.cells_of(settings.occupied_threshold, settings.unknown_is_free)
        return Layers(cells, settings.edge(), self.keepouts)


_Change = Callable[[_Given[S]], _Given[S]]


@dataclass(frozen=True, eq=False)
class _Made(Generic[S, T]):
    """Floor that was made of what was given, and what of that could not be used."""

    given: _Given[S]
    grid: Grid | None
    floor: T | None
    shown: bytes = b""
    """The floor as a message, where it is new and published."""
    refused: tuple[tuple[str, Exception], ...] = ()
    """Errors, each with the kind of fault that it is."""


class FloorReceiver(Generic[S, T]):
    """Source of the floor, from its settings and the topics ``map`` and ``keepout``.

    Floors are made in a thread, as the distances on a large map take longer than many control
    periods. The newest of what was given counts; a bad message or file is refused with a line in
    the log, and the floor in force stays. A parameter `map_file` that cannot be used is refused
    when it is set; where one is given at the start `InvalidMapError` is raised.

    Parameters
    ----------
    node : GuardedNode
        Node of the subscriptions.
    settings : OccupancySettings
        Values at the start; live changes are passed to `change`.
    radius : float
        Radius of the sphere [m].
    frame : str
        Frame of maps and polygons.
    make : callable
        Returns what the node uses, given the occupied cells and the settings; called by the thread
        and, at the start, by the constructor.
    use : callable
        Takes what was made, None where there is nothing to stay clear of any more; called by the
        node's executor. What was made at the start is in `floor`.
    fault_log, event_log : FaultLog
        Logs of refused messages and of floors.
    is_planner : bool
        Whether ``keepout`` is received, too, and the floor in force published on ``~/floor``.
    """

    def __init__(
        self, node: GuardedNode, settings: S, radius: float, frame: str,
        make: Callable[[Grid, S], T], use: Callable[[T | None], None], fault_log: FaultLog,
        event_log: FaultLog, is_planner: bool = True,
    ) -> None:
        self._node, self._radius, self._frame = node, radius, frame
        self._make, self._use = make, use
        self._fault_log, self._event_log = fault_log, event_log
        self._publisher = (
            node.create_publisher(OccupancyGrid, "~/floor", LATCHED) if is_planner else None
        )
        self._read: CellsOf | None = None
        """The map of the file that is being set."""
        self._is_read = False
        """Whether a file, or that there is none, is being set."""
        self._began = time.perf_counter()
        given = _Given(settings, _cells_of_file(settings.map_file))
        self._in_force: _Made[S, T] = _Made(given, None, None)
        self._put_in_force(self._made(given, self._in_force, self._stamp()))
        self._given = given
        self._changes: list[tuple[str, _Change[S]]] = []
        self._job: Future[_Made[S, T]] | None = None
        self._maker = ThreadPoolExecutor(max_workers=1, thread_name_prefix="floor")
        self._timer = node.create_wall_timer(_LOOK_EVERY, self._look)
        self._timer.cancel()
        node.add_on_set_parameters_callback(self._check_file)
        self._subscriptions = [
            node.create_subscription(
                OccupancyGrid, "map", self._receive_map, LATCHED, event_callbacks=NO_EVENTS,
                raw=True,
            )
        ]
        if is_planner:
            self._subscriptions.append(node.create_subscription(
                PolygonInstanceStamped, "keepout", self._receive_keepout, _KEEPOUTS,
                event_callbacks=NO_EVENTS, raw=True,
            ))

    @property
    def floor(self) -> T | None:
        """What was made of the floor in force; None where there is nothing to stay clear of."""
        return self._in_force.floor

    def change(self, settings: S) -> None:
        """Make the floor anew for settings that have changed."""
        read, is_read, self._is_read = self._read, self._is_read, False

        def changed(given: _Given[S]) -> _Given[S]:
            return replace(
                given, settings=settings, cells_of=read if is_read else given.cells_of
            )

        self._request("floor refused", changed)

    def close(self) -> None:
        """Make no floor any more."""
        self._maker.shutdown(wait=False, cancel_futures=True)

    def _check_file(self, parameters: list[Parameter]) -> SetParametersResult:
        """Refuse a map file that cannot be used; otherwise keep its map for `change`.

        Also one that is in force is read again, as it may have changed.
        """
        self._is_read = False
        for name in (p.value for p in parameters if p.name == "map_file"):
            if isinstance(name, str):  # another type is refused by its declaration
                try:
                    self._read = _cells_of_file(name)
                except InvalidMapError as error:
                    return SetParametersResult(successful=False, reason=str(error))
                self._is_read = True
        return SetParametersResult(successful=True)

    def _receive_map(self, message: bytes) -> None:
        frame = self._frame

        def changed(given: _Given[S]) -> _Given[S]:
            found = replace(given, cells_of=map_of_message(message, frame))
            found.layers()  # to be refused alone, not with all changes
            return found

        self._request("map refused", changed)

    def _receive_keepout(self, message: bytes) -> None:
        frame = self._frame

        def changed(given: _Given[S]) -> _Given[S]:
            number, polygon = keepout_of_message(message, frame)
            layers = Layers(keepouts=given.keepouts).with_keepout(number, polygon)
            return replace(given, keepouts=layers.keepouts)

        self._request("keepout refused", changed)

    def _request(self, kind: str, change: _Change[S]) -> None:
        """Make a floor with a change, after the present one; `kind` is the fault if it fails."""
        self._changes.append((kind, change))
        self._timer.reset()
        self._begin()

    def _begin(self) -> None:
        if self._job is not None or not self._changes:
            return
        changes, self._changes = self._changes, []
        self._began = time.perf_counter()
        self._job = self._maker.submit(
            self._changed, self._given, changes, self._in_force, self._stamp()
        )

    def _look(self) -> None:
        """Take the floor that has been made, and begin with the next one if there are changes."""
        job = self._job
        if job is not None and job.done():
            self._job = None
            self._take(job.result())
        self._begin()
        if self._job is None:
            self._timer.cancel()

    def _take(self, made: _Made[S, T]) -> None:
        self._given = made.given
        for kind, error in made.refused:
            if isinstance(error, SphereNmpcError):
                self._fault_log.report(kind, f"{error}; {_STAYS}")
            else:
                self._node.report(f"{kind}, {_STAYS}", error)
        if made.floor is not self.floor:
            self._use(made.floor)
            self._put_in_force(made)

    def _put_in_force(self, made: _Made[S, T]) -> None:
        """Log and publish a floor, unless there is none as before."""
        before, self._in_force = self._in_force, made
        if made.floor is before.floor:
            return
        took = time.perf_counter() - self._began
        self._event_log.report("floor", f"{_about(made.grid)}, in force after {took:.2f} s")
        if self._publisher is not None:
            self._publisher.publish(made.shown)

    def _stamp(self) -> int:
        return int(self._node.get_clock().now().nanoseconds)

    def _changed(
        self, given: _Given[S], changes: list[tuple[str, _Change[S]]], in_force: _Made[S, T],
        stamp: int,
    ) -> _Made[S, T]:
        """Return the floor after changes, at a stamp [ns]; by the thread, so it never raises."""
        # A thread begins with the priority of the one that starts it, which may be that of a
        # control loop in real time.
        with suppress(AttributeError, OSError):
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        refused: list[tuple[str, Exception]] = []
        for kind, change in changes:
            try:
                given = change(given)
            except Exception as error:
                refused.append((kind, error))
        try:
            made = self._made(given, in_force, stamp)
        except Exception as error:
            made = replace(in_force, given=given)
            refused.append(("floor refused", error))
        return replace(made, refused=tuple(refused))

    def _made(self, given: _Given[S], in_force: _Made[S, T], stamp: int) -> _Made[S, T]:
        """Return the floor of what was given, or the one in force where it is the same."""
        grid, settings = given.layers().grid(self._radius), given.settings
        if _are_same(grid, in_force.grid) and settings == in_force.given.settings:
            return replace(in_force, given=given)
        floor = None if grid is None else self._make(grid, settings)
        shown = b"" if self._publisher is None else floor_message(grid, stamp, self._frame)
        return _Made(given, grid, floor, shown)


def floor_with_distances(radius: float, grid: Grid, settings: FloorSettings) -> Floor:
    """Return the floor of a sphere of a radius [m], with what takes long to compute."""
    return Floor(grid, radius, settings.clearance).prepared()


def _are_same(one: Grid | None, other: Grid | None) -> bool:
    if one is None or other is None:
        return one is other
    return (one.resolution, one.origin) == (other.resolution, other.origin) and np.array_equal(
        one.occupied, other.occupied
    )


def _cells_of_file(name: str) -> CellsOf | None:
    """Return the map of a file; None without a name."""
    return read_map(Path(name)).grid if name else None


def _about(grid: Grid | None) -> str:
    """Return a description of a floor."""
    if grid is None:
        return "without edge and obstacles"
    rows, columns = grid.occupied.shape
    width, height = columns * grid.resolution, rows * grid.resolution
    free = 100.0 * (1.0 - np.count_nonzero(grid.occupied) / grid.occupied.size)
    return (
        f"{columns} x {rows} cells of {grid.resolution:.3g} m, {width:.4g} m x {height:.4g} m, "
        f"{free:.3g} % free"
    )
