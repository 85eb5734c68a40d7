# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The controller node over real DDS, with poses and clock published by the test."""

import math
import time
from itertools import pairwise

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PointStamped, PoseStamped
from nav_msgs.msg import Goals, Path
from rclpy.parameter import Parameter
from rclpy.serialization import serialize_message
from ros_graph import values_of
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64, Float64MultiArray
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory

from sphere_nmpc.conditions import Kind
from sphere_nmpc.floor.floor import Floor
from sphere_nmpc.floor.occupancy import Grid
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.goal import Orientation
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import upright_state
from sphere_nmpc.quantity import NANOSECONDS, stamp_text
from sphere_nmpc.ros.cdr import hold_and_stamp, joint_states_message
from sphere_nmpc.ros.controller import node as controller_node
from sphere_nmpc.ros.controller.command_sender import CommandSender
from sphere_nmpc.ros.controller.node import ControllerNode
from sphere_nmpc.ros.guarded_node import LATCHED
from sphere_nmpc.ros.messages import (
    pose_from_ros,
    pose_to_ros,
    stamp_from_ros,
    stamp_to_ros,
)
from sphere_sim.scenario.scenarios import PAPER_CASES

pytestmark = pytest.mark.slow

CASE = PAPER_CASES[1]
TICK = 20_000_000
"""Spacing of poses and clock messages [ns]."""
AT_REST = 1e-9
"""What a ramp may leave to rounding [rad/s]."""
SPEEDS = np.array([3.0, -4.0])
"""Of the rotors [rad/s]."""
STANDS_STILL = "the clock stands still"


@pytest.fixture(autouse=True)
def _own_goal_files(monkeypatch, tmp_path) -> None:
    """Keep stored goals apart from those of other tests."""
    monkeypatch.setattr(
        "sphere_nmpc.ros.controller.stored_goal.goal_file",
        lambda node: tmp_path / node.get_name(),
    )


class NoPlanningTime:
    """Clocks of the controller node with which plans take no time: commands are dated exactly."""

    monotonic = staticmethod(time.monotonic)

    @staticmethod
    def perf_counter() -> float:
        return 0.0


class CountingNode(ControllerNode):
    """Controller node that counts the poses which it has received."""

    poses = 0

    def _receive_pose(self, message: bytes) -> None:
        self.poses += 1
        super()._receive_pose(message)


class Robot:
    """Publisher of a pose and the clock; `pass_time` lets simulated time run as fast as it can."""

    def __init__(self, graph, **settings) -> None:
        self.graph = graph
        settings = {"use_sim_time": True, "strategy": "paper", **settings}
        self.node = CountingNode([Parameter(k, value=v) for k, v in settings.items()])
        self.lockstep = settings.get("lockstep", False)
        graph.add(self.node)
        self.trajectories = graph.collect(JointTrajectory, "rotor_trajectory")
        self.commands = graph.collect(Float64MultiArray, "rotor_commands")
        self.statuses = graph.collect(DiagnosticStatus, "controller/status")
        self.goals = graph.collect(PoseStamped, "controller/active_goal", LATCHED)
        self.goal_sender = graph.publisher(PoseStamped, "goal_pose")
        self.pose_sender = graph.publisher(PoseStamped, "pose")
        self.clock = graph.publisher(Clock, "/clock")
        self.now = 0
        self.pose = pose_to_ros(CASE.start, 0, 0.3)
        self.publishes_pose = True

    def pass_time(self, duration: float) -> None:
        """Let simulated time pass [s], each tick received before the next."""
        end = self.now + round(duration * 1e9)
        while self.now < end:
            self.now += TICK
            if self.publishes_pose:
                self.pose.header.stamp = stamp_to_ros(self.now)
                received = self.node.poses
                self.pose_sender.publish(self.pose)
                self.graph.spin()
                if self.lockstep:  # where each pose may be that of a sampling instant
                    self.graph.until(lambda: self.node.poses > received)  # noqa: B023
            self.clock.publish(Clock(clock=stamp_to_ros(self.now)))
            self.graph.until(lambda: self.node._control_clock.stamp() == self.now)
        for _ in range(10):
            self.graph.spin()

    def send_goal(self, goal=CASE.goal) -> None:
        received = len(self.goals)
        self.goal_sender.publish(pose_to_ros(goal, 0, 0.3))
        self.graph.until(lambda: len(self.goals) > received)

    def holds(self) -> list:
        """Holds sent, each once: on a busy machine poses are late and commands are repeated."""
        sent = (hold_and_stamp(it, 0)[0] for it in map(serialize_message, self.trajectories))
        return list({hold.start: hold for hold in sent}.values())

    @property
    def reported(self) -> list[DiagnosticStatus]:
        """Statuses while the clock runs: a busy machine may hold it up at any time."""
        return [one for one in self.statuses if values_of(one)["mode"] != STANDS_STILL]

    def status(self) -> dict[str, str]:
        return values_of(self.reported[-1])

    def moved(self) -> bool:
        sent = [hold.speeds for hold in self.holds()] + [np.array(c.data) for c in self.commands]
        return any(np.any(speeds) for speeds in sent)


