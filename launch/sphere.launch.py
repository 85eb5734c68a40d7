# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Launch file of simulator and controller, optionally with recording, RViz and viewer.

ros2 launch sphere_nmpc sphere.launch.py record:=true viewer:=true rviz:=true namespace:=second

An unknown argument, a missing package, or nodes on the same topics that run already, are reported
in one line, and nothing is started. Values are passed on to the nodes, which refuse a wrong one in
one line and end; a process that ends ends the launch, see `Ending`.
"""

import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from datetime import datetime
from itertools import pairwise
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import yaml
from ament_index_python.packages import (
    PackageNotFoundError,
    get_package_prefix,
    get_package_share_directory,
)
from launch.actions import (
    DeclareLaunchArgument,
    ExecuteProcess,
    OpaqueFunction,
    RegisterEventHandler,
    Shutdown,
)
from launch.event_handlers import OnProcessExit, OnProcessIO
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from launch import LaunchContext, LaunchDescription
from sphere_nmpc.errors import InvalidStateError
from sphere_nmpc.estimation.imu import ImuSettings
from sphere_nmpc.foreign.file import InvalidFileError, find_file
from sphere_nmpc.model.state import upright_state
from sphere_nmpc.process.child import module_command
from sphere_nmpc.quantities import quantities
from sphere_nmpc.ros.cdr import WORLD_FRAME
from sphere_nmpc.settings import STRATEGIES
from sphere_sim.output.round_numbers import grid_cell
from sphere_sim.recording.recorder_settings import DEFAULT_TOPICS
from sphere_sim.ros.session.other_publishers import FOUND, TOPICS
from sphere_sim.viewer.source import DEFAULT_RADIUS
from sphere_sim.world.settings import PLANTS, SimulatorSettings

PACKAGE = "sphere_nmpc"
SHARE = Path(get_package_share_directory(PACKAGE))
STATE_PUBLISHER = "robot_state_publisher"
ACTIONS = "nav2_msgs"
RECORDED = (
    "pose", "odom", "joint_states", "rotor_trajectory", "rotor_commands", "control_period",
    "controller/active_goal", "controller/at_goal", "controller/eta", "controller/floor",
    "controller/path", "controller/predicted_path", "controller/status", "simulator/pushed",
    "robot_description",
)
"""Topics, without goal_pose, goal_point, goals, path, map, keepout, simulator/push: `ros2 topic
pub --once` ends after the first matched subscription, which has to be the one that is meant. The
accepted goals are in active_goal, paths in controller/path, map and areas to keep out of in floor,
the pushes in pushed. Without imu, which is read only while it has a subscription."""
OF_ODOMETRY = (
    "imu", "pose_fix", "odometry/status", "ground_truth/pose", "ground_truth/odom",
)
"""Recorded as well with an odometry node, with which the IMU is read in any case."""
ABSOLUTE = ("/clock", "/diagnostics", "/rosout", "/parameter_events", "/tf", "/tf_static")
TRUE = ("true", "True", "1")
BOOLEAN = ["true", "false", "True", "False", "1", "0"]
OF_LAUNCH = (
    "launch-prefix", "launch-prefix-filter", "emulate_tty", "sigterm_timeout", "sigkill_timeout",
)
"""Arguments that launch itself reads."""
RVIZ_LENGTHS = {
    "Axes Length", "Axes Radius", "Distance", "Line Width", "Marker Scale", "Position Tolerance",
    "X", "Y", "Z",
}
RVIZ_FRAMES = {"Fixed Frame", "Reference Frame", "Target Frame"}
"""Entries of a configuration of RViz that are lengths, and names of frames."""
RESPAWN_DELAY = 2.0
"""Time between the end of a process and its restart [s]."""
RESPAWN_MEMORY = 30.0
"""Time after its end within which a restarted controller continues to its goal [s]: the delay, and
the start of a node on a slow machine."""
ARGUMENTS: dict[str, tuple[str, Sequence[str] | None, str]] = {
    "strategy": ("", ["", *STRATEGIES], "Strategy of the controller; empty: as in params_file"),
    "plant": ("", ["", *PLANTS], "Plant of the simulator; empty: as in params_file"),
    "real_time_factor": ("", None, "Simulated over wall time, 0 is as fast as possible; empty: as "
                         "in params_file"),
    "clock": ("simulated", ["simulated", "system"], "Clock of all nodes, in place of that in "
              "params_file: the simulator's or the system's"),
    "use_sim_time": ("", ["", *BOOLEAN], "Whether all nodes but the simulator follow its clock; "
                     "empty: with clock:=simulated"),
    "initial_state": ("", None, "Start of the sphere: X,Y,YAW [m, rad], or X,Y,QW,QX,QY,QZ; "
                      "empty: as in params_file"),
    "map": ("", None, "Map file of simulator and controller, YAML of map_server; empty: as in "
            "params_file"),
    "world_frame": (WORLD_FRAME, None, "Frame of poses, goals and plans, in place of that in "
                    "params_file, and fixed frame of RViz"),
    "namespace": ("", None, "Namespace of the robot's topics and clock, and prefix of its frames"),
    "params_file": (str(SHARE / "config" / "sphere.yaml"), None, "Parameters of both nodes"),
    "record": ("false", BOOLEAN, "Write a bag"),
    "rviz": ("false", BOOLEAN, "Start RViz"),
    "viewer": ("false", BOOLEAN, "Serve the page of the viewer"),
    "odometry": ("false", BOOLEAN, "Estimate the poses from the IMU in the simulated sphere, "
                 "whose own are then on ground_truth/pose"),
    "navigator": ("false", BOOLEAN, "Offer the actions of Nav2, for which nav2_msgs is needed"),
    "respawn": ("false", BOOLEAN, "Restart nodes that have ended, rather than end the launch; a "
                "controller then continues to its goal"),
}
"""Default, choices and description of each argument."""


def generate_launch_description() -> LaunchDescription:
    arguments = [
        DeclareLaunchArgument(name, default_value=default, choices=choices, description=text)
        for name, (default, choices, text) in ARGUMENTS.items()
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=actions)])


def actions(context: LaunchContext) -> list:
    """Return the actions to start."""
    refuse_unknown(context.argv)
    value = {name: context.launch_configurations[name] for name in ARGUMENTS}
    params = existing_parameters(value["params_file"])
    # A file that includes this one may have pushed a namespace.
    outer = context.launch_configurations.get("ros_namespace", "")
    inner = value["namespace"]
    place = (inner if inner.startswith("/") else f"{outer}/{inner}").strip("/")
    prefix = {"frame_prefix": f"{place}/"} if place else {}
    clock = {"use_sim_time": follows_clock(value["clock"], value["use_sim_time"])}
    frame = {"world_frame": value["world_frame"]}
    simulator = {"clock": value["clock"], **frame, **prefix}
    if plant := value["plant"]:
        simulator["plant"] = plant
    if factor := value["real_time_factor"]:
        simulator["real_time_factor"] = number(factor)
    given = value["initial_state"]
    start = {"initial_state": initial_state(given)} if given else {}
    simulator |= start
    following = {**clock, **frame}
    controller = dict(following)
    if given := value["map"]:
        simulator["map_file"] = controller["map_file"] = given
    if strategy := value["strategy"]:
        controller["strategy"] = strategy
    record, viewer, shown, navigator, respawn = (
        value[name] in TRUE for name in ("record", "viewer", "rviz", "navigator", "respawn")
    )
    controller |= {"goal_memory": RESPAWN_MEMORY} if respawn else {}
    has_odometry = value["odometry"] in TRUE
    simulator |= {"pose_source": "odometry"} if has_odometry else {}
    for argument, wanted, package in (("rviz", shown, "rviz2"), ("navigator", navigator, ACTIONS)):
        if wanted and not is_installed(package):
            distribution = os.environ.get("ROS_DISTRO", "jazzy")
            remedy = f"apt install ros-{distribution}-{package.replace('_', '-')}"
            raise RuntimeError(f"{argument}:=true: '{package}' is not installed; {remedy}")
    refuse_other_nodes(place, value["clock"])
    common = {"namespace": f"/{place}", "output": "screen"}
    # The nodes of this package use the clock of their namespace; those of others are remapped.
    remapped = {**common, "remappings": [("/clock", "clock")]}
    own = {**common, "package": PACKAGE}
    own |= {"respawn": True, "respawn_delay": RESPAWN_DELAY} if respawn else {}
    nodes = [
        # The simulator publishes the clock: it must not wait for it.
        Node(executable="simulator", parameters=[params, simulator], **own),
        Node(executable="controller", parameters=[params, controller], **own),
    ]
    if has_odometry:
        nodes.append(Node(executable="odometry", parameters=[
            params, {**of_simulator(params), **start, **following, **prefix},
        ], **own))
    urdf = robot_description(params, place) if shown or is_installed(STATE_PUBLISHER) else ""
    if is_installed(STATE_PUBLISHER):
        # Without a type launch reads the text as YAML, which the colon of a comment makes invalid.
        model = {"robot_description": ParameterValue(urdf, value_type=str), **clock, **prefix}
        nodes.append(Node(package=STATE_PUBLISHER, executable=STATE_PUBLISHER,
                          parameters=[model], **remapped))
    if navigator:
        nodes.append(Node(executable="navigator", parameters=[params, following], **own))
    if record:
        nodes.append(recording(params, clock, own, place, OF_ODOMETRY if has_odometry else ()))
    if viewer:
        nodes.append(Node(executable="viewer", parameters=[frame], **own))
    if shown:
        nodes.append(Node(executable="markers", parameters=[frame], **own))
        nodes.append(rviz(urdf, clock, frame["world_frame"], remapped))
    return nodes if respawn else [*Ending(nodes).handlers(), *nodes]


class Ending:
    """End of the launch with one of its processes, and the reason as the last line.

    Simulator and controller, which come first, end it in whatever way they end, the others by an
    error.
    """

    def __init__(self, processes: Sequence[ExecuteProcess]) -> None:
        self._needed = processes[:2]
        self._running = list(processes)
        self._said: dict[str, str] = {}
        self._ended: Any = None

    def handlers(self) -> list[RegisterEventHandler]:
        """Return the handlers of output and end of the processes."""
        heard, ended = OnProcessIO(on_stderr=self._hear), OnProcessExit(on_exit=self._end)
        return [RegisterEventHandler(heard), RegisterEventHandler(ended)]

    def _hear(self, event: Any) -> None:
        """Keep the last line that a process has printed."""
        if lines := event.text.decode(errors="replace").strip().splitlines():
            self._said[event.process_name] = lines[-1]

    def _end(self, event: Any, context: LaunchContext) -> Shutdown | None:
        """End the launch with a process that has ended, and report it behind the last one."""
        if event.action not in self._running:
            return None  # of a file that includes this one
        self._running.remove(event.action)
        is_fault = not context.is_shutdown and (event.returncode or event.action in self._needed)
        is_first = is_fault and self._ended is None
        self._ended = event if is_first else self._ended
        if self._ended and not self._running:
            name, code = self._ended.process_name, self._ended.returncode
            how = f"by signal {-code}" if code < 0 else f"with exit code {code}"
            said = f": {self._said[name]}" if code > 0 and name in self._said else ""
            # Only after an exception, which it logs, launch itself ends with another code than 0.
            raise RuntimeError(f"{name} has ended {how}, and the launch with it{said}")
        return Shutdown(reason=f"{event.process_name} has ended") if is_first else None


def refuse_unknown(given: Sequence[str]) -> None:
    """Refuse unknown arguments, which ros2 launch ignores without a message."""
    # The command line of a file that includes this one has arguments of its own.
    if not any(is_this_file(*words) for words in pairwise(sys.argv)):
        return
    names = (word.partition(":=")[0] for word in given)
    unknown = [name for name in names if name not in (*ARGUMENTS, *OF_LAUNCH)]
    if unknown:
        known = ", ".join(ARGUMENTS)
        raise RuntimeError(f"{', '.join(unknown)}: not an argument; known are {known}")


def is_this_file(package: str, file: str) -> bool:
    """Return whether two consecutive words, or the second alone, name this file."""
    here = Path(__file__)
    return (package, file) == (PACKAGE, here.name) or (
        Path(file).name == here.name and Path(file).exists() and here.samefile(file)
    )


def refuse_other_nodes(place: str, clock: str) -> None:
    """Refuse to start beside nodes of this namespace that publish the same topics."""
    topics = [topic for topic in TOPICS if topic != "clock" or clock == "simulated"]
    look = module_command("sphere_sim.ros.session.other_publishers", f"/{place}", *topics)
    done = subprocess.run(look, stdout=subprocess.PIPE, text=True, check=False)
    if done.returncode == FOUND:
        raise RuntimeError(
            f"{done.stdout.strip()}: running already in ROS domain "
            f"{os.environ.get('ROS_DOMAIN_ID') or 0}, where clocks and commands would mix; end "
            "them, or give namespace:=NAME or another ROS_DOMAIN_ID"
        )


def existing_parameters(given: str) -> str:
    """Return the absolute path of the file of parameters; launch_ros would do without it."""
    try:
        return str(find_file(Path(given)))
    except InvalidFileError as error:
        raise RuntimeError(f"params_file: {error}") from None


def follows_clock(clock: str, given: str) -> bool:
    if clock == "system" and given in TRUE:
        expected = "false with clock:=system, where no node publishes a clock"
        raise RuntimeError(f"use_sim_time: given {given}, expected {expected}")
    return given in TRUE if given else clock == "simulated"


def number(text: str) -> float | str:
    """Return a number, as launch_ros keeps text as text; what is none the node refuses."""
    try:
        return float(text)
    except ValueError:
        return text


def initial_state(text: str) -> list[float]:
    """Return the parameter of the simulator, which may be given as x, y and yaw."""
    words = text.strip("[] ").replace(",", " ").split()
    try:
        if len(words) == 3:
            return upright_state(*map(float, words)).tolist()
        if len(words) == 6:
            return [float(word) for word in words]
    except InvalidStateError as error:
        raise RuntimeError(f"initial_state: given {text}: {error}") from None
    except ValueError:
        pass  # a word that is no number
    raise RuntimeError(
        f"initial_state: given {text!r}, expected the numbers X,Y,YAW or X,Y,QW,QX,QY,QZ"
    )


def robot_description(params: str, place: str) -> str:
    """Return the model of the simulator's robot with a file of parameters."""
    look = module_command(
        "sphere_sim.ros.simulator.robot_description", "--ros-args", "--params-file", params,
        "-r", f"__ns:=/{place}",
    )
    done = subprocess.run(look, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"robot of {params}: {done.stderr.strip()}")
    return done.stdout


