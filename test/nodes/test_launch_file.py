# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Actions of the launch file, which runs here with stand-ins for the launch package."""

import math
import re
import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree

import pytest
import yaml
from documented_topics import table
from launch_stand_in import LAUNCH, ROOT, Made, started
from parameter_tables import NODES, PARTS
from patience import until
from ros_graph import started as running

from sphere_nmpc.quantities import quantities
from sphere_sim.output.error_text import EXTRAS

pytestmark = pytest.mark.slow

OTHERS = ("robot_state_publisher", "rviz2", "ros2bag", "rosbag2_storage_mcap")
ALL = ("record:=true", "rviz:=true", "viewer:=true")
FRAME = {"world_frame": "world"}


def nodes(actions: list[Made]) -> dict[str, Made]:
    """Return the nodes by the names of their executables."""
    found = [action for action in actions if type(action).__name__ == "Node"]
    return {node["executable"]: node for node in found}


def parameters(node: Made) -> dict[str, object]:
    """Return the parameters of a node besides those of its parameter file."""
    merged: dict[str, object] = {}
    for part in node.named.get("parameters", []):
        merged |= part if isinstance(part, dict) else {}
    return merged


def recorders(actions: list[Made]) -> list[Made]:
    """Return the processes of rosbag2."""
    return [action for action in actions if type(action).__name__ == "ExecuteProcess"]


def test_other_packages_are_used_where_they_are_installed_and_asked_for() -> None:
    own = nodes(started("record:=true", "viewer:=1"))
    assert {node["package"] for node in own.values()} == {"sphere_nmpc"}
    assert own.keys() == {"simulator", "controller", "recorder", "viewer"}
    assert nodes(started("viewer:=False")).keys() == {"simulator", "controller"}
    actions = started(*ALL, installed=OTHERS)
    assert "navigator" not in nodes(actions)
    navigator = nodes(started("navigator:=true", installed=["nav2_msgs"]))["navigator"]
    assert parameters(navigator) == {"use_sim_time": True, **FRAME}
    assert "odometry" not in nodes(actions)
    assert {"robot_state_publisher", "rviz2"} <= nodes(actions).keys()
    assert recorders(actions)[0]["cmd"][:3] == ["ros2", "bag", "record"]


@pytest.mark.parametrize(("argument", "package"), [("rviz", "rviz2"), ("navigator", "nav2_msgs")])
def test_missing_package_is_named_before_anything_starts(argument, package) -> None:
    told = f"{argument}:=true: '{package}' is not installed; apt install ros-jazzy-"
    with pytest.raises(RuntimeError, match=told):
        started(f"{argument}:=true")


@pytest.mark.parametrize(
    ("words", "of_simulator", "of_controller"),
    [
        ((), {}, {}),
        (("map:=hall.yaml",), {"map_file": "hall.yaml"}, {"map_file": "hall.yaml"}),
        (("world_frame:=map",), {"world_frame": "map"}, {"world_frame": "map"}),
        (("respawn:=true",), {}, {"goal_memory": 30.0}),
        (("strategy:=paper", "plant:=rigid_body", "real_time_factor:=2"),
         {"plant": "rigid_body", "real_time_factor": 2.0}, {"strategy": "paper"}),
        (("real_time_factor:=fast",), {"real_time_factor": "fast"}, {}),
        (("initial_state:=1,-1,1.5707963267948966",),
         {"initial_state": pytest.approx([1.0, -1.0, math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)])},
         {}),
        (("initial_state:=[2, 0, 0, 1, 0, 0]",),
         {"initial_state": [2.0, 0.0, 0.0, 1.0, 0.0, 0.0]}, {}),
    ],
)
def test_arguments_become_parameters_of_the_nodes_behind_those_of_the_file(
    words, of_simulator, of_controller
) -> None:
    expected = {
        "simulator": {"clock": "simulated", **FRAME, **of_simulator},
        "controller": {"use_sim_time": True, **FRAME, **of_controller},
    }
    for name, node in nodes(started(*words)).items():
        own = (NODES[name], *(part[2] for part in PARTS[name]))
        known = {name for settings in own for name in quantities(settings)}
        assert parameters(node) == expected[name]
        assert parameters(node).keys() - {"use_sim_time"} <= known
        # The last value is used, so the arguments must follow the file.
        assert node["parameters"] == [str(ROOT / "config" / "sphere.yaml"), expected[name]]