@pytest.fixture
def robot(graph) -> Robot:
    return Robot(graph)


def assert_joined(holds: list[FirstOrderHold]) -> None:
    """Check that each plan leaves from the speeds that the one before has then."""
    for before, after in pairwise(holds):
        np.testing.assert_allclose(after.speeds[0], before.at(after.start), atol=1e-6)


def assert_within_acceleration(hold: FirstOrderHold) -> None:
    """Check the largest acceleration, times being whole nanoseconds."""
    steps = np.abs(np.diff(hold.speeds, axis=0))
    assert np.all(steps <= 400.0 * (np.diff(hold.times)[:, None] * (1.0 + 1e-6) + 2e-9))


def test_goal_is_answered_with_a_plan_each_sample(robot, monkeypatch) -> None:
    monkeypatch.setattr(controller_node, "time", NoPlanningTime)
    paths = robot.graph.collect(Path, "controller/predicted_path")
    robot.send_goal()
    robot.pose_sender.publish(robot.pose)
    robot.graph.until(lambda: len(robot.statuses) >= 2)
    assert not robot.trajectories and not robot.commands
    assert {values_of(status)["mode"] for status in robot.statuses} == {"no clock yet"}
    # Its poses stand, whatever is sent: what is learnt of that depends on when results arrive.
    off = [Parameter(name, value=False) for name in ("learning", "momentum")]
    assert all(one.successful for one in robot.node.set_parameters(off))
    robot.pass_time(2.2)
    robot.graph.until(lambda: len(robot.trajectories) >= 4 and len(paths) >= 4)
    starts = [hold.start for hold in robot.holds()]
    np.testing.assert_allclose(np.diff(starts), 0.5, atol=0.021, err_msg="to a clock message")
    assert_joined(robot.holds())
    for hold in robot.holds():
        assert np.max(np.abs(hold.speeds)) <= 100.0 + 1e-9
        assert not hold.speeds[-1].any(), "a plan ends at rest"
        assert_within_acceleration(hold)
    data = np.array([command.data for command in robot.commands])
    began = robot.holds()[0].start  # later on a busy machine, where the pace is known later
    assert len(data) == pytest.approx(50.0 * (2.2 - began), abs=4), "one a tick"
    samples = np.array([robot.holds()[-1].at(t) for t in np.arange(0.0, 4.0, 0.01)])
    distance = np.min(np.linalg.norm(samples - data[-1], axis=1))
    assert distance < 2.5, "no further from the hold than half a sample"
    np.testing.assert_allclose(pose_from_ros(robot.goals[-1]), CASE.goal, atol=1e-12)
    assert len(paths[-1].poses) == 5
    # Once the clock stands still for a while, that is what is told.
    on_the_way = [
        one for one in robot.reported if values_of(one)["mode"] == Kind.TRACKING.value
    ]
    status, newest = values_of(on_the_way[-1]), on_the_way[-1]
    # Poses that stand, whatever is sent, may look late.
    told = newest.message.partition(":")[0]
    assert newest.level == DiagnosticStatus.OK or told == Kind.INEXACT_STAMPS.log, newest.message
    assert status["strategy"] == "paper" and status["plan"] == "solved"
    assert float(status["error"]) > 1.0
    # A status that is repeated on a busy machine has none.
    assert any(float(values_of(one)["solve_time_s"]) > 0.0 for one in robot.reported)
    assert status["missed_ticks"] == "0"
    assert int(status["stability_steps"]) >= 1
    nominal = RobotParameters().lumped.as_array()
    for name, value in zip(("shell_radius_m", "c1", "r1", "r3"), nominal, strict=True):
        # The pose of the test does not move, which no constants within their range explain.
        assert 0.5 * value <= float(status[f"learnt_{name}"]) <= 1.6 * value


