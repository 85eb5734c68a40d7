# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The controller node over real DDS, with poses and clock published by the test."""

import math
import re
import time
from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PointStamped, PoseStamped
from nav_msgs.msg import Goals, Path
from rclpy.parameter import Parameter
from rclpy.serialization import serialize_message
from ros_graph import forget_faults, running_graph, values_of
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64, Float64MultiArray
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory

from sphere_nmpc.floor.floor import Floor
from sphere_nmpc.floor.occupancy import Grid
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.state import upright_state
from sphere_nmpc.quantity import NANOSECONDS, stamp_text
from sphere_nmpc.reporting.conditions import Kind
from sphere_nmpc.ros.cdr import hold_and_stamp
from sphere_nmpc.ros.cdr_messages import joint_states_message
from sphere_nmpc.ros.controller import node as controller_node
from sphere_nmpc.ros.controller.command_sender import CommandSender
from sphere_nmpc.ros.controller.node import ControllerNode
from sphere_nmpc.ros.guarded_node import LATCHED
from sphere_nmpc.ros.messages import pose_from_ros, pose_to_ros, stamp_from_ros, stamp_to_ros
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


class NoPlanningTime:
    """Clocks of the controller node with which plans take no time: commands are dated exactly."""

    monotonic = staticmethod(time.monotonic)

    @staticmethod
    def perf_counter() -> float:
        return 0.0


class Robot:
    """Publisher of a pose and the clock; `pass_time` lets simulated time run as fast as it can."""

    def __init__(self, graph, **settings) -> None:
        self.graph = graph
        self.node = self._started(settings)
        self.trajectories = graph.collect(JointTrajectory, "rotor_trajectory")
        self.commands = graph.collect(Float64MultiArray, "rotor_commands")
        self.statuses = graph.collect(DiagnosticStatus, "controller/status")
        self.goals = graph.collect(PoseStamped, "controller/active_goal", LATCHED)
        self.goal_sender = graph.publisher(PoseStamped, "goal_pose")
        self.pose_sender = graph.publisher(PoseStamped, "pose")
        self.clock = graph.publisher(Clock, "/clock")
        self.now = 0
        self.pose = pose_to_ros(CASE.start, 0, 0.3)
        self.pose_sender.publish(self.pose)
        graph.until(lambda: len(self.statuses) >= 2)
        self.at_first = [values_of(status)["mode"] for status in self.statuses]
        """Modes of the statuses before the first message of the clock."""

    def _started(self, settings: dict[str, object]) -> ControllerNode:
        # The poses of the test stand, whatever is sent; what is learnt of that depends on when
        # results arrive.
        settings = {"use_sim_time": True, "strategy": "paper", "learning": False,
                    "momentum": False, **settings}
        return self.graph.start(ControllerNode, **settings)

    def start_again(self, **settings) -> None:
        """End the controller in good order and start another one."""
        self.node.finish()
        self.graph.remove(self.node)
        self.node = self._started(settings)
        self.graph.until(lambda: self.clock.get_subscription_count() > 0)
        self.pass_time(0.3)
        self.graph.until(lambda: self.node._stored_goal.is_settled)

    def rest(self) -> None:
        """Come to rest without a goal, and forget what was received."""
        self.pose = pose_to_ros(CASE.start, 0, 0.3)
        self.call(SetBool, "enable", SetBool.Request(data=True))
        self.call(Trigger, "cancel")

        def is_at_rest() -> bool:
            self.statuses.clear()
            self.pass_time(0.2)
            return bool(self.reported) and (
                (self.status()["mode"], self.status()["at_rest"]) == ("no goal", "true")
            )

        self.graph.until(is_at_rest)
        for received in (self.trajectories, self.commands, self.statuses, self.goals):
            received.clear()
        forget_faults(self.node)

    def call(self, kind: Any, name: str, request: Any = None) -> Any:
        return self.graph.call(kind, f"controller/{name}", request or kind.Request())

    def send(self, topic: str, message: Any) -> None:
        self.graph.publisher(type(message), topic).publish(message)

    def pass_time(self, duration: float) -> None:
        """Let simulated time pass [s]."""
        end = self.now + round(duration * 1e9)
        while self.now < end:
            self.now += TICK
            self.pose.header.stamp = stamp_to_ros(self.now)
            self.pose_sender.publish(self.pose)
            self.graph.spin()
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


