# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The program that describes the robot of a parameter file, for ros2_control and MuJoCo."""

import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
TURN = [0.8, -0.36, 0.48, 0.0]
"""Orientation of the IMU, wxyz."""
ROBOT = ("--ros-args", "--params-file", str(ROOT / "examples" / "own_robot.yaml"))


def described(*words: str) -> subprocess.CompletedProcess:
    module = "sphere_sim.ros.simulator.robot_description"
    command = [sys.executable, "-m", module, *words]
    return subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT)


def test_mujoco_gets_the_robot_of_the_file_by_the_path_in_its_description(tmp_path) -> None:
    mujoco = pytest.importorskip("mujoco")
    file = tmp_path / "sphere.xml"
    mounting = ("-p", "imu.position:=[0.01, 0.02, -0.03]", "-p", f"imu.orientation:={TURN}")
    done = described("--mjcf", str(file), *ROBOT, *mounting)
    assert done.returncode == 0, done.stderr
    root = ElementTree.fromstring(done.stdout.partition("\n")[2])
    hardware = root.find("ros2_control/hardware")
    assert hardware.find("plugin").text == "mujoco_ros2_control/MujocoSystemInterface"
    model = mujoco.MjModel.from_xml_path(hardware.find("param[@name='mujoco_model']").text)
    assert model.geom("shell").size[0] == 0.15 and model.nu == 2
    site, origin = model.site("imu"), root.find("joint[@name='imu_joint']/origin")
    np.testing.assert_allclose(site.quat, TURN)
    angles = np.array(origin.get("rpy").split(), dtype=float)
    turned = Rotation.from_euler("xyz", angles).as_quat()[[3, 0, 1, 2]]
    np.testing.assert_allclose(turned, TURN, atol=1e-8)
    assert site.pos.tolist() == [0.01, 0.02, -0.03] and origin.get("xyz") == "0.01 0.02 -0.03"


def test_robot_has_the_plugin_and_its_parameters_that_are_named() -> None:
    words = ("--hardware", "my_robot/Drives", "--parameter", "port=/dev/x=1", "--parameter", "id=")
    done = described(*words, *ROBOT)
    root = ElementTree.fromstring(done.stdout.partition("\n")[2])
    hardware = root.find("ros2_control/hardware")
    assert hardware.find("plugin").text == "my_robot/Drives"
    given = {each.get("name"): each.text or "" for each in hardware.iter("param")}
    assert given == {"port": "/dev/x=1", "id": ""}


@pytest.mark.parametrize(
    ("words", "wrong"),
    [
        (["--hardware", "a/B", "--parameter", "x"], "given 'x', expected NAME=VALUE"),
        (["--parameter", "a=b"], "--parameter: expected --hardware as well"),
        (["--mjcf", "/nowhere/at/all.xml"], "/nowhere/at/all.xml"),
        (["--mjcf", "x.xml", "--ros-args", "-p", "rigid_body.floor_roughness:=0.01"],
         "floor_roughness: given 0.01, expected 0"),
    ],
)
def test_wrong_arguments_are_told_and_nothing_is_written(words, wrong) -> None:
    done = described(*words)
    assert done.returncode == 2 and not done.stdout
    assert wrong in done.stderr.splitlines()[-1] and not (ROOT / "x.xml").exists()
