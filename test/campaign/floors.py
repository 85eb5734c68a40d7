# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Floors and lists of goals of the fuzzing, ordinary and hostile ones.

What is put on the floor is drawn at least 1 m from the sphere, so that it can stop; but for areas
that are dropped over it, where it must not roll on.
"""

import array
import math
import random
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
from actions import Action, every, source
from geometry_msgs.msg import Point32, PolygonInstanceStamped, PoseStamped
from hostile import TEXTS, bad_map, goal_message, map_message
from nav_msgs.msg import Goals, OccupancyGrid
from node_session import READY, Session, SessionError
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterType, ParameterValue
from rclpy.qos import DurabilityPolicy, QoSProfile

from sphere_nmpc.model.state import POSITION, Vector
from sphere_nmpc.ros.guarded_node import LATCHED

_KEPT = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
_AWAY = 1.0
"""Least distance from the middle of the sphere to what is put on the floor [m]: its radius, the
way of a stop, and what it rolls until that is in force."""
_IDS = (0, 1, 2, 2**31, 2**32 - 1)
"""Ids of areas, of which each replaces the one before."""
_LENGTHS = 0, 1, 2, 20, 1000
_NOWHERE = math.nan, math.inf, -1e30
_EDGES = (
    "", "[[-6, -6], [6, -6], [6, 6], [-6, 6]]", "[[-6, -6], [6, 6], [6, -6], [-6, 6]]",
    "[[-9, -5], [9, -5], [0, 9]]", "[[0, 0], [1, 0], [2, 0]]", "[[nan, 0], [1, 0], [0, 1]]",
    "[[1e300, 0], [0, 1e300], [-1e300, 0]]", "[[0, 0]]", "[" * 5000, "{a: b}", "7", *TEXTS[:4],
)
"""Texts of the parameter `floor`; edges are far from the sphere."""


@contextmanager
def _goals(session: Session, rng: random.Random) -> Iterator[Callable[[], None]]:
    """Yield a function that sends another goal from time to time, so that the sphere moves."""
    with session.publisher(PoseStamped, "goal_pose") as publisher:
        yield every(1.5, lambda: publisher.publish(goal_message(rng, "valid")))


def areas(session: Session) -> Action:
    """Areas to keep out of and edges: near, far, huge, tiny, moving, over sphere or goal, bad."""
    rng, judge = source(session), session.judge
    period = rng.choice((0.1, 0.5, 2.0))
    sent: set[int] = set()

    def send() -> None:
        if judge.state is None or judge.run is None:
            return
        number = rng.choice(_IDS)
        sent.add(number)
        corners = _corners(rng, judge.state[POSITION], judge.run.goal[POSITION])
        publisher.publish(_area(number, corners))
        if rng.random() < 0.1:
            value = ParameterValue(
                type=ParameterType.PARAMETER_STRING, string_value=rng.choice(_EDGES)
            )
            request = session.services["controller/set_parameters"].Request(
                parameters=[ParameterMessage(name="floor", value=value)]
            )
            session.ask("controller/set_parameters", request)

    topic = session.publisher(PolygonInstanceStamped, "keepout", _KEPT)
    with topic as publisher, _goals(session, rng) as goal:
        yield together(goal, every(period, send))
        for number in sent:
            publisher.publish(_area(number, np.empty((0, 2))))
        session.require_parameters("controller", floor="")
        if not session.until(lambda: judge.contacts.grid is None, READY):
            raise SessionError("areas that were taken away are still in force")


def maps(session: Session) -> Action:
    """Maps of any size, turn and resolution with obstacles ahead, and bad ones, for both nodes."""
    rng, judge = source(session), session.judge

    def send() -> None:
        if judge.state is not None:
            is_bad = rng.random() < 0.3
            publisher.publish(bad_map(rng) if is_bad else _map(rng, judge.state[POSITION]))

    topic = session.publisher(OccupancyGrid, "map", LATCHED)
    with topic as publisher, _goals(session, rng) as goal:
        yield together(goal, every(1.0, send))
    session.without_map()


def goal_lists(session: Session) -> Action:
    """Lists of 0 to 1000 goals, valid ones and such with one that is not."""
    rng = source(session)

    def send() -> None:
        count, bad = rng.choice(_LENGTHS), rng.choice(("valid", "valid", "far", "number", "norm"))
        poses = [goal_message(rng, "valid") for _ in range(count)]
        if poses:
            poses[rng.randrange(count)] = goal_message(rng, bad)
        publisher.publish(Goals(goals=poses))

    with session.publisher(Goals, "goals") as publisher:
        yield every(0.2, send)


def together(first: Callable[[], object], second: Callable[[], object]) -> Callable[[], None]:
    """Return a function that calls two others."""
    def both() -> None:
        first()
        second()

    return both


def _corners(rng: random.Random, place: Vector, goal: Vector) -> Vector:
    """Return the corners of an area, shape (K, 2) [m], none of them to take it away."""
    angle, kind = rng.uniform(-math.pi, math.pi), rng.randrange(10)
    size = (0.3, 0.3, 0.001, 25.0, 0.5, 1.0, 0.5, 0.3, 0.3, 0.3)[kind]
    away = _AWAY + size + rng.choice((0.0, 0.5, 8.0, 30.0))
    middle = place + away * np.array((math.cos(angle), math.sin(angle)))
    if kind == 4:  # over the sphere
        size = rng.choice((size, 2.5))
        middle = place + np.array((rng.uniform(-0.4, 0.4), rng.uniform(-0.4, 0.4)))
    elif kind == 5 and float(np.linalg.norm(goal - place)) > _AWAY + size:
        middle = goal
    count = 1000 if kind == 6 else rng.choice((3, 4, 7))
    turns = angle + 2.0 * math.pi * np.arange(count) / count
    corners: Vector = middle + size * np.column_stack((np.cos(turns), np.sin(turns)))
    if kind == 7:  # with crossing edges, but for triangles
        corners = corners[rng.sample(range(count), count)]
    elif kind == 8:
        corners[rng.randrange(count), rng.randrange(2)] = rng.choice(_NOWHERE)
    elif kind == 9:
        corners = corners[: rng.randrange(3)]
    return corners


def _area(number: int, corners: Vector) -> PolygonInstanceStamped:
    message = PolygonInstanceStamped()
    message.polygon.id = number
    message.polygon.polygon.points = [Point32(x=float(x), y=float(y)) for x, y in corners]
    return message


def _map(rng: random.Random, place: Vector) -> OccupancyGrid:
    """Return a turned map around a place, shape (2,) [m], with obstacles of cells not near it."""
    if rng.random() < 0.2:
        return map_message()
    side, count = rng.choice(((0.02, 600), (0.05, 240), (0.1, 120), (0.37, 40)))
    turn, half = rng.uniform(-math.pi, math.pi), 0.5 * side * count
    at = side * (np.arange(count) + 0.5) - half
    x, y = np.meshgrid(at, at)
    cells = np.zeros((count, count), dtype=np.int8)
    for _ in range(rng.choice((1, 4, 12))):
        u, v = rng.uniform(-4.0, 4.0), rng.uniform(-4.0, 4.0)
        size = rng.choice((0.01, 0.2, 0.6))
        cells[(np.abs(x - u) <= size) & (np.abs(y - v) <= size)] = rng.choice((100, 100, -1))
    # Cells are as far away as their middles, but for half a diagonal.
    cells[np.hypot(x, y) < _AWAY + side] = 0
    corner = place - half * np.array((
        math.cos(turn) - math.sin(turn), math.sin(turn) + math.cos(turn)
    ))
    message = OccupancyGrid(data=array.array("b", cells.tobytes()))
    info = message.info
    info.width = info.height = count
    info.resolution = side
    info.origin.position.x, info.origin.position.y = (float(value) for value in corner)
    info.origin.orientation.z, info.origin.orientation.w = math.sin(turn / 2), math.cos(turn / 2)
    return message
