# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Documents: links have targets, and the package accepts each command.

Nothing is run: arguments go through the parsers of the package, parameters through its settings,
payloads into the messages, and launch arguments into the launch file.
"""

import contextlib
import dataclasses
import io
import re
import shlex
from array import array
from collections.abc import Callable, Iterator, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
import yaml

pytest.importorskip("rclpy")

import faults
import navigation_messages
from document_commands import DOCUMENTS, Command, all_commands, commands
from documented_topics import types_of
from launch_stand_in import LAUNCH, ROOT, started
from parameter_tables import NODES, OF_ROBOT, PARTS
from rosbags.rosbag2 import Reader

from sphere_nmpc.errors import SphereNmpcError
from sphere_nmpc.foreign.entry_table import Entry
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.quantities import quantities
from sphere_nmpc.reporting.conditions import Kind
from sphere_nmpc.ros.settings import FrameSettings
from sphere_nmpc.settings import STRATEGIES, StrategyEntry
from sphere_sim.cli import benchmark, demo, estimate, identify, report, study, viewer
from sphere_sim.cli.main import VERBS
from sphere_sim.recording.run_reader import read_run
from sphere_sim.ros.session import goal_command
from sphere_sim.ros.simulator import robot_description
from sphere_sim.world.settings import PLANTS

MODULE = robot_description.__name__
"""Module that documents run by its name."""
PARSERS: dict[str, Callable[[Sequence[str]], object]] = {
    "demo": demo.parse,
    "goal": goal_command.parse,
    "viewer": viewer._parse,
    "study": lambda words: study._parser().parse_args(words),
    "benchmark": benchmark._parse,
    "report": report._parse,
    "estimate": estimate.parse,
    "identify": identify.parse,
    "faults": faults._parse,
    MODULE: robot_description._parse,
}
"""Parser of each verb, `make faults` and a module; other verbs take arguments of ROS only."""
SETTINGS: dict[str, list[tuple[str, Any]]] = {
    node: [("", settings), *([("robot", RobotParameters())] if node in OF_ROBOT else []),
           *((prefix, more) for prefix, _, more in PARTS[node])]
    for node, settings in NODES.items()
} | {
    "viewer": [("", FrameSettings())], "markers": [("", FrameSettings())], "goal": [],
}
"""Settings of each node with the prefixes of their names."""
WITH_VALUE = {
    "-r", "--rate", "-t", "--times", "-w", "--wait", "--field", "--window", "-s", "--storage",
    "-o", "--output", "--qos-reliability", "--qos-durability", "--qos-profile",
}
FLAGS = {
    "-1", "--once", "--no-arr", "--csv", "-v", "--verbose", "-a", "--all", "--use-sim-time",
    "--topics", "-f", "--feedback",
}
"""Options of ros2 topic, service, action, param and bag."""
ASSIGNING = ("-p", "--param", "-r", "--remap")
OF_ROS = ("--params-file", "--enclave", "--log-level")
"""Arguments of ROS with name:=value, and others."""
NOT_CHECKED = (
    "security", "pkg prefix", "topic list", "node list", "bag info", "bag play",
    "run robot_state_publisher", "run controller_manager", "run mujoco_ros2_control",
)
"""Commands of ros2 whose arguments do not depend on the package, and of packages that are not
there."""
GOALS = ("goal_pose", "goal_point", "goals", "path")
"""Topics on which a controller is given goals."""
REFUSALS = (SphereNmpcError, AssertionError, TypeError, ValueError, RuntimeError)
"""Of this file and the fields of messages, of settings, and of the launch file."""
LINK = re.compile(r"\]\(([^)\s]+)\)|src=\"([^\"]+)\"")
TARGETS = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
OF_ROSBAG2 = ("/tf", "/tf_static", "/rosout", "/parameter_events")


class WrongCommandError(AssertionError):
    """A documented command that would be refused or have no effect."""


def check_parameter(nodes: Sequence[str], name: str, text: str = "", live: bool = False) -> None:
    """Check that one of some nodes has a parameter, and a value for it as YAML 1.1 reads it."""
    prefix, _, field = name.rpartition(".")
    for node in nodes:
        if name == "use_sim_time" or (node, name) == ("recorder", "topics"):
            return
        for of, settings in SETTINGS[node]:
            if of == prefix and field in (known := quantities(settings)):
                if live and not known[field].live:
                    raise WrongCommandError(f"{name} of {node} cannot be changed while it runs")
                if text:
                    value = yaml.safe_load(text)
                    value = tuple(value) if type(value) is list else value
                    dataclasses.replace(settings, **{field: value})
                return
    raise WrongCommandError(f"{' or '.join(nodes)} has no parameter {name}")


def check_own(verb: str, words: Sequence[str], inline: bool) -> None:
    if verb not in PARSERS:
        if words and words[0] not in ("-h", "--help"):
            raise WrongCommandError(f"{verb} takes ROS arguments only, given {' '.join(words)}")
        return
    # In running text a capital letter is a number; 0.5 0.5 0.5 0.5 is an orientation.
    for number in ("0.5", "1"):
        output = io.StringIO()
        given = [number if re.fullmatch("[A-Z]", word) else word for word in words]
        try:
            with contextlib.redirect_stderr(output), contextlib.redirect_stdout(io.StringIO()):
                PARSERS[verb](given)
        except SystemExit as end:
            lacking = re.search("are required|is required|expected .*argument", output.getvalue())
            if not end.code or (inline and lacking):
                return
        else:
            return
    raise WrongCommandError(output.getvalue().strip().splitlines()[-1])


def check_ros(nodes: Sequence[str], words: Sequence[str]) -> None:
    """Check arguments after --ros-args of one of some nodes."""
    rest = iter(word for word in words if word != "--")
    for option, value in zip(rest, rest, strict=True):
        name, assigns, given = value.partition(":=")
        if option not in (ASSIGNING if assigns else OF_ROS):
            raise WrongCommandError(f"{option} {value}: no argument of ROS")
        if option in ("-p", "--param"):
            check_parameter(nodes, name, given)


def check_verb(words: Sequence[str], inline: bool) -> None:
    verb, *rest = words or ["--help"]
    if verb in ("-h", "--help", "--version"):
        return
    if verb == "sphere_nmpc":
        return check_verb(rest, inline)
    if verb not in VERBS:
        raise WrongCommandError(f"{verb}: no executable of the package")
    at = rest.index("--ros-args") if "--ros-args" in rest else len(rest)
    check_own(verb, rest[:at], inline)
    check_ros([verb], rest[at + 1:])


def check_launch(words: Sequence[str]) -> None:
    file, *arguments = words or [""]
    if file != LAUNCH.name:
        raise WrongCommandError(f"{file}: no launch file of the package")
    # A parameter file of the user need not exist.
    config = f"params_file:={ROOT}/config/sphere.yaml"
    words = [config if word.startswith("params_file:=") else word for word in arguments]
    started(
        *(word for word in words if not word.startswith("-")), installed=["rviz2", "nav2_msgs"]
    )


def check_assignment(word: str) -> None:
    """Check name:=value in running text, which is an argument of launch or a parameter."""
    try:
        check_launch([LAUNCH.name, word])
    except REFUSALS as error:
        if "not an argument" not in str(error):
            raise
        name, _, value = word.partition(":=")
        if not name.startswith("__"):
            check_parameter(list(SETTINGS), name, value)


def operands(words: Sequence[str]) -> Iterator[str]:
    """Yield the words of a ros2 command that are neither options nor their values."""
    rest = iter(words)
    for word in rest:
        if word in WITH_VALUE:
            next(rest)
        elif not word.startswith("-"):
            yield word
        elif word not in FLAGS:
            raise WrongCommandError(f"{word}: not an option")


def type_of(name: str, given: str = "") -> str:
    """Return the documented type of a topic or service."""
    kinds = types_of(name)
    if not kinds:
        raise WrongCommandError(f"{name}: not in msg_docs/topics.md")
    for kind in sorted(kinds):
        if given in ("", kind, re.sub("/(msg|srv|action)/", "/", kind)):
            return kind
    raise WrongCommandError(f"{name}: given the type {given}, expected {' or '.join(kinds)}")


def check_content(name: str, given: str = "", values: str = "{}", *rest: str) -> None:
    """Check type and content of a message on a topic, of a request or of an action's goal."""
    package, group, kind = type_of(name, given).split("/")
    found = getattr(import_module(f"{package}.{group}"), kind)
    part = next((it for it in ("Request", "Goal") if hasattr(found, it)), None)
    content = getattr(found, part) if part else found
    fill(content(check_fields=True), yaml.safe_load(values))