def of_simulator(params: str) -> dict[str, Any]:
    """Return start, IMU and robot of the simulator with a file of parameters, for the odometry."""
    given: dict[str, Any] = {}
    for name, node in yaml.safe_load(Path(params).read_text(encoding="utf-8")).items():
        if name.rpartition("/")[2] in ("simulator", "**"):
            given |= node.get("ros__parameters", {})
    found = {"initial_state": list(SimulatorSettings().initial_state)}
    found |= {name: given[name] for name in ("initial_state", "imu", "robot") if name in given}
    if "imu" in found:  # rate and latency are those of a simulated one
        known = quantities(ImuSettings())
        found["imu"] = {name: value for name, value in found["imu"].items() if name in known}
    return found


def recording(
    params: str, clock: dict[str, bool], own: dict[str, Any], place: str, more: Sequence[str]
) -> Node | ExecuteProcess:
    """Return rosbag2's recorder if installed, else the package's own; the format is the same.

    `more` are relative topics besides those of every run.
    """
    # rosbag2 cannot use the clock of a namespace.
    if place or not (is_installed("ros2bag") and is_installed("rosbag2_storage_mcap")):
        topics = {"topics": [*DEFAULT_TOPICS, *more]} if more else {}
        return Node(executable="recorder", parameters=[params, {**clock, **topics}], **own)
    topics = [f"/{topic}" for topic in (*RECORDED, *more)] + list(ABSOLUTE)
    folder = f"runs/{datetime.now():%Y-%m-%d_%H-%M-%S}"
    follow = ["--use-sim-time"] if clock["use_sim_time"] else []
    return ExecuteProcess(
        cmd=["ros2", "bag", "record", "-s", "mcap", "-o", folder, *follow, "--topics", *topics],
        output="screen",
    )