def test_wrong_pose_or_goal_is_logged_once_and_has_no_effect(robot, capfd) -> None:
    robot.send_goal()
    robot.pose.pose.position.x = math.nan
    wrong = pose_to_ros(CASE.start, 0, 0.3)
    wrong.pose.orientation.w = 0.5
    for _ in range(5):
        robot.goal_sender.publish(wrong)
        robot.pass_time(0.2)
    robot.graph.until(lambda: robot.reported)
    assert not robot.moved()
    assert robot.status()["mode"] == "no pose yet"
    np.testing.assert_array_equal(robot.node.controller.goal, CASE.goal)
    assert len(robot.goals) == 1
    printed = capfd.readouterr().err
    for kind, words in (("pose", "expected finite numbers"), ("goal_pose", "expected norm 1")):
        (line,) = (line for line in printed.splitlines() if f": {kind} refused" in line)
        assert words in line


def test_stale_pose_ramps_to_rest(robot) -> None:
    robot.send_goal()
    robot.pass_time(1.2)
    assert robot.moved()
    robot.publishes_pose = False
    robot.pass_time(1.5)
    assert robot.reported[-1].level == DiagnosticStatus.ERROR
    assert robot.status()["mode"] == "no fresh pose, stopping"
    np.testing.assert_allclose(robot.node.controller.speeds_at(robot.now / 1e9), 0.0, atol=AT_REST)
    np.testing.assert_allclose(robot.commands[-1].data, 0.0, atol=AT_REST)


def test_disable_ramps_to_rest_immediately_and_enable_resumes(robot, capfd) -> None:
    robot.send_goal()
    robot.pass_time(1.25)
    received = len(robot.trajectories)
    answer = robot.graph.call(SetBool, "controller/enable", SetBool.Request(data=False))
    assert answer.success
    robot.graph.until(lambda: len(robot.trajectories) > received)
    ramp = robot.holds()[-1]
    assert ramp.end - ramp.start <= 0.25 + 1e-6
    assert not ramp.speeds[-1].any()
    robot.pass_time(1.0)
    assert robot.status()["mode"] == "disabled"
    np.testing.assert_allclose(robot.commands[-1].data, 0.0, atol=AT_REST)
    received = len(robot.trajectories), len(robot.commands)
    robot.pass_time(0.5)
    assert (len(robot.trajectories), len(robot.commands)) == received, "others may drive it"
    assert capfd.readouterr().err.count("enable: disabled, the sphere stops") == 1
    robot.node._event_log._period = 0.0  # told at once, however soon after the line before
    robot.graph.call(SetBool, "controller/enable", SetBool.Request(data=True))
    robot.pass_time(1.0)
    assert robot.status()["mode"] == "on the way to the goal"
    assert capfd.readouterr().err.count("enable: enabled") == 1


def test_arrival_is_published_until_there_is_another_goal(robot, capfd) -> None:
    arrivals = robot.graph.collect(Bool, "controller/at_goal", LATCHED)
    robot.graph.until(lambda: arrivals and not arrivals[-1].data)
    robot.send_goal(CASE.start)
    robot.pass_time(0.3)
    assert not arrivals[-1].data, "not before it has stayed for a sample period"
    robot.pass_time(0.7)
    robot.graph.until(lambda: arrivals[-1].data)
    assert robot.status()["mode"] == "at the goal"
    assert robot.reported[-1].level == DiagnosticStatus.OK
    assert capfd.readouterr().err.count("arrival: at the goal after 0.00 s, error 0\n") == 1
    robot.send_goal()
    robot.graph.until(lambda: not arrivals[-1].data)
    robot.pass_time(0.6)
    assert robot.status()["mode"] == "on the way to the goal"
    assert [arrival.data for arrival in arrivals] == [False, True, False]


