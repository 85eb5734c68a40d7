# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""What ros2_control and mujoco_ros2_control get: interfaces, controllers, a model that moves."""

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml
from robots import PALM, SIZES
from ros2_control import Exported

from sphere_nmpc.model.disturbance import GRAVITY
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.rotation import matrix
from sphere_nmpc.model.state import angle_error, position_error
from sphere_nmpc.ros.cdr import JOINT_NAMES
from sphere_sim.world.plant.rigid_body.rigid_body_plant import RigidBodyPlant
from sphere_sim.world.robot_description import MOCK, Hardware, make_urdf, mujoco_hardware

ROOT = Path(__file__).parents[3]
CONTROLLERS = yaml.safe_load((ROOT / "config" / "ros2_control.yaml").read_text("utf-8"))
DRIVES = Hardware("my_robot/Drives", {"port": "/dev/ttyUSB0"})
UPRIGHT = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])


def described(hardware: Hardware, robot: RobotParameters = PALM) -> ElementTree.Element:
    """Return the URDF, as a tree."""
    return ElementTree.fromstring(make_urdf(robot, hardware).partition("\n")[2])


def interfaces(root: ElementTree.Element, kind: str) -> set[str]:
    """Return the names of the state or command interfaces."""
    system = root.find("ros2_control")
    return {
        f"{part.get('name')}/{each.get('name')}"
        for part in system if part.tag != "hardware" for each in part.iter(f"{kind}_interface")
    }


@pytest.mark.parametrize("hardware", [MOCK, DRIVES, mujoco_hardware(Path("sphere.xml"))])
def test_urdf_names_hardware_joints_and_sensors_that_it_has(hardware) -> None:
    root = described(hardware)
    (system,) = root.iter("ros2_control")
    device = system.find("hardware")
    assert device.find("plugin").text == hardware.plugin
    given = {each.get("name"): each.text for each in device.iter("param")}
    assert given == hardware.parameters
    assert given.get("mujoco_model", "/").startswith("/"), "read in another folder"
    joints = {joint.get("name"): joint for joint in root.findall("joint")}
    links = {link.get("name") for link in root.findall("link")}
    assert {joint.get("name") for joint in system.findall("joint")} == set(JOINT_NAMES)
    for joint in system.findall("joint"):
        speed = float(joints[joint.get("name")].find("limit").get("velocity"))
        limits = [float(each.text) for each in joint.find("command_interface")]
        assert limits == [-speed, speed] and speed == PALM.max_rotor_speed
    assert interfaces(root, "command") == {f"{name}/velocity" for name in JOINT_NAMES}
    imu = joints["imu_joint"]
    assert imu.find("child").get("link") in links and imu.find("origin").get("xyz") == "0 0 0"
    assert imu.find("parent").get("link") == "base_link"


def needed(name: str) -> tuple[set[str], set[str]]:
    """Return the command and state interfaces of a controller of ros2_controllers."""
    kind = CONTROLLERS["controller_manager"]["ros__parameters"][name]["type"]
    given = CONTROLLERS[name]["ros__parameters"]
    joints = given.get("joints", JOINT_NAMES)

    def of(parts, names) -> set[str]:
        return {f"{part}/{each}" for part in parts for each in names}

    turn = of(["orientation"], "xyzw")
    return {
        "JointTrajectoryController": lambda: (
            of(joints, given["command_interfaces"]), of(joints, given["state_interfaces"])
        ),
        "JointGroupVelocityController": lambda: (of(joints, ["velocity"]), set()),
        "JointStateBroadcaster": lambda: (set(), of(joints, ["position", "velocity", "effort"])),
        "IMUSensorBroadcaster": lambda: (set(), of([given["sensor_name"]], {
            name.replace("/", ".")
            for name in turn | of(["angular_velocity", "linear_acceleration"], "xyz")
        })),
        "PoseBroadcaster": lambda: (set(), of([given["pose_name"]], {
            name.replace("/", ".") for name in turn | of(["position"], "xyz")
        })),
    }[kind.split("/")[1]]()


@pytest.mark.parametrize("name", [name for name in CONTROLLERS if name != "controller_manager"])
def test_controllers_find_all_their_interfaces(name) -> None:
    commands, states = needed(name)
    root = described(mujoco_hardware(Path("sphere.xml")))
    assert commands <= interfaces(root, "command") and states <= interfaces(root, "state")
    assert commands | states, "reads or writes something"
    is_missing = not states <= interfaces(described(DRIVES), "state")
    assert is_missing is (name == "pose_broadcaster"), "the only one that needs a measured pose"
    frame = CONTROLLERS[name]["ros__parameters"].get("frame_id", "imu")
    assert frame == "world" or frame in {link.get("name") for link in root.iter("link")}