@pytest.fixture(scope="module")
def shared(request, tmp_path_factory) -> Iterator[Robot]:
    """Return the robot of several tests; a parameter is the settings of its controller."""
    with pytest.MonkeyPatch.context() as patch, running_graph() as graph:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))  # the stored goal
        yield Robot(graph, **getattr(request, "param", {}))


@pytest.fixture
def robot(shared) -> Robot:
    """Return the robot at rest without a goal."""
    if shared.now:
        shared.rest()
    return shared


@pytest.fixture
def begun(robot) -> Robot:
    """Return the robot with a controller that begins, and a clock whose pace it knows."""
    robot.now = 0
    robot.start_again()

    def has_pace() -> bool:
        robot.pass_time(0.1)
        return robot.node._control_clock.watch.pace is not None

    robot.graph.until(has_pace)
    robot.trajectories.clear()
    return robot


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
    assert set(robot.at_first) == {"no clock yet"}
    paths = robot.graph.collect(Path, "controller/predicted_path")
    robot.pass_time(0.3)
    assert not robot.moved()
    robot.trajectories.clear()
    robot.commands.clear()
    began, missed = robot.now * 1e-9, robot.status().get("missed_ticks", "0")
    robot.send_goal()
    robot.pass_time(2.2)
    robot.graph.until(lambda: len(robot.trajectories) >= 4 and len(paths) >= 4)
    holds = robot.holds()
    np.testing.assert_allclose(
        np.diff([hold.start for hold in holds]), 0.5, atol=0.021, err_msg="to a clock message"
    )
    assert_joined(holds)
    for hold in holds:
        assert np.max(np.abs(hold.speeds)) <= 100.0 + 1e-9
        assert not hold.speeds[-1].any(), "a plan ends at rest"
        assert_within_acceleration(hold)
    data = np.array([command.data for command in robot.commands])
    lasted = robot.now * 1e-9 - holds[0].start  # which is later on a busy machine
    assert len(data) == pytest.approx(50.0 * lasted, abs=4), "one a tick"
    samples = np.array([holds[-1].at(t) for t in began + np.arange(0.0, 4.0, 0.01)])
    distance = np.min(np.linalg.norm(samples - data[-1], axis=1))
    assert distance < 2.5, "no further from the hold than half a sample"
    np.testing.assert_allclose(pose_from_ros(robot.goals[-1]), CASE.goal, atol=1e-12)
    assert len(paths[-1].poses) == 5
    # Once the clock stands still for a while, that is what is told.
    on_the_way = [
        one for one in robot.reported if values_of(one)["mode"] == Kind.TRACKING.value
    ]
    status, newest = values_of(on_the_way[-1]), on_the_way[-1]
    # Poses that stand, whatever is sent, may look late, or as of a robot that hardly rolls.
    told = newest.message.partition(":")[0]
    is_ok = newest.level == DiagnosticStatus.OK
    faults = Kind.INEXACT_STAMPS.log, Kind.OTHER_ROBOT.log
    assert told in ([Kind.TRACKING.value] if is_ok else faults), newest.message
    assert (status["strategy"], status["plan"], status["missed_ticks"]) == (
        "paper", "solved", missed
    )
    assert float(status["error"]) > 1.0 and int(status["stability_steps"]) >= 1
    # A status that is repeated on a busy machine has none.
    assert any(float(values_of(one)["solve_time_s"]) > 0.0 for one in robot.reported)


def test_wrong_poses_are_told_once_and_without_fresh_ones_the_rotors_ramp_to_rest(
    robot, capfd
) -> None:
    robot.send_goal()
    robot.pass_time(1.2)
    assert robot.moved()
    robot.pose.pose.position.x = math.nan
    robot.pass_time(1.5)
    assert robot.reported[-1].level == DiagnosticStatus.ERROR
    assert robot.status()["mode"] == "no fresh pose, stopping"
    np.testing.assert_allclose(robot.node.controller.speeds_at(robot.now / 1e9), 0.0, atol=AT_REST)
    np.testing.assert_allclose(robot.commands[-1].data, 0.0, atol=AT_REST)
    (line,) = (it for it in capfd.readouterr().err.splitlines() if ": pose refused" in it)
    assert "expected finite numbers" in line


