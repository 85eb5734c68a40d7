# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The goal command, its arguments and exit code; a node is served until its run has settled."""

import math
import threading
import time

import numpy as np
import pytest
import rclpy
from geometry_msgs.msg import PoseStamped
from patience import PATIENCE
from rclpy.qos import DurabilityPolicy, QoSProfile
from ros_graph import started

from sphere_nmpc.ros.messages import pose_from_ros
from sphere_sim.evaluation.metrics import GoalRun
from sphere_sim.ros.session.goal_command import main, parse
from sphere_sim.ros.session.goal_run import StalledError, wait_until_settled
from sphere_sim.scenario.scenarios import PAPER_CASES

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["1", "-2.5"], [1, -2.5, 1, 0, 0, 0]),
        (["0", "0", "--yaw", str(math.pi)], [0, 0, 0, 0, 0, 1]),
        (["0", "0", "--yaw", "-90", "--degrees"], [0, 0, 0.5**0.5, 0, 0, -(0.5**0.5)]),
        (["-1", "2", "--quaternion", "0.5", "-0.5", "0.5", "0.5"], [-1, 2, 0.5, -0.5, 0.5, 0.5]),
        (["--case", "2"], PAPER_CASES[2].goal),
    ],
)
def test_arguments_name_a_goal(arguments, expected) -> None:
    np.testing.assert_allclose(parse(arguments)[0], expected, atol=1e-5)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["1"], "given 1 numbers"),
        (["1", "2", "--case", "1"], "--case brings its own"),
        (["1", "2", "--quaternion", "1", "1", "0", "0"], "norm 1.41421"),
        (["1", "2", "--yaw", "90"], "--yaw: given 90 rad, expected -6.283 to 6.283; --degrees"),
        (["1", "2", "--degrees"], "--degrees: given without --yaw"),
    ],
)
def test_wrong_arguments_exit_with_2(arguments, message, capsys) -> None:
    with pytest.raises(SystemExit, match="2"):
        parse(arguments)
    assert message in capsys.readouterr().err


def test_missing_controller_exits_with_1(capsys) -> None:
    assert main(["1", "2", "--timeout", "0.3"]) == 1
    assert "no controller was ready within 0.3 s" in capsys.readouterr().err


class Controller(threading.Thread):
    """A controller without status that confirms goals or not, in a context of its own."""

    def __init__(self, confirms: bool) -> None:
        super().__init__(daemon=True)
        self._context = rclpy.Context()
        rclpy.init(context=self._context)
        self.node = rclpy.create_node("controller", context=self._context)
        self._done = threading.Event()
        self.received: list[np.ndarray] = []
        self._confirms = confirms
        self._active = self.node.create_publisher(PoseStamped, "~/active_goal", LATCHED)
        self._active.publish(PoseStamped())  # the goal before this one
        self.node.create_subscription(PoseStamped, "goal_pose", self._take, 1)

    def _take(self, message: PoseStamped) -> None:
        self.received.append(pose_from_ros(message))
        if self._confirms:
            self._active.publish(message)

    def run(self) -> None:
        executor = rclpy.executors.SingleThreadedExecutor(context=self._context)
        executor.add_node(self.node)
        while not self._done.is_set():
            executor.spin_once(timeout_sec=0.05)
        self.node.destroy_node()
        executor.shutdown()

    def __enter__(self):
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._done.set()
        self.join()
        self._context.try_shutdown()


@pytest.mark.parametrize(("confirms", "code"), [(True, 0), (False, 1)])
def test_goal_is_sent_once_and_its_acceptance_printed(confirms, code, capsys, monkeypatch) -> None:
    monkeypatch.setattr("sphere_sim.ros.session.goal_command._ANSWER_TIMEOUT", 1.0)
    with Controller(confirms) as controller:
        assert main(["1", "2", "--yaw", "1", "--timeout", "20"]) == code
    assert len(controller.received) == 1
    np.testing.assert_allclose(controller.received[0], parse(["1", "2", "--yaw", "1"])[0])
    printed = capsys.readouterr()
    expected = (
        "goal x 1 y 2 m, quaternion wxyz [0.8776, 0.0, 0.0, 0.4794], rotation vector "
        "[0.0, 0.0, 57.3] deg: in force; no message on /controller/status within 1 s\n"
    )
    assert printed.out == expected * confirms
    assert ("not confirmed" in printed.err) != confirms


@pytest.mark.slow
def test_what_the_controller_waits_for_is_told_with_the_remedy(capsys, monkeypatch) -> None:
    monkeypatch.setattr("sphere_sim.ros.session.goal_command._ANSWER_TIMEOUT", PATIENCE)
    with started("controller", "-p", "use_sim_time:=true"):
        end, told = time.monotonic() + PATIENCE, ""
        while "no publisher" not in told:
            assert time.monotonic() < end, told
            assert main(["1", "0", "--timeout", str(PATIENCE)]) == 0
            told = capsys.readouterr().out.partition("in force")[2]
    assert told.startswith(", but the controller waits: 'no clock: ")


GOAL = np.array([1.0, 0.0, 1.0, 0.0, 0.0, 0.0])


def at(distance: float) -> np.ndarray:
    """Return a state at a distance from the goal [m]."""
    return GOAL + np.array([distance, 0.0, 0.0, 0.0, 0.0, 0.0])


def poses(run: GoalRun, *errors: float):
    """Return a function that gives the run its next pose, 1 s after the last one."""
    left = iter(enumerate(errors))

    def spin() -> None:
        time, error = next(left)
        run.observe(float(time), at(error))

    return spin


@pytest.mark.parametrize(
    ("errors", "options", "settled", "end"),
    [
        # Inside at 1 s, outside again at 2 s, for good from 3 s on.
        ((1.0, 0.05, 0.2, 0.05, 0.02, 0.01, 0.0), {}, 3.0, 5.0),
        ((1.0, *[0.0] * 20), {"linger": 4.0}, 1.0, 7.0),
        ((1.0, *[0.0] * 20), {"linger": 40.0}, 1.0, 10.0),
        ((1.0,) * 8 + (0.0,) * 3, {}, 8.0, 10.0),
    ],
)
def test_run_settles_when_the_error_has_stayed_below_the_tolerance(
    errors, options, settled, end
) -> None:
    run = GoalRun(GOAL, tolerance=0.1, hold=2.0)
    assert wait_until_settled(run, poses(run, *errors), deadline=10.0, **options) == settled
    assert run.time == end


def test_time_that_stands_still_is_an_error() -> None:
    run = GoalRun(GOAL)
    run.observe(2.5, at(1.0))
    with pytest.raises(StalledError, match=r"stands still at 2\.50 s"):
        wait_until_settled(run, lambda: None, deadline=10.0, stall_timeout=0.0)