def fill(message: Any, values: Any) -> None:
    """Set the fields of a message as `ros2 topic pub` does."""
    fields = message.get_fields_and_field_types()
    for name, value in values.items():
        if name not in fields:
            raise WrongCommandError(f"{type(message).__name__} has no field {name}")
        if value in ("auto", "now"):  # a header or time
            continue
        current = getattr(message, name)
        if isinstance(value, dict):
            fill(current, value)
        elif part := re.fullmatch(r"sequence<(\w+)/(\w+)>", fields[name]):
            kind = getattr(import_module(f"{part[1]}.msg"), part[2])
            setattr(message, name, [kind(check_fields=True) for _ in value])
            for item, of_item in zip(getattr(message, name), value, strict=True):
                fill(item, of_item)
        elif isinstance(current, array):
            setattr(message, name, array(current.typecode, value))
        else:
            setattr(message, name, float(value) if isinstance(current, float) else value)


def check_ros2(words: Sequence[str], inline: bool) -> None:
    """Check a ros2 command of a topic, service, action, parameter, bag, node or launch file."""
    group, verb, *rest = [*words, "", ""][:max(2, len(words))]
    command = f"{group} {verb}".strip()
    # Such as `ros2 bag record -a` in a sentence about it.
    if command.startswith(NOT_CHECKED) or (inline and all(w.startswith("-") for w in rest)):
        return
    if command in ("run sphere_nmpc", "launch sphere_nmpc"):
        return check_verb(rest, inline) if group == "run" else check_launch(rest)
    given = list(operands(rest))
    if command in ("topic pub", "service call"):
        check_content(*given)
        if given[0].endswith(GOALS) and {"-1", "--once"} & {*rest}:
            raise WrongCommandError("--once: perhaps before the controller is matched, give -t 3")
    elif command in ("topic echo", "topic hz", "topic info"):
        type_of(*given)
    elif command == "action send_goal":
        navigation_messages.provide()
        check_content(*given)
    elif command in ("param set", "param get"):
        check_parameter([given[0].split("/")[-1]], *given[1:], live=verb == "set")
    elif command == "bag record":
        for topic in {*given} - {*OF_ROSBAG2}:
            type_of(topic)
    else:
        raise WrongCommandError("a new kind of command: add a check, or name it in NOT_CHECKED")