def rviz(urdf: str, clock: dict[str, bool], frame: str, remapped: dict[str, object]) -> Node:
    """Return RViz with a view in the size of the robot."""
    radius = float(next(ElementTree.fromstring(urdf).iter("sphere")).attrib["radius"])
    shipped = yaml.safe_load((SHARE / "rviz" / "sphere.rviz").read_text(encoding="utf-8"))
    with tempfile.NamedTemporaryFile("w", suffix=".rviz", delete=False) as config:
        config.write(yaml.safe_dump(adapted(shipped, radius, frame), sort_keys=False))
    return Node(
        package="rviz2", executable="rviz2", arguments=["-d", config.name], parameters=[clock],
        **remapped,
    )


def adapted(value: Any, radius: float, frame: str) -> Any:
    """Return part of a configuration of RViz for another radius [m] and name of the frame."""
    if isinstance(value, list):
        return [adapted(item, radius, frame) for item in value]
    if not isinstance(value, dict):
        return value
    found = {name: adapted(item, radius, frame) for name, item in value.items()}
    for name in RVIZ_LENGTHS & found.keys():
        found[name] *= radius / DEFAULT_RADIUS
    found |= dict.fromkeys(RVIZ_FRAMES & found.keys(), frame)
    if "Cell Size" in found:
        found["Cell Size"] = grid_cell(radius)
    return found


def is_installed(package: str) -> bool:
    try:
        get_package_prefix(package)
    except PackageNotFoundError:
        return False
    return True