def several(number: int, **changes: float) -> Goals:
    """Return goals, of which the first has a changed position or orientation."""
    goals = Goals(goals=[pose_to_ros(CASE.start, 0, 0.3, "") for _ in range(number)])
    for name, value in changes.items():
        first = goals.goals[0].pose
        setattr(first.orientation if name == "w" else first.position, name, value)
    return goals


@pytest.mark.parametrize(
    ("message", "told"),
    [
        (several(1, w=0.5).goals[0], "goal_pose refused: .* expected norm 1"),
        (several(2, x=math.nan), "goals refused: .* expected finite numbers"),
        (several(0), "goals refused: .*given \\[\\]"),
        (several(501), "goals refused: goals: given 501 goals, expected at most 500; the goal "
         "in force stays"),
        (several(20_000), "goals refused: goals: given 1440028 bytes, expected at most 500"),
    ],
    ids=["norm", "nan", "none", "many", "too many to be read"],
)
def test_goal_that_cannot_be_used_is_told_and_the_one_in_force_stays(
    robot, capfd, message, told
) -> None:
    robot.send_goal()
    topic = "goals" if isinstance(message, Goals) else "goal_pose"
    robot.send(topic, message)
    robot.graph.until(lambda: robot.node._fault_log.counts[f"{topic} refused"] == 1)
    assert re.search(told, capfd.readouterr().err)
    np.testing.assert_array_equal(robot.node.controller.goal, CASE.goal)
    assert len(robot.goals) == 1


def stopped_at_once(robot: Robot, kind: Any, name: str, request: Any) -> str:
    """Return the answer to a request on the way to a goal, with which the rotors ramp to rest."""
    robot.send_goal()
    robot.pass_time(1.25)
    received = len(robot.trajectories)
    answer = robot.call(kind, name, request)
    assert answer.success
    robot.graph.until(lambda: len(robot.trajectories) > received)
    ramp = robot.holds()[-1]
    assert ramp.end - ramp.start <= 0.25 + 1e-9 * TICK and not ramp.speeds[-1].any()
    robot.pass_time(1.0)
    np.testing.assert_allclose(robot.commands[-1].data, 0.0, atol=AT_REST)
    return answer.message


def test_disable_stops_at_once_and_leaves_the_rotors_to_others_until_enable(robot, capfd) -> None:
    stopped_at_once(robot, SetBool, "enable", SetBool.Request(data=False))
    assert robot.status()["mode"] == "disabled"
    received = len(robot.trajectories), len(robot.commands)
    robot.pass_time(0.5)
    assert (len(robot.trajectories), len(robot.commands)) == received
    assert capfd.readouterr().err.count("enable: disabled, the sphere stops") == 1
    forget_faults(robot.node)
    robot.call(SetBool, "enable", SetBool.Request(data=True))
    robot.pass_time(1.0)
    assert robot.status()["mode"] == "on the way to the goal"
    assert capfd.readouterr().err.count("enable: enabled") == 1


def test_cancel_stops_at_once_and_leaves_no_goal(robot) -> None:
    told = stopped_at_once(robot, Trigger, "cancel", Trigger.Request())
    assert told == "cancelled, the sphere stops"
    status = robot.status()
    assert (status["mode"], status["goal_stamp"], status["goal_count"]) == ("no goal", "", "0")
    assert (status["goal_orientation"], status["active_goal_stamp"]) == ("", "")
    assert status["at_rest"] == "true"
    answer = robot.call(Trigger, "cancel")
    assert answer.success and answer.message == "no goal was in force"
    robot.send_goal()
    robot.pass_time(0.6)
    assert robot.status()["mode"] == "on the way to the goal"


