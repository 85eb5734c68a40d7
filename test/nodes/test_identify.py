# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Command ``identify`` on a bag that nodes have recorded, and nodes that take its file."""

from pathlib import Path

import pytest
import yaml
from documented_examples import run_example
from patience import until
from ros_graph import running_graph, started

from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.quantities import quantities
from sphere_nmpc.ros.controller.node import ControllerNode
from sphere_nmpc.ros.odometry.node import OdometryNode
from sphere_sim.cli.main import main
from sphere_sim.identification.identify import Given, Identified
from sphere_sim.identification.robot_file import Entry, written
from sphere_sim.ros.recorder.node import RecorderNode
from sphere_sim.ros.simulator.node import SimulatorNode

pytestmark = pytest.mark.slow

TRUE = {"robot.shell_radius": 0.29, "robot.rotor_axial_inertia": 0.0085}
POSES = {"position_noise": 2e-3, "orientation_noise": 6e-3}
START = {"initial_state": [0.0, 0.0, 1.0, 0.0, 0.0, 0.0], "real_time_factor": 4.0}


def test_robot_is_identified_from_the_motion_of_the_example(tmp_path, capsys) -> None:
    bag, file = tmp_path / "bag", tmp_path / "robot.yaml"
    recording = {"output": str(bag), "topics": ["pose", "joint_states", "rotor_commands", "imu"],
                 "use_sim_time": True}
    with started("simulator", **TRUE, **POSES, **START):
        with started("recorder", **recording):
            until(lambda: list(bag.glob("*.mcap")))
            done = run_example("identification_motion.py", "--ros-args", "-p",
                               "use_sim_time:=true")
        assert done.returncode == 0, done.stderr
    assert main(["identify", str(bag), "--out", str(file)]) == 0
    printed = capsys.readouterr().out
    for name in ("robot.shell_radius ", "c1 ", "r1 ", "r3 ", "imu.position "):
        (line,) = (line for line in printed.splitlines() if line.startswith(name))
        assert "+-" in line
    robot = yaml.safe_load(file.read_text())["/**"]["ros__parameters"]["robot"]
    true = RobotParameters(shell_radius=0.29, rotor_axial_inertia=0.0085)
    found = RobotParameters(**robot).lumped.as_array()
    assert found == pytest.approx(true.lumped.as_array(), rel=5e-3)


def test_all_nodes_take_the_file_as_it_is(tmp_path, capfd) -> None:
    given = Given(RobotParameters(shell_radius=0.31, max_rotor_speed=95.0))
    found = Identified(given, given.robot)
    found.controller = {
        "drive_lag": Entry(0.012, "+- 0.001"), "pose_position_noise": Entry(2e-3),
        "pose_orientation_noise": Entry(6e-3),
    }
    found.odometry = {
        "imu.position": Entry((0.1, 0.0, 2e-5)), "imu.orientation": Entry((0.5, 0.5, -0.5, 0.5)),
        "imu.gyro_noise": Entry(1.5e-4), "imu.accelerometer_noise": Entry(2e-3),
    }
    file = Path(tmp_path / "robot.yaml")
    file.write_text(written(found.sections, "A robot."))
    kinds = (SimulatorNode, ControllerNode, OdometryNode, RecorderNode)
    with running_graph(["--ros-args", "--params-file", str(file)]) as graph:
        nodes = [graph.start(kind) for kind in kinds]
        for node in nodes[:3]:
            for name in quantities(RobotParameters):
                given = node.get_parameter(f"robot.{name}").value
                assert given == pytest.approx(getattr(found.robot, name), rel=1e-6)
        for node, entries in ((nodes[1], found.controller), (nodes[2], found.odometry)):
            for name, entry in entries.items():
                value = node.get_parameter(name).value
                assert (tuple(value) if isinstance(entry.value, tuple) else value) == entry.value
    assert "unknown parameters" not in capfd.readouterr().err