def test_each_goal_is_shown_at_once_and_not_as_reached_with_the_one_before(robot) -> None:
    robot.send_goal(CASE.start)
    robot.pass_time(1.0)
    assert robot.status()["mode"] == "at the goal"
    robot.statuses.clear()
    for stamp in (5, 6):  # without an instant between
        robot.goal_sender.publish(pose_to_ros(CASE.goal, stamp, 0.3))
        robot.graph.until(lambda: shown(robot, f"0.{stamp:09}"))  # noqa: B023
    for status in shown(robot, "0.000000005") + shown(robot, "0.000000006"):
        assert status["mode"] != "at the goal"


def test_new_goal_shows_nothing_of_one_that_was_given_up(robot) -> None:
    free = Grid(np.zeros((60, 60), dtype=bool), 0.1, (-1.0, -6.0, 0.0))
    robot.node.controller.floor = Floor(free, 0.3, 0.02)
    robot.send_goal(upright_state(-9.0, 0.0, 0.0))
    robot.pass_time(8.0)
    status = robot.status()
    assert (status["mode"], status["unreachable"]) == (
        "no progress towards the goal", "goal outside"
    )
    assert float(status["total_distance_left_m"]) > 9.0
    robot.node.controller.floor = None
    robot.statuses.clear()
    robot.goal_sender.publish(pose_to_ros(CASE.goal, 7, 0.3))
    robot.graph.until(lambda: shown(robot, "0.000000007"))
    first = shown(robot, "0.000000007")[0]
    assert first["mode"] == "on the way to the goal"
    assert first["unreachable"] == first["giving_up"] == first["no_progress"] == ""
    assert float(first["total_time_left_s"]) > 2.0, "along a straight line until there is a plan"


def shown(robot, stamp: str) -> list[dict[str, str]]:
    """Return the statuses that show the goal with a stamp."""
    return [values for values in map(values_of, robot.statuses) if values["goal_stamp"] == stamp]


def test_cancel_stops_and_leaves_no_goal(robot) -> None:
    robot.send_goal()
    robot.pass_time(1.25)
    received = len(robot.trajectories)
    answer = robot.graph.call(Trigger, "controller/cancel", Trigger.Request())
    assert answer.success and answer.message == "cancelled, the sphere stops"
    robot.graph.until(lambda: len(robot.trajectories) > received)
    assert not robot.holds()[-1].speeds[-1].any()
    robot.pass_time(1.0)
    status = robot.status()
    assert (status["mode"], status["goal_stamp"], status["goal_count"]) == ("no goal", "", "0")
    assert (status["goal_orientation"], status["active_goal_stamp"]) == ("", "")
    assert status["at_rest"] == "true"
    answer = robot.graph.call(Trigger, "controller/cancel", Trigger.Request())
    assert answer.success and answer.message == "no goal was in force"
    robot.send_goal()
    robot.pass_time(0.6)
    assert robot.status()["mode"] == "on the way to the goal"


