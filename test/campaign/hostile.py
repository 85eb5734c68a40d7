# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Values that faults send: goals, malformed messages, and ones with extreme values."""

import array
import math
import random
import re
from collections.abc import Iterator
from contextlib import suppress
from importlib import import_module
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import OccupancyGrid
from rcl_interfaces.msg import ParameterValue
from rclpy.serialization import deserialize_message, serialize_message
from std_msgs.msg import Float64

from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.rotation import random_quaternion
from sphere_nmpc.model.state import QUATERNION, Vector, upright_state
from sphere_nmpc.ros.messages import pose_to_ros

NUMBERS = (
    float("nan"), float("inf"), -float("inf"), 0.0, -0.0, 5e-324, 1e-300, 1.0, -1.0, 100.0, 1e6,
    1e150, 1e300, 1e308, -1e308,
)
FORGED = "[FATAL] [0.000000000] [forged]: the robot burns"
"""Line that must not begin a line of a log."""
TEXTS = (
    "", "world", "map", "time_optimal", "plan_keeping", "paper", "nan", "[a, b]", "ERROR",
    "x" * 200_000, f"map\n{FORGED}", "\x1b[2J\x1b]0;title\x07", "<img src=x onerror=alert(1)>",
    "\u202e\u00fc" * 500, "%s%n{0.__class__}", "../../etc/passwd", "a b/c//~", "\r\n\t\x00",
)
_BITS = {"int8": 8, "int16": 16, "int32": 32, "int64": 64}
_SEQUENCE = re.compile(r"sequence<(.+?)(?:, \d+)?>$")
_ARRAY = re.compile(r"(.+)\[\d+\]$")
ROBOT = RobotParameters()
RADIUS = ROBOT.shell_radius
_CELL, _CELLS = 0.1, 100
"""Side of a cell of a map [m], and how many of them a map has in each direction."""
_HALF_OBSTACLE = 0.3
"""Half the side of an obstacle [m]."""
_SHARE_UNKNOWN = 0.01
"""Share of parameter values of an unknown type."""


