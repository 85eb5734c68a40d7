# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Checks of ros2 commands against the documented topics, services and message types."""

import re
from argparse import Namespace
from array import array
from collections.abc import Sequence
from functools import reduce
from importlib import import_module
from pathlib import Path
from typing import Any

import yaml
from command_checks import Options, WrongCommandError, check_value, settings_of

TOPICS = Path(__file__).parents[2] / "msg_docs" / "topics.md"


def table() -> list[tuple[str, str, str, str, str]]:
    """Return node, full name, type, kind and quality of service of each row of the tables."""
    found = []
    for section in TOPICS.read_text("utf-8").split("\n## `")[1:]:
        node = section.partition("`")[0]
        rows = re.findall(
            r"^\| `(\S+)` \| (\S+/\S+) \| (\w+) \| ([^|]*)\|", section.partition("\n## ")[0], re.M
        )
        found += [
            (node, f"/{name.replace('~', node).lstrip('/')}", kind, verb, qos.strip())
            for name, kind, verb, qos in rows
        ]
    return found


def offered() -> dict[str, dict[str, str]]:
    """Return type and quality of service of the documented topics and services, by full name.

    A topic and a service may have the same name.
    """
    found: dict[str, dict[str, str]] = {}
    for _, name, kind, _, qos in table():
        found.setdefault(name, {})[kind] = qos
    # A service may be in the text, followed by its type in brackets.
    for section in TOPICS.read_text("utf-8").split("\n## `")[1:]:
        for name, kind in re.findall(r"`~(/\w+)`\s+\((\S+/srv/\w+)\)", section):
            found.setdefault(f"/{section.partition('`')[0]}{name}", {})[kind] = ""
    return found


def offers(name: str) -> dict[str, str]:
    """Return the types of a topic or service, which may be that of a robot in a namespace."""
    documented = offered()
    full = f"/{name.lstrip('/')}"
    second = re.sub(r"^/\w+(?=/)", "", full)
    actual = documented.get(full) or documented.get(second)
    if actual is None:
        raise WrongCommandError(f"{name}: not in msg_docs/topics.md")
    return actual


def check_topic(name: str, kind: str | None = None) -> str:
    """Return the type of a topic or service."""
    actual = offers(name)
    if kind is None:
        return next(iter(actual))
    for candidate in actual:
        if re.sub("/(msg|srv)/", "/", kind) == re.sub("/(msg|srv)/", "/", candidate):
            return candidate
    raise WrongCommandError(f"{name}: given the type {kind}, expected {' or '.join(actual)}")


def fill(message: Any, values: Any) -> None:
    """Set the fields of a message as `ros2 topic pub` does."""
    if not isinstance(values, dict):
        raise WrongCommandError(f"{type(message).__name__}: given {values!r}, expected fields")
    fields = message.get_fields_and_field_types()
    for name, value in values.items():
        if name not in fields:
            raise WrongCommandError(f"{type(message).__name__} has no field {name}")
        if (fields[name], value) in (
            ("std_msgs/Header", "auto"), ("builtin_interfaces/Time", "now")
        ):
            continue
        element = re.fullmatch(r"sequence<(\w+/\w+)(?:, \d+)?>|(\w+/\w+)(\[\d+\])?", fields[name])
        if element is None:
            current = getattr(message, name)
            try:
                if isinstance(current, array):
                    value = array(current.typecode, value)
                is_whole = isinstance(current, float) and type(value) is int
                setattr(message, name, float(value) if is_whole else value)
            except (AssertionError, TypeError, ValueError) as error:
                raise WrongCommandError(f"{name}: given {value!r}: {error}") from None
            continue
        package, kind = (element[1] or element[2]).split("/")
        nested = getattr(import_module(f"{package}.msg"), kind)
        for part in value if element[1] or element[3] else [value]:
            fill(nested(check_fields=True), part)


def filled(kind: str, values: str) -> Any:
    """Return a message, or the request of a service, with these values."""
    package, group, name = kind.split("/")
    found = getattr(import_module(f"{package}.{group}"), name)
    message = getattr(found, "Request", found)(check_fields=True)
    fill(message, yaml.safe_load(values))
    return message


def parsed(words: Sequence[str], names: str, flags: str = "", options: str = "") -> Namespace:
    """Return the parsed arguments of a ros2 command.

    Positional `names` may end in ``?``; `flags` and `options` with a value are given as
    ``-s/--long``.
    """
    parser = Options()
    for name in names.split():
        optional = {"nargs": "?", "default": ""} if name.endswith("?") else {}
        parser.add_argument(name.rstrip("?"), **optional)
    for name in flags.split():
        parser.add_argument(*name.split("/"), action="store_true")
    for name in options.split():
        parser.add_argument(*name.split("/"))
    return parser.parse_args(words)


QOS = "--qos-reliability --qos-durability --qos-profile"


def check_publication(words: Sequence[str]) -> None:
    given = parsed(
        words, "topic kind values?", "-1/--once",
        f"-r/--rate -t/--times -w/--wait -p/--print --keep-alive {QOS}",
    )
    filled(check_topic(given.topic, given.kind), given.values or "{}")
    if given.topic.endswith("goal_pose") and given.once and not given.wait:
        raise WrongCommandError(
            "--once: the goal is sent to the first matched subscription, perhaps before the "
            "controller is matched; expected -t 3"
        )


def check_subscription(words: Sequence[str]) -> None:
    given = parsed(
        words, "topic kind?", "--once --no-arr --csv --verbose -v", f"--field --window {QOS}"
    )
    kind = check_topic(given.topic, given.kind or None)
    message = filled(kind, "{}")
    qos = (given.qos_reliability, given.qos_durability)
    # With any of these options `ros2 topic echo` begins with best effort and volatile.
    is_adapted = not (any(qos) or given.qos_profile)
    is_latched = "transient local" in offers(given.topic)[kind]
    if is_latched and not is_adapted and qos != ("reliable", "transient_local"):
        raise WrongCommandError(
            f"{given.topic} is published once, before the subscription: expected "
            "--qos-reliability reliable with --qos-durability transient_local, or neither"
        )
    if given.field:
        try:
            reduce(getattr, given.field.split("."), message)
        except AttributeError as error:
            raise WrongCommandError(f"--field: {error}") from None


def check_service_call(words: Sequence[str]) -> None:
    given = parsed(words, "service kind values?")
    filled(check_topic(given.service, given.kind), given.values or "{}")


def check_parameter_set(words: Sequence[str]) -> None:
    given = parsed(words, "node name value")
    check_value(given.node.split("/")[-1], given.name, given.value, live=True)


def check_parameter_get(words: Sequence[str]) -> None:
    given = parsed(words, "node name")
    if given.name != "use_sim_time":
        settings_of(given.node.split("/")[-1], given.name)


def check_recording(words: Sequence[str]) -> None:
    parser = Options()
    parser.add_argument("names", nargs="*", default=[])
    parser.add_argument("--topics", nargs="+", action="extend", default=[])
    parser.add_argument("-a", "--all", action="store_true")
    parser.add_argument("--use-sim-time", action="store_true")
    for name in ("--storage", "--output"):
        parser.add_argument(name[1:3], name)
    given = parser.parse_args(words)
    topics = [*given.names, *given.topics]
    if given.all or any(topic.endswith("goal_pose") for topic in topics):
        raise WrongCommandError(
            "records goal_pose, to which only the controller should subscribe: "
            "expected controller/active_goal"
        )
    if not topics:
        raise WrongCommandError("no topics are given")
    for topic in topics:
        if topic not in ("/tf", "/tf_static", "/rosout", "/parameter_events"):
            check_topic(topic)