def test_odometry_has_start_imu_and_robot_of_the_simulator(tmp_path) -> None:
    file = tmp_path / "mine.yaml"
    imu, robot = "{position: [0.1, 0.0, 0.0], rate: 200.0}", "{shell_radius: 0.25}"
    file.write_text(f"/**/simulator: {{ros__parameters: {{imu: {imu}, robot: {robot}}}}}")
    found = nodes(started(f"params_file:={file}", "odometry:=true", "namespace:=second"))
    assert parameters(found["simulator"])["pose_source"] == "odometry"
    assert parameters(found["odometry"]) == {
        "initial_state": [2.0, -3.0, 0.03, 0.454, 0.88, 0.1363], "use_sim_time": True, **FRAME,
        "imu": {"position": [0.1, 0.0, 0.0]}, "robot": {"shell_radius": 0.25},
        "frame_prefix": "second/",
    }
    found = nodes(started("odometry:=true", "initial_state:=1,-1,0"))
    start = parameters(found["odometry"])["initial_state"]
    assert start == parameters(found["simulator"])["initial_state"] == [1.0, -1.0, 1.0, 0, 0, 0]


def test_displays_have_the_world_frame_and_no_map() -> None:
    found = nodes(started(*ALL, "world_frame:=map", "map:=hall.yaml", installed=["rviz2"]))
    for name in ("viewer", "markers"):
        assert parameters(found[name]).get("map_file") is None
        assert parameters(found[name])["world_frame"] == "map"
    view = yaml.safe_load(Path(found["rviz2"]["arguments"][1]).read_text())
    assert view["Visualization Manager"]["Global Options"]["Fixed Frame"] == "map"
    assert "world" not in re.findall(r"Frame: (\w+)", yaml.safe_dump(view))


def test_nodes_that_are_restarted_do_not_end_the_launch() -> None:
    assert [action["respawn"] for action in started("respawn:=true")] == [True, True]


class Run:
    """Processes of a launch, whose ends are told to its handlers."""

    def __init__(self, *words: str) -> None:
        actions = started(*words)
        self.nodes = nodes(actions)
        events = [action.values[0] for action in actions if not action.named]
        (self._hear,) = (it["on_stderr"] for it in events if "on_stderr" in it.named)
        (self._end,) = (it["on_exit"] for it in events if "on_exit" in it.named)
        self.is_shutdown = False

    def ends(self, name: str, code: int, said: bytes = b"") -> bool:
        """End a process; return whether this shuts the launch down."""
        event = {"process_name": f"{name}-1", "action": self.nodes[name], "returncode": code}
        self._hear(SimpleNamespace(**event, text=said))
        return self._end(SimpleNamespace(**event), SimpleNamespace(is_shutdown=self.is_shutdown))


@pytest.mark.parametrize(
    ("first", "code", "how"),
    [
        ("simulator", 2, "with exit code 2, and the launch with it: [FATAL] plant: given 'cube'"),
        ("controller", -signal.SIGKILL, "by signal 9, and the launch with it"),
        ("recorder", 1, "with exit code 1, and the launch with it: [FATAL] plant: given 'cube'"),
    ],
)
def test_process_that_ends_ends_the_launch_with_the_reason_last(first, code, how) -> None:
    run = Run("record:=true")
    assert run.ends(first, code, b"[INFO] hello\n[FATAL] plant: given 'cube'\n")
    *others, last = [name for name in run.nodes if name != first]
    for name in others:
        assert not run.ends(name, 3)
    with pytest.raises(RuntimeError) as caught:
        run.ends(last, 0)
    assert str(caught.value) == f"{first}-1 has ended {how}"


def test_display_that_is_closed_and_an_interrupt_are_no_faults() -> None:
    run = Run("viewer:=true")
    assert not run.ends("viewer", 0)
    run.is_shutdown = True
    for name in ("simulator", "controller"):
        assert not run.ends(name, 0)


@pytest.mark.parametrize(
    ("words", "follows"),
    [([], True), (["clock:=system"], False), (["use_sim_time:=false"], False)],
)
def test_all_but_the_simulator_follow_its_clock_if_there_is_one(words, follows) -> None:
    for executable, node in nodes(started(*ALL, *words, installed=OTHERS[:2])).items():
        # Viewer and markers use wall time, so that they also show a stopped clock.
        expected = None if executable in ("simulator", "viewer", "markers") else follows
        assert parameters(node).get("use_sim_time") is expected


@pytest.mark.parametrize(
    ("namespace", "pushed", "place"),
    [("/second/", "", "second"), ("left", "fleet", "fleet/left"), ("/left", "fleet", "left"),
     ("", "fleet", "fleet"), ("", "", "")],
)
def test_namespace_makes_a_complete_robot(namespace, pushed, place) -> None:
    words = [f"namespace:={namespace}"] if namespace else []
    actions = started(*ALL, *words, installed=OTHERS, pushed=pushed)
    found = nodes(actions)
    assert {node["namespace"] for node in found.values()} == {f"/{place}"}
    for executable in ("simulator", "robot_state_publisher"):
        prefix = parameters(found[executable]).get("frame_prefix")
        assert prefix == (f"{place}/" if place else None)
    for node in found.values():
        # Nodes of the package use the clock of their namespace without a remapping.
        remapped = [("/clock", "clock")] if node["package"] != "sphere_nmpc" else None
        assert node.named.get("remappings") == remapped
    # rosbag2 would wait for /clock.
    assert bool(recorders(actions)) is not bool(place)
    assert ("recorder" in found) is bool(place)


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("plant:=cube", "plant"),
        ("clock:=system use_sim_time:=true", "use_sim_time: given true, expected false"),
        *(
            (f"initial_state:={given}", f"initial_state: given '{given}', expected the numbers X")
            for given in ("here", "1,2", "1,2,north", "1,2,3,4,5,6,7")
        ),
        ("initial_state:=1e9,0,0", "initial_state: given 1e9,0,0: position: given"),
        ("params_file:=none.yaml", "params_file: none.yaml: given no such file, expected an ex"),
        ("rvis:=true", "rvis: not an argument; known are strategy, plant"),
    ],
)
def test_wrong_argument_is_refused_in_one_line(words, expected) -> None:
    with pytest.raises(RuntimeError, match=re.escape(expected)) as caught:
        started(*words.split())
    assert "\n" not in str(caught.value)