def test_point_and_list_are_goals_known_by_their_stamps(robot, capfd) -> None:
    eta = robot.graph.collect(Float64, "controller/eta", 10)
    point = PointStamped()
    point.header.stamp.sec, point.header.stamp.nanosec = 7, 42
    point.point.x = float(CASE.start[0])
    point.point.y = float(CASE.start[1])
    sender = robot.graph.publisher(PointStamped, "goal_point")
    robot.graph.until(lambda: sender.get_subscription_count() > 0)
    sender.publish(point)
    robot.graph.until(lambda: robot.goals)
    robot.pass_time(1.0)
    status = robot.status()
    assert status["goal_stamp"] == "7.000000042"
    assert status["mode"] == "at the goal", "whatever its orientation"
    robot.graph.until(lambda: eta and eta[-1].data == 0.0)
    assert robot.node.controller.goal_sequence.goal.orientation is Orientation.ANY
    assert status["goal_orientation"] == "any" and float(status["angle_error_rad"]) == 0.0
    assert status["active_goal_stamp"] == stamp_of_message(robot.goals[-1])
    told = f"goal: {[round(float(v), 4) for v in CASE.start[:2]]}, position only\n"
    assert told in capfd.readouterr().err

    several = Goals(goals=[pose_to_ros(pose, 0, 0.3) for pose in (CASE.start, CASE.goal)])
    sender = robot.graph.publisher(Goals, "goals")
    robot.graph.until(lambda: sender.get_subscription_count() > 0)
    sender.publish(several)
    robot.graph.until(lambda: robot.status()["goal_count"] == "2")
    robot.pass_time(1.0)
    status = robot.status()
    assert (status["goal_index"], status["goal_count"]) == ("1", "2"), "the first was reached"
    robot.graph.until(lambda: len(robot.goals) == 3)
    np.testing.assert_allclose(pose_from_ros(robot.goals[-1]), CASE.goal, atol=1e-12)
    assert status["goal_orientation"] == "full"
    assert status["active_goal_stamp"] == stamp_of_message(robot.goals[-1])

    several.goals[1].pose.position.x = math.nan
    sender.publish(several)
    sender.publish(Goals())
    printed = ""
    while printed.count("goals refused") < 1:
        robot.pass_time(0.1)
        printed += capfd.readouterr().err
    assert robot.status()["goal_count"] == "2", "the goals in force stay"


def stamp_of_message(message: PoseStamped) -> str:
    return stamp_text(stamp_from_ros(message.header.stamp))


@pytest.mark.parametrize(
    ("number", "told"),
    [(501, "given '501 goals', expected at most 500; the goal in force stays"),
     (20_000, "given '1440028 bytes', expected at most 500 goals")],
)
def test_list_that_takes_long_to_be_read_is_refused(robot, capfd, number, told) -> None:
    robot.send_goal()
    sender = robot.graph.publisher(Goals, "goals")
    robot.graph.until(lambda: sender.get_subscription_count() > 0)
    sender.publish(Goals(goals=[pose_to_ros(CASE.start, 0, 0.3, "")] * number))
    printed = ""
    while "goals refused" not in printed:
        robot.pass_time(0.1)
        printed += capfd.readouterr().err
    assert f"goals refused: goals: {told}" in printed
    assert robot.status()["goal_count"] == "1"


def test_status_and_diagnostics_are_published_while_time_stands_still(robot) -> None:
    reports = robot.graph.collect(DiagnosticArray, "/diagnostics")
    robot.send_goal()
    robot.pass_time(0.7)
    robot.graph.until(lambda: values_of(robot.statuses[-1])["mode"] == STANDS_STILL)
    received = len(robot.statuses)
    robot.graph.until(lambda: len(robot.statuses) >= received + 2)
    status = values_of(robot.statuses[-1])
    assert status["mode"] == STANDS_STILL
    assert float(status["solve_time_s"]) == 0.0, "a solve is reported once"
    robot.graph.until(lambda: "clock stopped" in robot.statuses[-1].message)
    assert robot.statuses[-1].level == DiagnosticStatus.ERROR
    robot.graph.until(lambda: reports and reports[-1].status[1].message == "clock stopped")
    assert [one.name for one in reports[-1].status] == ["controller: solver", "controller: loop"]
    values = values_of(reports[-1].status[0])
    assert values["failures"] == "0" and float(values["median ms"]) > 0.0
    robot.pass_time(0.7)
    assert robot.status()["mode"] == "on the way to the goal"


def started_again(robot: Robot, **settings) -> ControllerNode:
    """End the controller of a robot in good order and start another one."""
    robot.node.finish()
    robot.graph.remove(robot.node)
    settings = {"use_sim_time": True, **settings}
    robot.node = CountingNode([Parameter(k, value=v) for k, v in settings.items()])
    robot.graph.add(robot.node)
    robot.graph.until(lambda: robot.clock.get_subscription_count() > 0)
    return robot.node


