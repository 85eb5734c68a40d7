# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Command ``identify`` on bags that are written without nodes."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from identify import Drawn

from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.quantities import NANOSECONDS
from sphere_nmpc.ros import cdr, cdr_messages
from sphere_sim.cli.main import main
from sphere_sim.recording.bag_files import PARAMETERS_PREFIX
from sphere_sim.recording.bag_writer import BagWriter

START = 5 * NANOSECONDS
TOPICS = {"/pose": cdr.Pose, "/joint_states": cdr.Joints, "/imu": cdr.Imu,
          "/rotor_commands": cdr.Numbers}


@pytest.fixture(scope="module")
def drawn() -> Drawn:
    return Drawn(7, with_imu=True, duration=20.0)


def bag_of(
    folder: Path, drawn: Drawn, *left_out: str, custom: str = "", velocities: bool = True
) -> Path:
    """Write what was recorded of a robot, in the form in which nodes publish it."""
    recorded, none = drawn.recorded, np.zeros(2)
    turned = recorded.rotor_speeds
    commands, readings = recorded.commands, recorded.readings
    assert commands is not None and readings is not None

    steps, mean = np.diff(turned.times), turned.values[1:] + turned.values[:-1]
    angles = np.vstack((none, np.cumsum(0.5 * steps[:, None] * mean, axis=0)))
    angles = np.mod(angles + np.pi, 2.0 * np.pi) - np.pi

    def stamp(time: float) -> int:
        return START + round(time * NANOSECONDS)

    entries = [
        (stamp(t), "/pose", cdr_messages.pose_message(pose, stamp(t), drawn.robot.shell_radius))
        for t, pose in zip(recorded.times, recorded.states, strict=True)
    ] + [
        (stamp(t), "/joint_states", cdr_messages.joint_states_message(
            angle, speeds if velocities else none * np.nan, none, stamp(t)
        ))
        for t, speeds, angle in zip(turned.times, turned.values, angles, strict=True)
    ] + [
        (stamp(t), "/imu", cdr_messages.imu_message(rate, force, none, stamp(t), "imu"))
        for t, rate, force in zip(readings.times, readings.rates, readings.forces, strict=True)
    ] + [
        (stamp(t), "/rotor_commands", cdr_messages.speeds_message(speeds))
        for t, speeds in zip(commands.times[::2], commands.speeds[::2], strict=True)
    ]
    writer = BagWriter(folder)
    if custom:
        writer.custom_data[f"{PARAMETERS_PREFIX}/controller"] = custom
    for log, topic, message in sorted(entries):
        if topic not in left_out:
            writer.add_topic(topic, cdr.TYPES[TOPICS[topic]])
            writer.write(topic, log, message)
    writer.close()
    return folder


@pytest.mark.slow
def test_table_and_file_are_those_of_the_robot(tmp_path, capsys, drawn) -> None:
    file = tmp_path / "robot.yaml"
    bag = bag_of(tmp_path / "bag", drawn, custom='{"robot.shell_mass": 1.05, "drive_lag": 0.01}')
    assert main(["identify", str(bag), "--out", str(file)]) == 0
    out, err = capsys.readouterr()
    lines = out.splitlines()
    assert lines[-2].startswith("21 of 21 identified; half of the bag predicts the other half wit")
    assert lines[-1] == f"parameters in {file}"
    assert "identify: constants: half of 10 pieces, of 2 s" in err
    nodes = yaml.safe_load(file.read_text())
    assert list(nodes) == ["/**", "/**/controller", "/**/odometry"]
    found = RobotParameters(**nodes["/**"]["ros__parameters"]["robot"])
    assert found.shell_mass == 1.05
    assert found.lumped.as_array() == pytest.approx(drawn.robot.lumped.as_array(), rel=3e-3)
    imu = nodes["/**/odometry"]["ros__parameters"]["imu"]
    assert imu["position"] == pytest.approx(drawn.imu.position, abs=2e-3)


@pytest.mark.slow
def test_given_file_says_what_is_kept(tmp_path, capsys, drawn) -> None:
    bag, given = bag_of(tmp_path / "bag", drawn, "/imu", "/rotor_commands"), tmp_path / "a.yaml"
    robot = {"max_rotor_speed": 90, "rotor_mass": 0.8}
    given.write_text(yaml.safe_dump({"/**": {"ros__parameters": {"robot": robot}}}))
    file = tmp_path / "robot.yaml"
    assert main(["identify", str(bag), "--params-file", str(given), "--out", str(file)]) == 0
    out = capsys.readouterr().out
    assert "robot.max_rotor_speed         90 rad/s" in out and "(no commands in the bag)" in out
    robot = yaml.safe_load(file.read_text())["/**"]["ros__parameters"]["robot"]
    assert robot["max_rotor_speed"] == 90.0 and robot["rotor_mass"] == 0.8


@pytest.mark.slow
def test_angles_give_the_speeds_where_there_are_no_velocities(tmp_path, capsys, drawn) -> None:
    file = tmp_path / "robot.yaml"
    bag = bag_of(tmp_path / "bag", drawn, "/imu", "/rotor_commands", velocities=False)
    assert main(["identify", str(bag), "--out", str(file)]) == 0
    told = "/joint_states: no velocities; the speeds are those of angles"
    assert told in capsys.readouterr().err
    found = RobotParameters(**yaml.safe_load(file.read_text())["/**"]["ros__parameters"]["robot"])
    assert found.lumped.as_array() == pytest.approx(drawn.robot.lumped.as_array(), rel=3e-3)


@pytest.mark.parametrize(("left_out", "told"), [
    # With the axes of the IMU in any direction, of which nothing is said.
    (("/pose",), "sphere_nmpc identify: constants: given "),
    (("/pose", "/imu"), "sphere_nmpc identify: poses: given none from outside, and no readings"),
    (("/joint_states",), "sphere_nmpc identify: rotor speeds: given none, expected those on join"),
    (("/pose", "/joint_states"), ": neither poses nor rotor speeds on /joint_states"),
])
def test_bag_without_what_is_needed_is_refused_in_a_line(
    tmp_path, capsys, drawn, left_out, told
) -> None:
    assert main(["identify", str(bag_of(tmp_path / "bag", drawn, *left_out))]) != 0
    last = capsys.readouterr().err.strip().splitlines()[-1]
    assert told in last
