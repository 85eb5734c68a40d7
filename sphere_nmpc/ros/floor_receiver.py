# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The floor of a node, from its parameters and the topics ``map`` and ``keepout``."""

import time
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import gettempdir
from typing import Any, Generic, TypeVar

import numpy as np
from geometry_msgs.msg import PolygonInstanceStamped
from nav_msgs.msg import OccupancyGrid
from rclpy.qos import DurabilityPolicy, QoSProfile

from sphere_nmpc.errors import Description, InvalidParameterError, SphereNmpcError
from sphere_nmpc.floor.change_queue import ChangeQueue, Request
from sphere_nmpc.floor.floor import Floor
from sphere_nmpc.floor.layers import MOST_AREAS, Layers
from sphere_nmpc.floor.map_file import read_map
from sphere_nmpc.floor.occupancy import Grid, InvalidMapError, check_polygon
from sphere_nmpc.floor.settings import FloorSettings, OccupancySettings
from sphere_nmpc.reporting.conditions import Condition, Kind
from sphere_nmpc.reporting.fault_log import FaultLog
from sphere_nmpc.ros.cdr_messages import floor_message
from sphere_nmpc.ros.floor_messages import (
    LARGEST_KEEPOUT,
    LARGEST_MAP,
    CellsOf,
    keepout_of_message,
    map_of_message,
)
from sphere_nmpc.ros.graph_monitor import NO_EVENTS
from sphere_nmpc.ros.guarded_node import LATCHED, GuardedNode