@pytest.mark.parametrize(
    ("memory", "enabled"), [(30.0, True), (0.0, True), (30.0, False)],
    ids=["wanted", "not wanted", "was disabled"],
)
def test_goal_in_force_is_restored_after_a_restart_where_wanted(graph, memory, enabled) -> None:
    robot = Robot(graph, goal_memory=memory)
    robot.send_goal()
    robot.pass_time(0.5)
    if not enabled:
        graph.call(SetBool, "controller/enable", SetBool.Request(data=False))
    second = started_again(robot, goal_memory=memory)
    robot.pass_time(0.3)
    graph.until(lambda: second._stored_goal.is_settled)
    if memory and enabled:
        np.testing.assert_allclose(second.controller.goal, CASE.goal, atol=1e-12)
        graph.until(lambda: len(robot.goals) == 2)
    else:
        assert second.controller.goal is None


def test_measured_rotor_speeds_are_heard_while_they_are_needed(robot, monkeypatch) -> None:
    heard: list[tuple[float, np.ndarray]] = []
    controller = robot.node.controller
    monkeypatch.setattr(controller, "observe_rotors", lambda *given: heard.append(given))
    publisher = robot.graph.publisher(JointState, "joint_states")
    robot.pass_time(0.3)

    def is_heard() -> bool:
        # Again and again: the subscription is best effort, and such a message may be lost.
        for stamp in (robot.now + 10**12, robot.now):
            publisher.publish(joint_states_message(np.zeros(2), SPEEDS, np.zeros(2), stamp))
        return bool(heard)

    robot.graph.until(is_heard)
    for time_of, speeds in heard:
        assert time_of == pytest.approx(robot.now * 1e-9), "not the one of another clock"
        assert speeds.tolist() == SPEEDS.tolist()

    # Whether they are is a test of `RotorFeedback`; poses read late look like those of a link.
    monkeypatch.setattr(type(controller.rotor_feedback), "is_needed", False)
    robot.graph.until(lambda: publisher.get_subscription_count() == 0)


def test_use_sim_time_that_is_unset_while_the_node_runs_is_told_with_its_remedy(robot) -> None:
    robot.send_goal()
    robot.pass_time(0.6)
    robot.node.set_parameters([Parameter("use_sim_time", value=False)])
    assert not robot.node._control_clock.simulated

    def message() -> str:
        robot.now += TICK
        robot.pose.header.stamp = stamp_to_ros(robot.now)
        robot.pose_sender.publish(robot.pose)
        return robot.statuses[-1].message

    robot.graph.until(lambda: "wrong clock" in message())
    assert message().endswith("in simulated time: start this node with -p use_sim_time:=true")
    robot.node.set_parameters([Parameter("use_sim_time", value=True)])
    assert robot.node._control_clock.simulated and robot.node._control_clock.epoch == 0
    robot.graph.until(lambda: robot.clock.get_subscription_count() > 0)
    robot.pass_time(1.2)
    assert robot.status()["mode"] == "on the way to the goal"


def until_on_the_way(robot) -> None:
    """Let time pass until the clock counts as steady and the controller tracks its goal."""
    robot.pass_time(0.1)  # those under way are about the time before
    robot.statuses.clear()

    def is_on_the_way() -> bool:
        robot.pass_time(0.1)
        return bool(robot.reported) and robot.status()["mode"] == "on the way to the goal"

    robot.graph.until(is_on_the_way)


def test_clock_that_goes_back_forgets_poses_and_keeps_the_goal(robot, capfd) -> None:
    robot.send_goal()
    robot.pass_time(1.2)
    robot.now = 0
    until_on_the_way(robot)
    ahead = float(robot.status()["time_s"]) - robot.now * 1e-9
    assert ahead <= 0.25, "half a sample ahead at the most"
    printed = capfd.readouterr().err
    assert printed.count("clock jumped: given a step of -1.18 s") == 1
    assert printed.count("clock: runs on at another time; poses and plans are dropped") == 1