def test_rotors_have_actuators_of_speed() -> None:
    robot = Exported(PALM)
    model, mujoco = robot.model, robot.mujoco
    for i, name in enumerate(JOINT_NAMES):
        assert model.actuator_trntype[i] == mujoco.mjtTrn.mjTRN_JOINT
        assert model.joint(model.actuator_trnid[i, 0]).name == name
        # By this mujoco_ros2_control tells actuators of velocity.
        assert model.actuator_biastype[i] == mujoco.mjtBias.mjBIAS_AFFINE
        assert model.actuator_biasprm[i, 1] == 0.0 > model.actuator_biasprm[i, 2]
        assert model.actuator_dyntype[i] == mujoco.mjtDyn.mjDYN_NONE


SUFFIXES = {
    "imu": {"_quat": "FRAMEQUAT", "_gyro": "GYRO", "_accel": "ACCELEROMETER"},
    "pose": {"_pos": "FRAMEPOS", "_quat": "FRAMEQUAT"},
}
"""Sensors of MuJoCo that mujoco_ros2_control looks for, by the type of a sensor of the URDF."""


def test_sensors_of_the_description_are_found_in_the_model() -> None:
    robot = Exported(PALM)
    types = {robot.model.sensor(i).name: robot.model.sensor_type[i]
             for i in range(robot.model.nsensor)}
    found = {}
    for sensor in described(mujoco_hardware(Path("sphere.xml"))).findall("ros2_control/sensor"):
        given = {each.get("name"): each.text for each in sensor.findall("param")}
        for suffix, kind in SUFFIXES[given["mujoco_type"]].items():
            expected = getattr(robot.mujoco.mjtSensor, f"mjSENS_{kind}")
            found[given["mujoco_sensor_name"] + suffix] = int(expected)
    assert found == types and len(found) == 5


def test_imu_at_rest_and_in_motion_measures_gravity_rate_and_turn() -> None:
    robot = Exported(RobotParameters())
    robot.mujoco.mj_forward(robot.model, robot.data)
    np.testing.assert_allclose(robot.data.sensor("imu_quat").data, UPRIGHT[2:])
    np.testing.assert_allclose(robot.data.sensor("imu_gyro").data, 0.0)
    for _ in range(100):  # until the contact carries the weight
        robot.step(np.zeros(2))
    felt = robot.data.sensor("imu_accel").data
    np.testing.assert_allclose(felt, [0.0, 0.0, GRAVITY], atol=1e-3)
    hold = FirstOrderHold(np.array([0.0, 1.0]), np.array([[0.0, 0.0], [0.0, 60.0]]))
    states = robot.follow(hold, 0.5)
    step = robot.model.opt.timestep
    # MuJoCo normalises it on the way to the sensor.
    np.testing.assert_allclose(robot.data.sensor("imu_quat").data, states[-1][2:], atol=1e-14)
    turn = matrix(states[-2][2:]).T @ matrix(states[-1][2:])
    rate = np.array([turn[2, 1], turn[0, 2], turn[1, 0]]) / step
    np.testing.assert_allclose(robot.data.sensor("imu_gyro").data, rate, rtol=0.01, atol=1e-3)


@pytest.mark.parametrize("robot", [RobotParameters(), *SIZES.values()])
@pytest.mark.parametrize("share", [0.5, 1.0])
def test_exported_model_moves_as_the_plant(robot, share) -> None:
    exported, plant = Exported(robot), RigidBodyPlant(robot, UPRIGHT)
    step = exported.model.opt.timestep
    times = 100.0 * step * np.arange(11)
    limit = np.minimum(0.6 * robot.max_rotor_speed, 80.0 * step * robot.max_rotor_acceleration)
    speeds = np.random.default_rng(4).uniform(-limit / 2.0, limit / 2.0, (11, 2))
    speeds[0] = 0.0
    hold = FirstOrderHold(times, speeds)
    expected = []
    for k in range(round(hold.end / step)):
        plant.advance(hold.at((k + 1) * step), step)
        expected.append(plant.state)
    found = exported.follow(hold, share)
    apart = max(position_error(one, other) for one, other in zip(found, expected, strict=True))
    turned = max(angle_error(one, other) for one, other in zip(found, expected, strict=True))
    before, after = expected[:-1], expected[1:]
    # A command that is held for a step has the mean of the ramp in the middle of the step; given
    # from the ramp's end it leads by half a step. The rest is a ripple of the rotors within the
    # step, slope times square of the step over eight, and of what it moves the shell.
    steps = share - 0.5 + 0.02
    assert apart < steps * max(map(position_error, before, after))
    assert turned < steps * max(map(angle_error, before, after))