def test_arrival_is_published_until_there_is_another_goal(begun, capfd) -> None:
    robot = begun
    arrivals = robot.graph.collect(Bool, "controller/at_goal", LATCHED)
    robot.graph.until(lambda: arrivals and not arrivals[-1].data)
    robot.send_goal(CASE.start)
    robot.pass_time(0.3)
    assert not arrivals[-1].data, "not before it has stayed for a sample period"
    robot.pass_time(0.7)
    robot.graph.until(lambda: arrivals[-1].data)
    assert robot.status()["mode"] == "at the goal"
    newest = robot.reported[-1]
    assert newest.message == "at the goal" or newest.level != DiagnosticStatus.OK
    assert capfd.readouterr().err.count("arrival: at the goal after 0.00 s, error 0\n") == 1
    robot.statuses.clear()
    for stamp in (5, 6):  # without an instant between
        robot.goal_sender.publish(pose_to_ros(CASE.goal, stamp, 0.3))
        robot.graph.until(lambda: shown(robot, f"0.{stamp:09}"))  # noqa: B023
    for status in shown(robot, "0.000000005") + shown(robot, "0.000000006"):
        assert status["mode"] != "at the goal"
    robot.graph.until(lambda: not arrivals[-1].data)
    until_on_the_way(robot)
    assert [arrival.data for arrival in arrivals] == [False, True, False]


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


def test_point_and_list_are_goals_known_by_their_stamps(robot, capfd) -> None:
    eta = robot.graph.collect(Float64, "controller/eta", 10)
    point = PointStamped()
    point.header.stamp.sec, point.header.stamp.nanosec = 7, 42
    point.point.x = float(CASE.start[0])
    point.point.y = float(CASE.start[1])
    robot.send("goal_point", point)
    robot.graph.until(lambda: robot.goals)
    robot.pass_time(1.0)
    status = robot.status()
    assert status["goal_stamp"] == "7.000000042"
    assert status["mode"] == "at the goal", "whatever its orientation"
    robot.graph.until(lambda: eta and eta[-1].data == 0.0)
    assert status["goal_orientation"] == "any" and float(status["angle_error_rad"]) == 0.0
    assert status["active_goal_stamp"] == stamp_text(stamp_from_ros(robot.goals[-1].header.stamp))
    told = f"goal: {[round(float(v), 4) for v in CASE.start[:2]]}, position only\n"
    assert told in capfd.readouterr().err

    robot.send("goals", Goals(goals=[pose_to_ros(it, 0, 0.3) for it in (CASE.start, CASE.goal)]))
    robot.graph.until(lambda: robot.status()["goal_count"] == "2")
    robot.pass_time(1.0)
    status = robot.status()
    assert (status["goal_index"], status["goal_count"]) == ("1", "2"), "the first was reached"
    # Of goals that follow each other at once a subscription may receive the last one alone.
    robot.graph.until(lambda: len(robot.goals) > 1)
    robot.graph.until(lambda: np.allclose(pose_from_ros(robot.goals[-1]), CASE.goal, atol=1e-12))
    assert status["goal_orientation"] == "full"
    assert status["active_goal_stamp"] == stamp_text(stamp_from_ros(robot.goals[-1].header.stamp))


def path_of(*places: tuple[float, float], frame: str = "") -> Path:
    """Return the path of poses with quaternions of zeros, as planners send them."""
    path = Path(poses=[PoseStamped() for _ in places])
    path.header.frame_id = frame
    for pose, (x, y) in zip(path.poses, places, strict=True):
        pose.pose.position.x, pose.pose.position.y = x, y
        pose.pose.orientation.w = 0.0
    return path


def test_path_is_followed_and_shown_and_one_without_a_length_is_a_place(robot, capfd) -> None:
    shown = robot.graph.collect(Path, "controller/path", LATCHED)
    x, y = CASE.start[:2].tolist()
    corner = path_of((x, y), (x + 1.0, y), (x + 1.0, y + 1.0))
    corner.header.stamp.sec = 7
    robot.send("path", corner)
    robot.graph.until(lambda: shown and shown[-1].poses)
    places = np.array([pose_from_ros(pose)[:2] for pose in shown[-1].poses])
    np.testing.assert_allclose(places[[0, -1]], [[x, y], [x + 1.0, y + 1.0]], atol=1e-9)
    away = np.minimum(abs(places[:, 1] - y), abs(places[:, 0] - x - 1.0))
    assert 0.0 < away.max() < 0.02, "corners are cut within path_tolerance"
    heading = shown[-1].poses[-1].pose.orientation
    assert (heading.w, heading.z) == pytest.approx((0.5**0.5, 0.5**0.5), abs=1e-3)
    assert shown[-1].header.stamp.sec == 7
    robot.pass_time(0.3)
    status = robot.status()
    assert (status["goal_stamp"], status["goal_count"]) == ("7.000000000", "1")
    assert status["goal_orientation"] == "any"
    told = f"m along a path to [{x + 1.0}, {y + 1.0}], position only\n"
    assert told in capfd.readouterr().err

    there_and_back = path_of((x, y), (x + 1.0, y), (x, y))
    there_and_back.poses[-1].pose.orientation.w = 1.0
    for demanded, legs in (("full", "3"), ("any", "2")):
        given = Parameter("path_end_orientation", value=demanded)
        assert robot.node.set_parameters([given])[0].successful
        robot.send("path", there_and_back)
        robot.graph.until(lambda legs=legs: robot.status()["goal_count"] == legs)
    robot.send("path", path_of((1.0, 2.0), (1.0, 2.0)))
    robot.graph.until(lambda: not shown[-1].poses)
    assert str(robot.node.controller.active.goal) == "[1.0, 2.0], position only"