def check(command: Command) -> None:
    """Check a command of this package or of ros2; others are not checked."""
    first, *rest = command.words
    if first == "sphere_nmpc":
        check_verb(rest, command.inline)
    elif first == "ros2":
        check_ros2(rest, command.inline)
    elif first == "make":
        if rest[:1] and rest[0] not in TARGETS:
            raise WrongCommandError(f"{rest[0]}: no target of make")
        for word in rest:
            name, _, value = word.partition("=")
            if name == "ARGS" and rest[0] in ("demo", "faults"):
                check_own(rest[0], shlex.split(value), False)
    elif first in ("python", "python3") and rest[:2] == ["-m", MODULE]:
        at = rest.index("--ros-args")
        check_own(MODULE, rest[2:at], command.inline)
        check_ros(["simulator"], rest[at + 1:])
    elif first in ("python", "python3") and rest[0].endswith(".py"):
        if not rest[0].startswith("/") and not (ROOT / rest[0]).exists():
            raise WrongCommandError(f"{rest[0]}: no script of the package")
    elif first in ("--ros-args", "-p", "-r"):
        check_ros(list(SETTINGS), [word for word in command.words if word != "--ros-args"])
    elif ":=" in first:
        check_assignment(first)


def test_commands_in_documents_are_understood(monkeypatch) -> None:
    # As with the package of the examples installed.
    monkeypatch.setitem(STRATEGIES, "roll_to", StrategyEntry("own_strategy:RollTo"))
    monkeypatch.setitem(PLANTS, "lagging", Entry("own_plant:Lagging"))
    wrong, found = [], all_commands()
    for command in found:
        try:
            check(command)
        except REFUSALS as error:
            wrong.append(f"{command}\n    {error}")
    assert not wrong, "\n".join(wrong)
    assert len({command.words[0] for command in found}) > 5


