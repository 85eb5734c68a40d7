# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The simulator over real DDS: commands, services, clock, walls and what it refuses."""

import array
import math
import time

import numpy as np
import pytest
from builtin_interfaces.msg import Duration
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, TransformStamped, Vector3, Vector3Stamped
from nav_msgs.msg import OccupancyGrid, Odometry
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Float64, Float64MultiArray
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.floor.occupancy import InvalidMapError
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.ros import pose_publisher
from sphere_nmpc.ros.cdr import JOINT_NAMES
from sphere_nmpc.ros.guarded_node import LATCHED
from sphere_nmpc.ros.messages import pose_from_ros, stamp_from_ros, stamp_to_ros
from sphere_sim.ros.simulator.node import SimulatorNode
from sphere_sim.ros.simulator.settings import SimulatorNodeSettings
from sphere_sim.ros.simulator.state_publisher import StatePublisher
from sphere_sim.world.settings import SimulatorSettings
from sphere_sim.world.simulator import Simulator

pytestmark = pytest.mark.slow

MS = 1_000_000
SAMPLE = 250 * MS
"""Default of sample_period [ns]."""


def trajectory(*points, names=JOINT_NAMES, stamp=0) -> JointTrajectory:
    message = JointTrajectory(joint_names=list(names))
    message.header.stamp = stamp_to_ros(stamp)
    for after, velocities in points:
        start = Duration(sec=int(after), nanosec=round(after % 1 * 1e9))
        message.points.append(
            JointTrajectoryPoint(velocities=list(velocities), time_from_start=start)
        )
    return message


def speeds(joint_states) -> np.ndarray:
    return np.array([message.velocity for message in joint_states])


REFUSED = {
    "rotor_trajectory": [
        trajectory((0.0, (50.0, 50.0)), (1.0, (math.nan, 0.0))),
        trajectory((0.0, (50.0, 50.0)), (1.0, (0.0, 0.0)), stamp=1_795_000_000 * 10**9),
    ],
    "control_period": [Float64(data=period) for period in (math.nan, -1.0, 0.0, 1e9)],
    "rotor_commands": [
        Float64MultiArray(data=data) for data in ([1.0], [1.0, math.nan], [1.0, 2.0, 3.0])
    ],
    "push": [
        Vector3(x=x, y=y, z=z) for x, y, z in (
            (math.nan, 0.0, 0.0), (0.0, 1e300, 0.0), (0.5, 0.0, 0.1), (0.5, 0.0, math.nan),
        )
    ],
}


@pytest.mark.parametrize("kind", REFUSED)
def test_wrong_messages_move_nothing_and_are_logged_once(graph, capfd, kind) -> None:
    node = graph.start(SimulatorNode, real_time_factor=5.0)
    joints = graph.collect(JointState, "joint_states")
    topic = "simulator/push" if kind == "push" else kind
    quality = LATCHED if kind == "control_period" else 10
    sender = graph.probe.create_publisher(type(REFUSED[kind][0]), topic, quality)
    graph.until(lambda: sender.get_subscription_count() > 0)
    for number, message in enumerate(REFUSED[kind], 1):
        sender.publish(message)
        graph.until(lambda number=number: node._fault_log.counts[f"{kind} refused"] == number)
    received = len(joints)
    graph.until(lambda: len(joints) > received + 20)
    assert not speeds(joints).any() and not node.simulator.plant.momentum.any()
    assert node._simulated_clock.next_sample(0) == SAMPLE
    (line,) = (line for line in capfd.readouterr().err.splitlines() if "refused" in line)
    assert "given" in line