_KEEPOUTS = QoSProfile(depth=MOST_AREAS, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""Messages of areas to keep out of, all of which are sent at once to a node that starts later."""
_LOOK_EVERY = 0.02
"""Wall time between two looks for a floor that is being made [s]."""
_MOMENT = 1.0
"""Wall time after which a change should be in force [s]; most take a tenth of it."""
_STAYS = "the floor in force stays"

S = TypeVar("S", bound=OccupancySettings)
T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class _Given(Generic[S]):
    """What a floor is put together from, as it was given last."""

    settings: S
    radius: float
    """Radius of the sphere [m]."""
    cells_of: CellsOf | None = None
    """The map; None where there is none."""
    layers: Layers = field(default_factory=Layers)

    def changed(self, settings: S, cells_of: CellsOf | None) -> "_Given[S]":
        """Return what is given with other settings and another map."""
        how = settings.occupied_threshold, settings.unknown_is_free
        before = self.settings.occupied_threshold, self.settings.unknown_is_free
        grid = self.layers.map
        if cells_of is not self.cells_of or how != before:
            grid = None if cells_of is None else cells_of(*how)
        layers = replace(self.layers, map=grid, edge=settings.edge())
        return replace(self, settings=settings, cells_of=cells_of).with_layers(layers)

    def with_layers(self, layers: Layers) -> "_Given[S]":
        """Return what is given with other layers, of which a floor can be made."""
        layers.base(self.radius)
        return replace(self, layers=layers)


@dataclass(frozen=True, eq=False)
class _Made(Generic[S, T]):
    """Floor that was made of what was given."""

    given: _Given[S]
    grid: Grid | None = None
    floor: T | None = None
    shown: bytes = b""
    """The floor as a message, where it is published."""


class FloorReceiver(Generic[S, T]):
    """Source of the floor, from its settings and the topics ``map`` and ``keepout``.

    Floors are made in a thread, as the distances on a large map take longer than many control
    periods. A bad message is refused with a line in the log, and the floor in force stays. A
    change of parameters is answered when it is in force or refused, which the node does not wait
    for. What cannot be used at the start raises `InvalidMapError`.

    Parameters
    ----------
    node : GuardedNode
        Node of the subscriptions.
    settings : OccupancySettings
        Values at the start; live changes are passed to `prepare`.
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
        self._node, self._frame = node, frame
        self._make, self._use = make, use
        self._fault_log, self._event_log = fault_log, event_log
        self._publisher = (
            node.create_publisher(OccupancyGrid, "~/floor", LATCHED) if is_planner else None
        )
        began = time.monotonic()
        given = _Given(settings, radius).changed(settings, _cells_of_file(settings.map_file))
        made = self._made(given, _Made(given))
        self._changes: ChangeQueue[_Given[S], _Made[S, T]] = ChangeQueue(
            made, self._made, self._put_in_force, self._refuse
        )
        if made.floor is not None:
            self._show(made, time.monotonic() - began)
        self._timer = node.create_wall_timer(_LOOK_EVERY, self._look)
        self._timer.cancel()
        self._subscriptions = [
            node.create_subscription(
                OccupancyGrid, "map", self._receive_map, LATCHED, event_callbacks=NO_EVENTS,
                raw=True, largest=LARGEST_MAP,
            )
        ]
        if is_planner:
            self._subscriptions.append(node.create_subscription(
                PolygonInstanceStamped, "keepout", self._receive_keepout, _KEEPOUTS,
                event_callbacks=NO_EVENTS, largest=LARGEST_KEEPOUT,
            ))

    @property
    def floor(self) -> T | None:
        """What was made of the floor in force; None where there is nothing to stay clear of."""
        return self._changes.in_force.floor

    @property
    def pending(self) -> float:
        """Time for which the oldest change has not been in force [s, wall]; 0 without any."""
        oldest = self._changes.oldest()
        return 0.0 if oldest is None else time.monotonic() - oldest.since

    def faults(self) -> list[Condition]:
        """Return the fault of a floor that is not in force yet, if there is one."""
        oldest, pending = self._changes.oldest(), self.pending
        if oldest is None or pending < _MOMENT:
            return []
        return [Condition(
            Kind.FLOOR_LATE,
            f"given {oldest.name} {pending:.1f} s ago, expected it in force within "
            f"{_MOMENT:g} s; the sphere rolls as on the floor before: a smaller or coarser map, "
            "or fewer areas and corners, are made sooner",
        )]

    def prepare(
        self, settings: Callable[[], S], names: set[str], is_awaited: bool
    ) -> Future[Callable[[], object]]:
        """Begin to make the floor of settings that are to be set; see `Prepare`.

        A map file is read each time it is set, also the one in force, as it may have changed.
        """
        def changed(given: _Given[S]) -> _Given[S]:
            found, cells_of = settings(), given.cells_of
            return given.changed(
                found, _cells_of_file(found.map_file) if "map_file" in names else cells_of
            )

        self._timer.reset()
        return self._changes.prepare(Request("the parameters", changed), is_awaited)

    def close(self) -> None:
        """Make no floor any more; one that is being made is not waited for."""
        ended = Description("its end")
        self._changes.close(InvalidParameterError("node", ended, "a node that runs on"))

    def _receive_map(self, message: bytes) -> None:
        def changed(given: _Given[S]) -> _Given[S]:
            return given.changed(given.settings, map_of_message(message, self._frame))

        self._timer.reset()
        self._changes.submit("map", Request("map", changed))

    def _receive_keepout(self, message: PolygonInstanceStamped) -> None:
        request: Request[_Given[S]] = Request("keepout", lambda given: given)
        try:
            number, corners = keepout_of_message(message, self._frame)
        except InvalidMapError as error:
            self._refuse(request, error)
            return

        def changed(given: _Given[S]) -> _Given[S]:
            polygon = check_polygon(f"keepout {number}", corners) if corners else None
            return given.with_layers(given.layers.with_keepout(number, polygon))

        self._timer.reset()
        self._changes.submit(number, replace(request, change=changed))

    def _look(self) -> None:
        """Take the floor that has been made, and begin with the next one if there are changes."""
        if not self._changes.look():
            self._timer.cancel()

    def _refuse(self, request: Request[Any], error: Exception) -> None:
        if isinstance(error, SphereNmpcError):
            self._fault_log.report(f"{request.name} refused", f"{error}; {_STAYS}")
        else:  # memory, disk
            self._node.report(f"floor refused, {request.name} not in force, {_STAYS}", error)

    def _put_in_force(self, made: _Made[S, T], took: float) -> None:
        if made.floor is not self.floor:
            self._use(made.floor)
            self._show(made, took)

    def _show(self, made: _Made[S, T], took: float) -> None:
        """Log and publish a floor."""
        self._event_log.report("floor", f"{_about(made.grid)}, in force after {took:.2f} s")
        if self._publisher is not None:
            self._publisher.publish(made.shown)

    def _made(self, given: _Given[S], in_force: _Made[S, T]) -> _Made[S, T]:
        """Return the floor of what was given, or the one in force where it is the same."""
        grid, settings = given.layers.grid(given.radius), given.settings
        if _are_same(grid, in_force.grid) and settings == in_force.given.settings:
            return replace(in_force, given=given)
        try:
            floor = None if grid is None else self._make(grid, settings)
        except OSError as error:
            raise OSError(f"{error}; is there room in {gettempdir()} (TMPDIR)?") from error
        stamp, shown = int(self._node.get_clock().now().nanoseconds), b""
        if self._publisher is not None:
            shown = floor_message(grid, stamp, self._frame)
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