@pytest.mark.parametrize("returns", [True, False], ids=["one forged message", "the clock is set"])
def test_no_command_is_ahead_of_a_clock_that_jumps_ahead(
    robot, capfd, monkeypatch, returns
) -> None:
    published, repeat = [], CommandSender.repeat
    monkeypatch.setattr(
        CommandSender, "repeat", lambda sender: (published.append(robot.now), repeat(sender))
    )
    robot.send_goal()
    until_on_the_way(robot)
    before = robot.now
    for _ in range(3):
        robot.clock.publish(Clock(clock=stamp_to_ros(robot.now + 3600 * NANOSECONDS)))
        robot.graph.until(lambda: robot.node._control_clock.stamp() > robot.now + TICK)
        if not returns:
            robot.now += 3600 * NANOSECONDS
        sent = len(published)
        robot.node._sender._copies = 1  # as where commands are often lost
        robot.pass_time(0.05)
        # On a busy machine the clock has run on for long enough meanwhile.
        assert len(published) == sent or robot.node._control_clock.watch.is_steady
    # With true planning times, which a busy machine makes long.
    until_on_the_way(robot)
    robot.pass_time(1.0)
    after, holds = robot.now - before, robot.holds()
    assert max(hold.start for hold in holds) <= robot.now * 1e-9 + 0.5
    assert max(hold.end for hold in holds) <= robot.now * 1e-9 + 4.0
    if returns:
        assert after < 3600 * NANOSECONDS
        assert_joined(holds)
    printed = capfd.readouterr().err
    assert printed.count("clock jumped: given a step of +3600 s") == 1
    assert ("runs on at another time" in printed) is not returns


def test_nanoseconds_are_resolved_at_the_time_of_a_bag_that_is_played(robot) -> None:
    robot.pass_time(0.5)
    robot.now = played = 1_764_000_000 * NANOSECONDS
    robot.send_goal()
    until_on_the_way(robot)
    clock = robot.node._control_clock
    step = clock.time_of(robot.now + 1) - clock.time_of(robot.now)
    assert step == pytest.approx(1e-9, abs=2e-10), "control time is below 1e6 s"
    sent = len(robot.trajectories)
    robot.pass_time(1.0)
    for message in robot.trajectories[sent:]:
        assert_within_acceleration(hold_and_stamp(serialize_message(message), played)[0])


def test_lockstep_answers_each_sample_instant_and_repeats_its_answer(graph) -> None:
    robot = Robot(graph, lockstep=True)
    robot.pass_time(0.6)
    robot.graph.until(lambda: len(robot.trajectories) == 1)
    assert not robot.moved()
    robot.send_goal()
    robot.pass_time(1.0)
    robot.graph.until(lambda: len(robot.trajectories) == 3)
    stamps = [stamp_from_ros(message.header.stamp) for message in robot.trajectories]
    assert stamps == [500_000_000, 1_000_000_000, 1_500_000_000]
    assert robot.moved()
    robot.pass_time(0.4)
    robot.pose_sender.publish(robot.pose)
    graph.until(lambda: len(robot.trajectories) == 5)
    assert robot.trajectories[3] == robot.trajectories[4]
    robot.send_goal(CASE.start)
    robot.pose_sender.publish(robot.pose)
    graph.until(lambda: len(robot.trajectories) == 6)
    assert robot.trajectories[5].header == robot.trajectories[4].header
    assert robot.trajectories[5] != robot.trajectories[4], "the goal is new"


def test_strategy_can_be_changed_on_the_way(graph, capfd) -> None:
    robot = Robot(graph, strategy="paper")
    robot.send_goal()
    robot.pass_time(1.2)
    graph.until(lambda: robot.reported and robot.status()["mode"] == "on the way to the goal")
    results = robot.node.set_parameters([Parameter("strategy", value="time_optimal")])
    assert results[0].successful, results[0].reason
    assert capfd.readouterr().err.count("strategy: time_optimal") == 1
    changed = robot.now * 1e-9
    robot.pass_time(1.6)
    graph.until(lambda: robot.status()["strategy"] == "time_optimal")
    assert "stability_steps" not in robot.status()
    graph.until(lambda: robot.holds()[-1].start > changed + 1.2)
    starts = np.array([hold.start for hold in robot.holds()])
    # A plan that takes effect when it was made for begins later than its instant.
    assert np.median(np.diff(starts[starts > changed])) == pytest.approx(0.25, abs=0.05)
    assert_joined(robot.holds())