def test_late_trajectory_is_told_where_it_matters_and_then_stops_the_rotors(graph, capfd) -> None:
    node = graph.start(SimulatorNode, real_time_factor=2.0)
    joints = graph.collect(JointState, "joint_states")
    sender = graph.publisher(JointTrajectory, "rotor_trajectory")

    def send(message: JointTrajectory) -> None:
        received = node._receiver.received
        sender.publish(message)
        graph.until(lambda: node._receiver.received > received)

    graph.until(lambda: node.simulator.now > 500 * MS)
    send(trajectory((0.0, (0.0, 1e-3)), (0.05, (0.0, 0.0)), stamp=400 * MS))
    graph.call(SetBool, "simulator/pause", data=True)
    ramp = trajectory((0.0, (0.0, 0.0)), (0.1, (40.0, 0.0)), (0.2, (0.0, 0.0)),
                      stamp=node.simulator.now + 200 * MS)
    send(ramp)
    graph.call(SetBool, "simulator/pause", data=False)
    graph.until(lambda: node.simulator.now > stamp_from_ros(ramp.header.stamp) + 250 * MS)
    send(ramp)
    assert not node._fault_log.counts, "neither moves anything"
    start = node.simulator.now
    send(trajectory((0.0, (0.0, 0.0)), (0.1, (40.0, 40.0)), (60.0, (40.0, 40.0)), stamp=start))
    graph.until(lambda: joints and joints[-1].velocity[0] == 40.0)
    graph.until(lambda: node.simulator.now > start + 1500 * MS)
    send(trajectory((0.0, (40.0, 40.0)), (0.2, (0.0, 0.0)), stamp=start + 1000 * MS))
    graph.until(lambda: joints[-1].velocity[0] == 0.0)
    # What is older than that cannot set them going again.
    send(trajectory((0.0, (40.0, 40.0)), (0.1, (40.0, 40.0)), stamp=start + 500 * MS))
    assert node._fault_log.counts["rotor_trajectory refused"] == 1
    assert "rotor_trajectory late: given an end" in capfd.readouterr().err