def test_unknown_arguments_are_only_those_of_this_file() -> None:
    including = ["ros2", "launch", "my_robot", LAUNCH.name]
    assert nodes(started("colour:=red", command=including))
    assert nodes(started("launch-prefix:=gdb", "sigterm_timeout:=20"))


def test_it_is_refused_while_nodes_of_the_same_topics_run(capfd) -> None:
    with running("simulator", "-r", "__ns:=/left") as simulator:
        until(lambda: "ROS domain" in simulator.output)
        refused = r"/left/simulator: running already in ROS domain \d+"
        with pytest.raises(RuntimeError, match=refused):
            for _ in range(20):  # discovery may take longer on a busy machine
                started("namespace:=left", looks=True)
        assert nodes(started("namespace:=right", looks=True))
    assert not capfd.readouterr().err


def test_file_runs_without_the_python_packages_of_the_nodes() -> None:
    # These may be in a virtual environment, while `ros2 launch` is that of the system.
    of_extras = (name for extra, names in EXTRAS.items() if extra != "ros" for name in names)
    of_nodes = {"casadi", "scipy", *of_extras}
    code = (
        f"import sys; sys.path.insert(0, {str(ROOT / 'test' / 'support')!r}); "
        f"sys.modules.update(dict.fromkeys({of_nodes}, None)); "
        "from launch_stand_in import started; "
        "started('rviz:=true', 'initial_state:=0,0,1', installed=['rviz2'])"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


PALM_FILE = """/**:
  ros__parameters:
    robot:
      {shell_mass: 0.05, shell_inertia: 4.4e-5, rotor_mass: 0.02, rotor_axial_inertia: 3.4e-6,
       rotor_transverse_inertia: 1.7e-6, counterweight_mass: 0.02,
       counterweight_axial_inertia: 3.4e-6, counterweight_transverse_inertia: 1.7e-6}
/second/simulator:
  ros__parameters: {robot.shell_radius: 0.0365, robot.rotor_offset: 0.015}
"""


def test_model_and_view_are_those_of_the_robot_in_the_file(tmp_path) -> None:
    file, radius = tmp_path / "palm.yaml", 0.0365
    file.write_text(PALM_FILE)
    words = ("namespace:=second", f"params_file:={file}", "rviz:=true")
    found = nodes(started(*words, installed=OTHERS, looks=True))
    description = parameters(found["robot_state_publisher"])["robot_description"]
    assert description["value_type"] is str, "a text to launch"
    model = ElementTree.fromstring(description.values[0].partition("\n")[2])
    assert float(next(model.iter("sphere")).get("radius")) == radius
    assert next(model.iter("mass")).get("value") == "0.05"
    config = yaml.safe_load(Path(found["rviz2"]["arguments"][1]).read_text())
    distance = config["Visualization Manager"]["Views"]["Current"]["Distance"]
    assert distance == pytest.approx(6.5 * radius / 0.3)
    file.write_text("/**:\n  ros__parameters: {robot.shell_radius: -1.0}\n")
    with pytest.raises(RuntimeError, match=r"robot.shell_radius: given -1") as caught:
        started(f"params_file:={file}", installed=OTHERS, looks=True)
    assert "\n" not in str(caught.value)


def test_recording_has_every_documented_topic_except_requested_goals() -> None:
    (record,) = recorders(started("record:=1", "odometry:=1", installed=OTHERS))
    recorded = set(record["cmd"][record["cmd"].index("--topics") + 1:])
    documented = {topic for _, topic, _, verb, _ in table() if verb not in ("service", "action")}
    # `ros2 topic pub --once` ends after the first matched subscription.
    requested = {"/goal_pose", "/goal_point", "/goals", "/path", "/map", "/keepout",
                 "/simulator/push", "/initialpose"}
    assert "--use-sim-time" in record["cmd"]
    copied = {"/amcl_pose"}  # of the pose
    assert documented - requested - copied <= recorded and not (requested | copied) & recorded
