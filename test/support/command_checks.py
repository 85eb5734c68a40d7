# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Checks of command lines of the package's own executables, nodes and launch file."""

import argparse
import contextlib
import dataclasses
import io
import re
from collections.abc import Callable, Sequence
from typing import Any, NoReturn

import faults
import yaml
from launch_stand_in import LAUNCH, ROOT, started
from parameter_tables import NODES, PARTS

from sphere_nmpc.errors import SphereNmpcError
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.quantity import quantities
from sphere_nmpc.ros.settings import FrameSettings
from sphere_sim.cli import benchmark, demo, report, study, viewer
from sphere_sim.cli.main import VERBS
from sphere_sim.recording.recorder_settings import RecorderSettings
from sphere_sim.ros.session import goal_command

PARSERS: dict[str, Callable[[Sequence[str]], object]] = {
    "demo": demo.parse,
    "goal": goal_command.parse,
    "viewer": viewer._parse,
    "study": lambda words: study._parser().parse_args(words),
    "benchmark": benchmark._parse,
    "report": report._parse,
    "faults": faults._parse,
}
"""Parser of each verb, and of `make faults`; the other verbs take the arguments of ROS only."""
SETTINGS: dict[str, dict[str, Any]] = {
    **{
        node: {"": settings, "robot": RobotParameters()}
        | {prefix: more for prefix, _, more in PARTS[node] if prefix}
        for node, settings in NODES.items()
    },
    "recorder": {"": RecorderSettings()},
    "goal": {}, "viewer": {"": FrameSettings()}, "markers": {"": FrameSettings()},
}
"""Settings of each node by the prefix of their names."""
ROOTLESS = {
    node: [more for prefix, _, more in parts if not prefix] for node, parts in PARTS.items()
}
"""Further settings of a node whose names have no prefix."""


class WrongCommandError(AssertionError):
    """A documented command that would be refused or have no effect."""


class UnknownParameterError(WrongCommandError):
    """A parameter that the node does not declare."""


def check_value(node: str, name: str, text: str, live: bool = False) -> None:
    """Check a value for a parameter of a node as YAML 1.1 reads it."""
    value = yaml.safe_load(text)
    if name == "use_sim_time":
        if not isinstance(value, bool):
            raise WrongCommandError(f"{name}: given {text}, expected true or false")
        return
    if (node, name) == ("recorder", "topics"):
        return
    settings, field = settings_of(node, name)
    about = quantities(settings)[field]
    if live and not about.live:
        raise WrongCommandError(f"{name} of {node} cannot be changed while it runs")
    try:
        dataclasses.replace(settings, **{field: tuple(value) if type(value) is list else value})
    except SphereNmpcError as error:
        raise WrongCommandError(str(error)) from None


def settings_of(node: str, name: str) -> tuple[Any, str]:
    """Return the settings that a parameter is in, and its name there."""
    if node not in SETTINGS:
        raise WrongCommandError(f"there is no node {node}")
    prefix, _, field = name.rpartition(".")
    homes = [SETTINGS[node].get(prefix), *(ROOTLESS.get(node, []) if not prefix else [])]
    for settings in homes:
        if settings is not None and field in quantities(settings):
            return settings, field
    raise UnknownParameterError(f"{node} has no parameter {name}")


def check_own(verb: str, words: Sequence[str], inline: bool) -> None:
    """Check the arguments of a verb by its own parser."""
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


class Options(argparse.ArgumentParser):
    """Parser of options of other programs."""

    def __init__(self) -> None:
        super().__init__(add_help=False, allow_abbrev=False)

    def error(self, message: str) -> NoReturn:
        """Refuse the command instead of ending the process."""
        raise WrongCommandError(message)


def check_ros(node: str | None, words: Sequence[str]) -> None:
    """Check arguments after --ros-args; without a node, one with such parameters must exist."""
    parser = Options()
    for names in (("-p", "--param"), ("-r", "--remap")):
        parser.add_argument(*names, action="append", default=[], dest=names[1][2:])
    for name in ("--params-file", "--enclave", "--log-level"):
        parser.add_argument(name)
    given = parser.parse_args([word for word in words if word != "--"])
    for assignment in (*given.param, *given.remap):
        if ":=" not in assignment:
            raise WrongCommandError(f"given {assignment}, expected name:=value")
    for assignment in given.param:
        name, _, value = assignment.partition(":=")
        check_for_some_node([node] if node else list(SETTINGS), name, value)


def check_for_some_node(nodes: Sequence[str], name: str, value: str) -> None:
    for node in nodes:
        with contextlib.suppress(UnknownParameterError):
            return check_value(node, name, value)
    raise UnknownParameterError(f"{' or '.join(nodes)} has no parameter {name}")


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
    check_ros(verb, rest[at + 1:])


def check_launch(words: Sequence[str]) -> None:
    file, *arguments = words or [""]
    if file != LAUNCH.name:
        raise WrongCommandError(f"{file}: no launch file of the package")
    # A parameter file of the user need not exist.
    config = f"params_file:={ROOT}/config/sphere.yaml"
    words = [config if word.startswith("params_file:=") else word for word in arguments]
    try:
        started(*(word for word in words if not word.startswith("-")), installed=["rviz2"])
    except (RuntimeError, ValueError) as error:
        raise WrongCommandError(str(error)) from None