def test_clock_stops_goes_one_sample_and_runs_on(graph) -> None:
    def pause(wanted: bool) -> bool:
        return graph.call(SetBool, "simulator/pause", data=wanted).success

    def step():
        return graph.call(Trigger, "simulator/step")

    node = graph.start(SimulatorNode, real_time_factor=10.0)
    refused = step()
    assert not refused.success and "expected a paused one" in refused.message
    assert pause(True)
    then = node.simulator.now
    clock = graph.collect(Clock, "/clock")
    graph.until(lambda: len(clock) >= 2)  # repeated for late subscribers
    assert node.simulator.now == then
    assert {stamp_from_ros(message.clock) for message in clock} == {then}
    assert step().success
    goal = (then // SAMPLE + 1) * SAMPLE
    graph.until(lambda: node.simulator.now == goal)
    graph.spin_for(0.1)
    assert node.simulator.now == goal
    node.set_parameters([Parameter("real_time_factor", value=0.1)])
    assert step().success and pause(False), "during the step"
    node.set_parameters([Parameter("real_time_factor", value=10.0)])
    graph.until(lambda: node.simulator.now > goal + SAMPLE)


def test_reset_returns_to_the_start_and_never_turns_the_clock_back(graph) -> None:
    node = graph.start(SimulatorNode, real_time_factor=10.0, command_timeout=60.0)
    poses = graph.collect(PoseStamped, "pose")
    clock = graph.collect(Clock, "/clock")
    graph.send("rotor_commands", Float64MultiArray(data=[80.0, 30.0]))
    start = np.array([2.0, -3.0])
    graph.until(lambda: poses and np.linalg.norm(pose_from_ros(poses[-1])[:2] - start) > 0.1)
    assert graph.call(Trigger, "simulator/reset").success
    graph.until(lambda: np.allclose(pose_from_ros(poses[-1])[:2], start, atol=1e-12))
    received = len(poses)
    graph.until(lambda: len(poses) > received + 20)
    for pose in poses[received:]:
        np.testing.assert_allclose(pose_from_ros(pose)[:2], start, atol=1e-12)
    assert not node.simulator.plant.rotor_speeds.any()
    assert np.all(np.diff([stamp_from_ros(message.clock) for message in clock]) >= 0)


def test_stamps_are_those_of_the_system_clock_which_nothing_stops(
    graph, monkeypatch, capfd
) -> None:
    node = graph.start(SimulatorNode, clock="system")
    poses, odometry = graph.collect(PoseStamped, "pose"), graph.collect(Odometry, "odom")
    joints = graph.collect(JointState, "joint_states")
    graph.until(lambda: poses and odometry and joints)
    now = time.time_ns()
    for message in (poses[-1], odometry[-1], joints[-1]):
        # The clocks differ by 1.8e9 s; a message may take a minute on a busy machine.
        assert abs(now - stamp_from_ros(message.header.stamp)) < 60_000 * MS
    assert graph.probe.count_publishers("/clock") == 0
    answer = graph.call(SetBool, "simulator/pause", data=True)
    assert not answer.success and "clock: system" in answer.message
    assert not graph.call(Trigger, "simulator/step").success
    result = node.set_parameters([Parameter("real_time_factor", value=2.0)])[0]
    assert not result.successful and "clock: system" in result.reason
    with pytest.raises(InvalidParameterError, match=r"lockstep.*clock: system"):
        SimulatorNodeSettings(clock="system", lockstep=True)

    real = time.time_ns
    monkeypatch.setattr(time, "time_ns", lambda: real() + 3600 * 10**9)
    graph.until(lambda: stamp_from_ros(poses[-1].header.stamp) > real() + 3500 * 10**9)
    assert "system clock jumped: given a jump of 3600.0" in capfd.readouterr().err


@pytest.mark.parametrize("plant", ["rolling", "rigid_body"])
def test_push_by_topic_or_service_gives_its_momentum_and_is_published(graph, capfd, plant) -> None:
    if plant == "rigid_body":
        pytest.importorskip("mujoco")
    friction = {"rigid_body.friction": 0.5}
    node = graph.start(SimulatorNode, plant=plant, push_impulse=[0.0, 2.0], **friction)
    assert node.get_parameter("rigid_body.friction").value == 0.5
    pushed = graph.collect(Vector3Stamped, "simulator/pushed")
    graph.until(lambda: node.simulator.now > 0)
    before = node.simulator.plant.momentum
    graph.send("simulator/push", Vector3(x=0.5, y=-0.25))
    graph.until(lambda: pushed)
    # Rs e3 x J. The plant with contact settles into its floor, by much less than 1 %.
    gained = node.simulator.plant.momentum - before
    np.testing.assert_allclose(gained, 0.3 * np.array([0.25, 0.5, 0.0]), atol=1e-3)
    impulse, header = pushed[0].vector, pushed[0].header
    assert (impulse.x, impulse.y, impulse.z) == (0.5, -0.25, 0.0)
    assert header.frame_id == "world"
    assert 0 < stamp_from_ros(header.stamp) <= node.simulator.now
    answer = graph.call(Trigger, "simulator/push")
    assert answer.success and "[0.0, 2.0] N s" in answer.message
    graph.until(lambda: len(pushed) == 2)
    assert capfd.readouterr().err.count("push: [0.5, -0.25] N s at t = 0.") == 1


def test_transform_is_published_if_there_is_a_subscriber(graph, monkeypatch) -> None:
    # A TFMessage cannot be had from the wheels; a message that wraps nothing can be sent instead.
    class StandIn(TransformStamped):
        def __init__(self, transforms=()) -> None:
            super().__init__()
            if transforms:
                self.header, self.child_frame_id = transforms[0].header, "base_link"

    monkeypatch.setattr(pose_publisher, "TFMessage", StandIn)
    publisher = StatePublisher(graph.probe, 0.3)
    received = graph.collect(TransformStamped, "/tf")
    graph.until(lambda: publisher._pose._transforms.get_subscription_count() > 0)
    publisher.publish(Simulator(SimulatorSettings(), RobotParameters()))
    graph.until(lambda: received)
    assert (received[0].header.frame_id, received[0].child_frame_id) == ("world", "base_link")


def stamps(messages) -> list[int]:
    return [stamp_from_ros(message.header.stamp) for message in messages]


def test_imu_is_read_while_somebody_receives_it(graph) -> None:
    node = graph.start(SimulatorNode, **{"imu.rate": 200.0, "imu.accelerometer_noise": 0.01})
    poses = graph.collect(PoseStamped, "pose")
    graph.until(lambda: len(poses) > 3)
    assert node.simulator.imu is None
    received = graph.collect(Imu, "imu")
    graph.until(lambda: len(received) > 10)
    assert set(np.diff(stamps(received))) == {5 * MS}, "between the instants of pose_rate, too"
    imu = received[0]
    assert imu.header.frame_id == "imu" and imu.orientation_covariance[0] == -1.0
    assert imu.linear_acceleration_covariance[0] == pytest.approx(0.01**2 * 200.0)
    felt = [imu.linear_acceleration.x, imu.linear_acceleration.y, imu.linear_acceleration.z]
    # Five deviations of the bias.
    assert np.linalg.norm(felt) == pytest.approx(9.81, abs=0.75)


def test_with_odometry_the_true_pose_has_another_name_and_encoders_come_with_the_imu(
    graph,
) -> None:
    given = {"pose_source": "odometry", "imu.latency": 0.02}
    node = graph.start(SimulatorNode, **given)
    poses = graph.collect(PoseStamped, "ground_truth/pose")
    imu, joints = graph.collect(Imu, "imu"), graph.collect(JointState, "joint_states")
    graph.until(lambda: poses and len(imu) > 10 and len(joints) > 10)
    assert graph.probe.count_publishers("/pose") == graph.probe.count_publishers("/odom") == 0
    assert graph.probe.count_publishers("/tf") == 0
    both = {*stamps(imu)} & {*stamps(joints)}
    assert len(both) > 5 and {*np.diff(stamps(joints))} == {10 * MS}
    order = [publisher.topic_name for publisher, _ in node._state_publisher._last]
    assert order == ["/ground_truth/pose", "/imu", "/joint_states", "/clock"]
    with pytest.raises(InvalidParameterError, match=r"imu\.latency: given 0\.02, expected 0 with"):
        graph.start(SimulatorNode, **given, lockstep=True)


IN_ROOM = {"initial_state": [0.0, 0.0, 1.0, 0.0, 0.0, 0.0], "real_time_factor": 5.0,
           "command_timeout": 5.0}


def room(side: float) -> OccupancyGrid:
    """Return a free square about the origin with a wall around it."""
    cells = np.zeros((20, 20), dtype=np.int8)
    cells[[0, -1]] = cells[:, [0, -1]] = 100
    message = OccupancyGrid(data=array.array("b", cells.tobytes()))
    message.info.width = message.info.height = 20
    message.info.resolution = side / 18
    message.info.origin.position.x = message.info.origin.position.y = -side * 10 / 18
    message.info.origin.orientation.w = 1.0
    return message


def clearance(node: SimulatorNode) -> float:
    return node.simulator.plant.contact.least_clearance(node.simulator.plant.state[None, :2])


@pytest.mark.parametrize("plant", ["rolling", "rigid_body"])
def test_map_makes_walls_that_are_touched_once_and_told(graph, capfd, plant) -> None:
    if plant == "rigid_body":
        pytest.importorskip("mujoco")
    node = graph.start(SimulatorNode, **IN_ROOM, plant=plant)
    reports = graph.collect(DiagnosticArray, "/diagnostics")
    maps = graph.probe.create_publisher(OccupancyGrid, "map", LATCHED)
    assert node.simulator.touches == 0 and clearance(node) == np.inf
    maps.publish(room(1.8))
    graph.until(lambda: clearance(node) == pytest.approx(0.6, abs=0.01))
    bad = room(1.8)
    bad.info.width = 19
    maps.publish(bad)
    graph.until(lambda: node._fault_log.counts["map refused"] == 1)
    assert clearance(node) == pytest.approx(0.6, abs=0.01)
    graph.send("rotor_commands", Float64MultiArray(data=[0.0, -60.0]))
    graph.until(lambda: node.simulator.touches == 1)
    assert clearance(node) > -2e-3

    def counted() -> bool:
        return any(
            ("wall touched", "1") in {(pair.key, pair.value) for pair in status.values}
            for report in reports for status in report.status
        )

    graph.until(counted)
    lines = [line for line in capfd.readouterr().err.splitlines() if "wall touched" in line]
    assert len(lines) == 1 and "1 contact so far" in lines[0]


def test_change_of_walls_is_answered_when_they_stand_or_refused(graph) -> None:
    node = graph.start(SimulatorNode, **IN_ROOM)
    for edge, radius in (("[[-1, -1], [1, -1], [1, 1], [-1, 1]]", 0.7), ("[[0, 0], [1, 1]]", 0.7)):
        (result,) = graph.set_parameters("simulator", floor=edge)
        assert result.successful is (len(edge) > 20)
        assert clearance(node) == pytest.approx(radius, abs=0.03)


def test_map_file_makes_walls_from_the_start(graph, tmp_path) -> None:
    levels = np.full((20, 20), 254, dtype=np.uint8)
    levels[:, 18:] = 0
    (tmp_path / "room.pgm").write_bytes(b"P5\n20 20\n255\n" + levels.tobytes())
    file = tmp_path / "room.yaml"
    file.write_text("image: room.pgm\nresolution: 0.1\norigin: [-1, -1, 0]\nnegate: 0\n")
    node = graph.start(SimulatorNode, **IN_ROOM, map_file=str(file),
                       floor="[[-0.5, -1], [1, -1], [1, 1], [-0.5, 1]]")
    # The wall begins at x = 0.8 m, the edge of the floor at -0.5 m.
    assert clearance(node) == pytest.approx(0.2, abs=0.03)
    with pytest.raises(InvalidMapError, match=r"none\.yaml"):
        graph.start(SimulatorNode, map_file=str(tmp_path / "none.yaml"))