@pytest.mark.parametrize(
    ("line", "wrong"),
    [
        ("ros2 run sphere_nmpc fly", "fly: no executable"),
        ("sphere_nmpc report bag", "required: --out"),
        ("make demo ARGS='--case 9'", "invalid choice: 9"),
        ("sphere_nmpc controller --ros-args -p strateggy:=paper", "no parameter strateggy"),
        ("sphere_nmpc simulator --ros-args -p robot.shell_mass:=0.0", "shell_mass: given 0.0"),
        ("ros2 launch sphere_nmpc sphere.launch.py rvis:=true", "rvis: not an argument"),
        ("ros2 topic pub -t 3 /goal geometry_msgs/msg/PoseStamped", "/goal: not in"),
        ("ros2 service call /simulator/pause std_srvs/srv/SetBool '{data: a}'", "'data' field"),
        ("ros2 topic pub -t 3 /goals nav_msgs/msg/Goals '{goals: [{x: 1}]}'", "has no field x"),
        ("ros2 topic pub --once /goal_point geometry_msgs/msg/PointStamped", "--once: perhaps"),
        ("ros2 param set /controller horizon 5", "cannot be changed while it runs"),
        ("ros2 action list", "a new kind of command"),
        ("make tea", "no target of make"),
        ("python bench/none.py", "no script"),
        ("python3 -m sphere_sim.ros.simulator.robot_description --mjfc x --ros-args",
         "unrecognized arguments: --mjfc"),
    ],
)
def test_wrong_command_is_refused(line, wrong) -> None:
    (command,) = commands("a.md", f"```\n{line}\n```\n")
    with pytest.raises(REFUSALS, match=wrong):
        check(command)


def test_sample_bag_is_small_and_has_a_run_that_arrives_and_what_draws_it() -> None:
    sample = ROOT / "docs" / "sample"
    assert sum(file.stat().st_size for file in sample.iterdir()) < 300_000
    run = read_run(sample)
    assert run.notes == () and run.metrics().settled
    with Reader(sample) as reader:
        found = {it.topic: it.msgcount for it in reader.connections}
    page = (ROOT / "docs" / "open_a_bag.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (`/.*?) \|", page, re.MULTILINE)
    listed = {topic for row in rows for topic in re.findall("`(.+?)`", row)}
    assert len(listed) > 10 and all(found[topic] for topic in listed)


def test_documents_have_each_kind_of_condition_with_its_level() -> None:
    """Modes are in the glossary, warnings in the document on them, the rest with the topics."""
    glossary, warnings, topics = (
        (ROOT / name).read_text(encoding="utf-8")
        for name in ("docs/glossary.md", "docs/when_it_does_not_move.md", "msg_docs/topics.md")
    )
    row = re.compile(r"^\| ([^|]+?) \| (OK|WARN|STALE|ERROR) \|", re.MULTILINE)
    modes = row.findall(glossary)
    assert [(kind.value, kind.severity.name) for kind in Kind][: len(modes)] == modes
    told = {(words.partition(": ")[0], level) for words, level in row.findall(warnings)}
    kinds = {(kind.log, kind.severity.name) for kind in Kind}
    topic = re.compile(r"(publisher of|type on|QoS on) .*")
    assert {(topic.sub(r"\1 …", words), level) for words, level in told} <= kinds
    for kind in list(Kind)[len(modes) :]:
        assert kind.log in (topics if kind.is_unreachable else warnings)


def anchors(document: Path) -> set[str]:
    """Return the anchors of the headings, as they are made on web pages."""
    headings = re.findall(r"^#+ (.+)$", document.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", h.lower()).replace(" ", "-") for h in headings}


def test_targets_of_links_exist() -> None:
    broken = [
        f"{document.name}: {link}" for document in DOCUMENTS
        for link in map("".join, LINK.findall(document.read_text("utf-8")))
        if not re.match(r"[a-z]+:", link) and not target_exists(document, link)
    ]
    assert not broken


def target_exists(document: Path, link: str) -> bool:
    file, _, heading = link.partition("#")
    target = (document.parent / file).resolve() if file else document
    return target.exists() and (not heading or heading in anchors(target))