@pytest.mark.parametrize(("path", "told"), [
    (path_of(), "path: given 0 poses, expected 1 to 10000; ~/cancel stops"),
    (path_of((0.0, 0.0), (1.0, math.nan)), "pose 1 of the path: given [1.0, nan], expected fin"),
    (path_of((0.0, 0.0), (1.0, 0.0), frame="odom"), "frame: given 'odom', expected 'world'"),
])
def test_path_that_cannot_be_followed_is_refused(robot, capfd, path, told) -> None:
    robot.send("path", path)
    printed = ""

    def is_told() -> bool:
        nonlocal printed
        printed += capfd.readouterr().err
        return f"path refused: {told}" in printed

    robot.graph.until(is_told)
    assert robot.node.controller.active is None
    assert printed.count("the goal in force stays") == 1


def test_status_and_diagnostics_are_published_while_time_stands_still(begun) -> None:
    robot = begun
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


@pytest.mark.parametrize("shared", [{"goal_memory": 30.0}], indirect=True)
def test_goal_in_force_is_restored_after_a_restart_where_wanted(robot) -> None:
    robot.send_goal()
    robot.pass_time(0.5)
    robot.start_again(goal_memory=0.0)
    assert robot.node.controller.goal is None
    robot.start_again(goal_memory=30.0)
    np.testing.assert_allclose(robot.node.controller.goal, CASE.goal, atol=1e-12)
    robot.graph.until(lambda: len(robot.goals) == 2)
    robot.call(SetBool, "enable", SetBool.Request(data=False))
    robot.start_again(goal_memory=30.0)
    assert robot.node.controller.goal is None


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

    # Whether they are is a test of `Link`; poses read late look like those of a link.
    monkeypatch.setattr(type(controller.link), "needs_speeds", False)
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


@pytest.mark.parametrize("returns", [True, False], ids=["one forged message", "the clock is set"])
def test_no_command_is_ahead_of_a_clock_that_jumps_ahead(
    begun, capfd, monkeypatch, returns
) -> None:
    robot, published, repeat = begun, [], CommandSender.repeat
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


def test_strategy_can_be_changed_on_the_way(begun, capfd, monkeypatch) -> None:
    robot = begun
    monkeypatch.setattr(controller_node, "time", NoPlanningTime)
    robot.send_goal()
    until_on_the_way(robot)
    results = robot.node.set_parameters([Parameter("strategy", value="time_optimal")])
    assert results[0].successful, results[0].reason
    assert capfd.readouterr().err.count("strategy: time_optimal") == 1
    changed = robot.now * 1e-9

    def has_planned() -> bool:
        robot.pass_time(0.1)
        return robot.holds()[-1].start > changed + 1.2

    robot.graph.until(has_planned)
    robot.graph.until(lambda: robot.status()["strategy"] == "time_optimal")
    assert "stability_steps" not in robot.status()
    starts = np.array([hold.start for hold in robot.holds()])
    # A plan that takes effect when it was made for begins later than its instant.
    assert np.median(np.diff(starts[starts > changed])) == pytest.approx(0.25, abs=0.05)
    assert_joined(robot.holds())


def test_nanoseconds_are_resolved_at_the_time_of_a_bag_that_is_played(begun) -> None:
    robot = begun
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
