# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Frames from live topics, requests to other nodes, and markers, over DDS."""

from itertools import count

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import OccupancyGrid
from rclpy.node import Node
from std_srvs.srv import Trigger
from visualization_msgs.msg import Marker, MarkerArray

pytest.importorskip("viser")

from robots import PALM

from sphere_nmpc.floor.occupancy import Grid
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import make_state, state_error
from sphere_nmpc.ros.cdr_messages import floor_message
from sphere_nmpc.ros.controller.node import ControllerNode
from sphere_nmpc.ros.guarded_node import LATCHED
from sphere_nmpc.ros.messages import pose_to_ros
from sphere_nmpc.settings import STRATEGIES
from sphere_sim.ros.simulator.node import SimulatorNode
from sphere_sim.ros.viewer.markers import MarkerNode
from sphere_sim.ros.viewer.node import TopicSource
from sphere_sim.viewer.source import (
    ApplyPush,
    Cancel,
    Enable,
    Pause,
    Reset,
    SetGoal,
    SetPath,
    SetPoint,
    SetSpeed,
    SetStrategy,
)

pytestmark = pytest.mark.slow

START = make_state((1.0, 2.0), (1.0, 0.0, 0.0, 0.0))
GOAL = make_state((0.5, 0.0), (0.5, 0.5, 0.5, 0.5))
ROBOT = RobotParameters(
    rotor_axial_inertia=0.01, max_rotor_speed=60.0, max_rotor_acceleration=50.0
)


@pytest.fixture
def source(graph) -> TopicSource:
    node = Node("viewer")
    graph.add(node)
    return TopicSource(node)


def newest(source):
    return source.frames()[-1]


def notices(graph, source) -> list[str]:
    """Return the notices that arrive next."""
    found: list[str] = []
    graph.until(lambda: found.extend(newest(source).notices) or found)
    return found


def test_viewer_shows_a_running_robot_and_its_requests_are_fulfilled(graph) -> None:
    simulator = graph.start(SimulatorNode, initial_state=START.tolist())
    given = {"use_sim_time": True, "robot.rotor_axial_inertia": 0.01,
             "robot.max_rotor_speed": 60.0, "robot.max_rotor_acceleration": 50.0}
    controller = graph.start(ControllerNode, **given)
    graph.send_goal(GOAL)
    graph.until(lambda: controller.controller.goal is not None)
    late = Node("viewer")
    graph.add(late)
    source = TopicSource(late)
    graph.until(lambda: newest(source).state is not None and newest(source).goal is not None)
    assert newest(source).radius == pytest.approx(0.3)
    assert state_error(newest(source).goal.pose, GOAL) < 1e-9
    graph.until(lambda: np.all(np.isfinite(newest(source).rotor_speeds)))
    graph.until(lambda: newest(source).strategy != "" and newest(source).alerts == ())
    graph.until(lambda: newest(source).robot == ROBOT)
    setup = "strategy time_optimal; robot radius 0.3 m, rotors up to 60 rad/s; plant rolling"
    graph.until(lambda: newest(source).setup == setup)
    assert set(newest(source).capabilities.strategies) == set(STRATEGIES)

    graph.until(lambda: newest(source).capabilities.pause and newest(source).capabilities.push)
    source.handle(Pause(True))
    graph.until(lambda: newest(source).capabilities.paused)
    source.handle(Pause(False))
    graph.until(lambda: not newest(source).capabilities.paused)
    before = simulator.simulator.plant.momentum
    assert source.handle(ApplyPush((0.3, -0.6))) == ""
    graph.until(lambda: simulator.simulator.plant.momentum.any())
    gained = simulator.simulator.plant.momentum - before
    np.testing.assert_allclose(gained, [0.18, 0.09, 0.0], atol=1e-9)
    graph.until(lambda: newest(source).capabilities.speed is not None)
    source.handle(SetSpeed(2.5))
    graph.until(lambda: simulator.get_parameter("real_time_factor").value == 2.5)
    source.handle(SetStrategy("paper"))
    assert newest(source).strategy == "paper", "shown before any status confirms it"
    graph.until(lambda: controller.get_parameter("strategy").value == "paper")
    assert newest(source).capabilities.reset and source.handle(Reset()) == ""

    graph.until(lambda: newest(source).capabilities.stop)
    for enabled in (False, True):
        assert source.handle(Enable(enabled)) == ""
        graph.until(lambda enabled=enabled: controller.controller.enabled is enabled)
    graph.until(lambda: newest(source).progress.count == 1)
    assert source.handle(Cancel()) == ""
    graph.until(lambda: controller.controller.goal is None)
    graph.until(lambda: newest(source).progress.count == 0)
    assert source.handle(SetPoint((-0.25, 0.5))) == ""
    graph.until(lambda: controller.controller.goal is not None)
    assert controller.controller.goal[:2].tolist() == [-0.25, 0.5]
    drawn = ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0))
    assert source.handle(SetPath(drawn)) == ""
    graph.until(lambda: len(newest(source).path))
    np.testing.assert_allclose(newest(source).path[[0, -1]], [drawn[0], drawn[-1]], atol=1e-9)
    graph.until(lambda: np.isfinite(newest(source).progress.deviation))
    source.handle(Cancel())
    graph.until(lambda: len(newest(source).path) == 0)


