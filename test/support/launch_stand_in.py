# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Stand-ins for launch that record what the launch file creates, where launch is not installed."""

import sys
from collections.abc import Iterable, Sequence
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any
from unittest.mock import patch

ROOT = Path(__file__).parents[2]
LAUNCH = ROOT / "launch" / "sphere.launch.py"
URDF = ROOT / "urdf" / "sphere.urdf"
ON_COMMAND_LINE = ("ros2", "launch", "sphere_nmpc", LAUNCH.name)
KNOWN = {
    "Node": {
        "executable", "package", "name", "namespace", "exec_name", "parameters", "remappings",
        "ros_arguments", "arguments", "output", "respawn", "respawn_delay",
    },
    "ExecuteProcess": {"cmd", "output"},
    "DeclareLaunchArgument": {"default_value", "description", "choices"},
    "OpaqueFunction": {"function"},
    "RegisterEventHandler": set(),
    "OnProcessExit": {"on_exit"},
    "OnProcessIO": {"on_stderr"},
    "Shutdown": {"reason"},
    "ParameterValue": {"value_type"},
}
"""Keywords of launch and launch_ros in Jazzy."""


class Made:
    """Launch action made by the launch file, with its positional and keyword arguments."""

    def __init__(self, *values: Any, **named: Any) -> None:
        kind = type(self).__name__
        assert named.keys() <= KNOWN[kind], f"{kind} does not know all of {sorted(named)}"
        self.values, self.named = values, named

    def __getitem__(self, name: str) -> Any:
        return self.named[name]

    @property
    def name(self) -> str:
        """Name of an argument, as in launch."""
        return self.values[0]


def _modules(installed: Iterable[str]) -> dict[str, ModuleType]:
    def find(package: str) -> str:
        if package not in (*installed, "sphere_nmpc"):
            raise LookupError(package)
        return ""

    made = {name: type(name, (Made,), {}) for name in KNOWN}
    contents = {
        "launch": {"LaunchContext": object, "LaunchDescription": list},
        "ament_index_python.packages": {
            "PackageNotFoundError": LookupError,
            "get_package_prefix": find,
            "get_package_share_directory": lambda package: str(ROOT),
        },
        "launch_ros": {},
        "ament_index_python": {},
        **dict.fromkeys(
            ("launch.actions", "launch.event_handlers", "launch_ros.actions",
             "launch_ros.parameter_descriptions"), made,
        ),
    }
    modules = {name: ModuleType(name) for name in contents}
    for name, content in contents.items():
        vars(modules[name]).update(content)
    return modules


def started(
    *words: str, installed: Iterable[str] = (), pushed: str = "",
    command: Sequence[str] = ON_COMMAND_LINE, looks: bool = False,
) -> list[Made]:
    """Return what the launch file starts, given launch arguments as ``name:=value``.

    `installed` are ROS packages besides this one, `pushed` is the namespace of an including file
    and `command` are the words before the arguments. With `looks` the file looks for other nodes
    and the parameters of the robot, each by a process that takes a second. A refused argument is a
    `RuntimeError`.
    """
    with patch.dict(sys.modules, _modules(installed)), patch.object(
        sys, "argv", [*command, *words]
    ):
        file = _loaded()
        if not looks:
            file.refuse_other_nodes = lambda place, clock: None
            file.robot_description = lambda params, place: URDF.read_text("utf-8")
        *declared, function = file.generate_launch_description()
        given = dict(word.split(":=", 1) for word in words)
        value = {}
        for argument in declared:
            value[argument.name] = given.pop(argument.name, argument["default_value"])
            choices = argument["choices"]
            if choices and value[argument.name] not in choices:
                raise RuntimeError(f"{argument.name}: expected one of {choices}")
        configurations = {**given, **value, **({"ros_namespace": pushed} if pushed else {})}
        context = SimpleNamespace(argv=list(words), launch_configurations=configurations)
        return function["function"](context)


def _loaded() -> ModuleType:
    spec = spec_from_file_location("sphere_launch", LAUNCH)
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