def damaged(rng: random.Random, data: bytes) -> bytes:
    """Return a serialised message that was damaged in one of several ways."""
    how = rng.randrange(7)
    if how == 0:
        return data[: rng.randrange(len(data))]
    if how == 1:
        return b"\x00\x01\x00\x00" + rng.randbytes(rng.choice((0, 4, 7, 64, 5000)))
    if how == 2:
        return rng.randbytes(rng.choice((1, 2, 3, 4, 64)))
    if how == 3:
        return rng.randbytes(2) + data[2:]
    if how == 4:
        return data + rng.randbytes(rng.choice((1, 4, 60_000)))
    changed = bytearray(data)
    if how == 5:  # a length, perhaps
        at = 4 * rng.randrange(max(1, len(data) // 4))
        word = rng.choice((0, 1, len(data), 2**16, 2**31 - 1, 2**32 - 1))
        changed[at : at + 4] = word.to_bytes(4, "little")
    else:
        for _ in range(rng.choice((1, 4, 20))):
            changed[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    return bytes(changed)


def extreme(rng: random.Random, kind: type, data: bytes) -> bytes:
    """Return a serialised message of which some fields have extreme values."""
    message = deserialize_message(data, kind)
    for _ in range(rng.choice((1, 1, 2, 5))):
        owner, field, name = rng.choice(list(_fields(message)))
        setattr(owner, field, extreme_value(rng, name))
    return bytes(serialize_message(message))


def extreme_value(rng: random.Random, name: str) -> Any:
    """Return an extreme value for a field of the type of that name."""
    if match := _SEQUENCE.match(name):
        item = match[1]
        number = rng.choice((0, 1, 2, 3, 100_000 if item in ("double", "octet") else 20))
        return [extreme_value(rng, item)] * number
    if name in ("double", "float"):
        value = rng.choice((*NUMBERS, rng.uniform(-10.0, 10.0)))
        return value if name == "double" or abs(value) < 1e30 else 0.0
    if name == "string":
        return rng.choice(TEXTS)
    if name == "boolean":
        return rng.random() < 0.5
    if name in ("octet", "byte"):
        return bytes([rng.randrange(256)])
    if name.removeprefix("u") in _BITS:
        most = 2 ** (_BITS[name.removeprefix("u")] - (name[0] == "i"))
        least = -most if name[0] == "i" else 0
        return rng.choice((least, 0, 1, rng.randrange(100), most - 1))
    if _ARRAY.match(name):
        raise NotImplementedError(name)
    package, _, own = name.partition("/")
    return getattr(import_module(f"{package}.msg"), own)()


def random_goal(rng: np.random.Generator, upright: bool = False) -> Vector:
    """Return a goal, shape (6,), with |x|, |y| <= 2 m and any heading or orientation."""
    turn = random_quaternion(rng)
    if upright:
        turn = upright_state(0.0, 0.0, rng.uniform(-math.pi, math.pi))[QUATERNION]
    return np.concatenate((rng.uniform(-2.0, 2.0, 2), turn))


def goal_message(rng: random.Random, kind: str) -> PoseStamped:
    """Return a random goal, valid or far, or with a hostile number, norm or frame."""
    goal = random_goal(np.random.default_rng(rng.getrandbits(32)))
    message = pose_to_ros(goal, 0, RADIUS)
    place, turn = message.pose.position, message.pose.orientation
    if kind == "far":
        place.x, place.y = rng.choice((1e3, 1e6, -1e9, 1e150, 1e300, -1e308)), 0.0
    elif kind == "number":
        place.x = turn.z = rng.choice(NUMBERS)
    elif kind == "norm":
        turn.w = rng.choice((0.0, 2.0, 1e200))
    elif kind == "frame":
        message.header.frame_id = rng.choice(TEXTS)
    return message


def map_message(obstacle: Vector | None = None) -> OccupancyGrid:
    """Return a map that is free but for a square of 0.6 m around a place, shape (2,) [m]."""
    centres = _CELL * (np.arange(_CELLS) + 0.5 - 0.5 * _CELLS)
    cells = np.zeros((_CELLS, _CELLS), dtype=np.int8)
    if obstacle is not None:
        columns, rows = (np.abs(centres - place) < _HALF_OBSTACLE for place in obstacle)
        cells[np.ix_(rows, columns)] = 100
    message = OccupancyGrid(data=array.array("b", cells.tobytes()))
    message.info.width = message.info.height = _CELLS
    message.info.resolution = _CELL
    message.info.origin.position.x = message.info.origin.position.y = -0.5 * _CELL * _CELLS
    message.info.origin.orientation.w = 1.0
    return message


def bad_map(rng: random.Random) -> OccupancyGrid:
    """Return a map with a wrong number of cells, side, value, place, tilt or frame."""
    message = map_message()
    info, how = message.info, rng.randrange(6)
    if how == 0:
        info.width = rng.choice((0, 1, _CELLS - 1, 2**32 - 1))
    elif how == 1:
        info.resolution = rng.choice((0.0, -0.05, float("nan"), float("inf")))
    elif how == 2:
        message.data[rng.randrange(_CELLS**2)] = rng.choice((101, -2, 127, -128))
    elif how == 3:
        info.origin.position.x = rng.choice((float("nan"), float("inf")))
    elif how == 4:
        info.origin.orientation.x = 1.0
    else:
        message.header.frame_id = rng.choice([text for text in TEXTS if text not in ("", "world")])
    return message


def parameter_value(rng: random.Random, present: ParameterValue) -> ParameterValue:
    """Return a value for a parameter, mostly of a type that there is, and often of its own."""
    fields = list(ParameterValue.get_fields_and_field_types().items())[1:]
    value = ParameterValue(type=rng.choice((present.type, rng.randrange(len(fields) + 1))))
    if rng.random() < _SHARE_UNKNOWN:
        value.type = rng.choice((len(fields) + 1, 99, 255))
    elif value.type > 0:
        field, name = fields[value.type - 1]
        setattr(value, field, extreme_value(rng, name))
    return value


def example(kind: type) -> bytes:
    """Return a plausible serialised message of a type that nobody has sent."""
    message = kind()
    with suppress(AttributeError):
        message.pose.orientation.w = 1.0
    if isinstance(message, Float64):
        message.data = 0.5
    return bytes(serialize_message(message))


def _fields(message: Any) -> Iterator[tuple[Any, str, str]]:
    """Yield the fields of a message and of those in it: owner, name and type."""
    for field, name in message.get_fields_and_field_types().items():
        value = getattr(message, field)
        if hasattr(value, "get_fields_and_field_types"):
            yield from _fields(value)
        elif not _ARRAY.match(name):
            yield message, field, name
            if isinstance(value, list) and value and hasattr(
                value[0], "get_fields_and_field_types"
            ):
                for item in value[:3]:
                    yield from _fields(item)