def test_requests_that_cannot_be_fulfilled_are_told(graph, source) -> None:
    frame = newest(source)
    assert frame.state is None and frame.robot == RobotParameters()
    assert frame.alerts == ("no pose yet", "no controller yet")
    assert "goal_pose" in source.handle(SetGoal(GOAL))
    assert "goal_point" in source.handle(SetPoint((0.0, 0.0)))
    assert "/path" in source.handle(SetPath(((0.0, 0.0),)))
    assert "pause" in source.handle(Pause(True))
    assert "cancel" in source.handle(Cancel()) and "enable" in source.handle(Enable(True))
    can = frame.capabilities
    assert not (can.pause or can.push or can.stop) and can.speed is None

    def refuse(request, response):
        response.success, response.message = False, "the lid is open"
        return response

    graph.probe.create_service(Trigger, "simulator/reset", refuse)
    graph.until(lambda: newest(source).capabilities.reset)
    source.handle(Reset())
    assert notices(graph, source) == ["the lid is open"] and newest(source).notices == ()

    graph.start(ControllerNode, lockstep=True)
    graph.until(lambda: newest(source).capabilities.strategies)
    source.handle(SetStrategy("paper"))
    assert "lockstep" in notices(graph, source)[0]
    graph.until(lambda: newest(source).strategy == "time_optimal")

    graph.send("pose", pose_to_ros(START, 1, 0.3, "map"))
    graph.until(lambda: "refused" in newest(source).alerts[0])
    assert newest(source).state is None


def test_floor_is_shown_until_it_is_free_and_an_invalid_one_leaves_it(graph, source) -> None:
    floors = graph.probe.create_publisher(OccupancyGrid, "controller/floor", LATCHED)
    cells = np.random.default_rng(1).random((3, 5)) < 0.5
    floors.publish(floor_message(Grid(cells, 0.5, (1.0, -2.0, 0.25)), 10**9, "world"))
    graph.until(lambda: newest(source).floor is not None)
    floor = newest(source).floor
    np.testing.assert_array_equal(floor.occupied, cells)
    assert (floor.resolution, *floor.origin) == pytest.approx((0.5, 1.0, -2.0, 0.25))
    invalid = OccupancyGrid()
    invalid.info.width = invalid.info.height = 2
    invalid.info.resolution = 0.5
    floors.publish(invalid)
    graph.until(lambda: any("floor refused: map: given 0 values" in it
                            for it in newest(source).alerts))
    assert newest(source).floor is floor
    floors.publish(floor_message(None, 2 * 10**9, "world"))
    graph.until(lambda: newest(source).floor is None)
    assert newest(source).alerts == ("no pose yet", "no controller yet")


def test_pose_is_the_estimate_where_there_is_a_true_one(graph, source) -> None:
    graph.start(MarkerNode)
    received = graph.collect(MarkerArray, "markers")
    poses = [graph.publisher(PoseStamped, name) for name in ("ground_truth/pose", "pose")]
    estimate = START + 0.25 * np.eye(6)[0]

    def both_are_drawn() -> bool:
        for publisher, state in zip(poses, (START, estimate), strict=True):
            publisher.publish(pose_to_ros(state, 10**9, 0.3))
        return any(it.ns == "estimate" for array in received[-1:] for it in array.markers)

    graph.until(both_are_drawn)
    graph.until(lambda: both_are_drawn() and newest(source).estimate is not None)
    frame, markers = newest(source), {it.ns: it.pose.position.x for it in received[-1].markers}
    assert (markers["sphere"], markers["estimate"]) == (1.0, 1.25)
    assert (frame.state[0], frame.estimate[0]) == (1.0, 1.25)
    assert frame.estimate_error.tolist() == [0.25, 0.0]


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_markers_are_in_the_size_of_the_robot_and_leave_out_what_no_robot_has(graph) -> None:
    graph.start(MarkerNode)
    received = graph.collect(MarkerArray, "markers")
    poses = graph.publisher(PoseStamped, "pose")
    goals = graph.probe.create_publisher(PoseStamped, "controller/active_goal", LATCHED)
    for i, far in enumerate((float("inf"), 1e300, -1e300, float("nan"))):
        goal = pose_to_ros(START, i, 0.3)
        goal.pose.position.x = far
        goals.publish(goal)
        poses.publish(pose_to_ros(START, i, far))  # its height is that of no robot
        graph.until(lambda i=i: len(received) > i)
    assert received[-1].markers[0].scale.x == 0.6
    radius, steps = PALM.shell_radius, count(1)

    def path_is_drawn() -> bool:
        # Ever further along x: the markers come at their own rate, and miss some of the poses.
        step = next(steps)
        state = START + 0.2 * radius * step * np.eye(6)[0]
        poses.publish(pose_to_ros(state, step * 10**9, radius))
        return any(it.ns == "path" and len(it.points) > 2 for it in received[-1].markers)

    graph.until(path_is_drawn)
    markers = {marker.ns: marker for marker in received[-1].markers}
    assert markers["sphere"].scale.x == 2.0 * radius and "goal" not in markers
    assert markers["path"].scale.x == pytest.approx(0.04 * radius)
    assert markers["path"].points[0].z == pytest.approx(0.01 * radius)
    assert markers["gamma"].action == Marker.ADD and len(markers["gamma"].points) > 50
    assert markers["plan"].action == Marker.DELETE
