# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Whatever ends the controller's process leaves the rotors on a ramp to rest."""

import os
import re
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from rclpy.duration import Duration
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory

from sphere_nmpc.ros.conversions import hold_from_trajectory, pose_to_ros, stamp_to_ros
from sphere_sim.scenario.scenarios import PAPER_CASES

CASE = PAPER_CASES[1]
CONTROLLER = "import sys; from sphere_nmpc.ros.controller.node import main; sys.exit(main())"


def start(code: str, *arguments: str) -> subprocess.Popen:
    return subprocess.Popen(
        [sys.executable, "-c", code, "--ros-args", *arguments],
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
    )


@pytest.mark.parametrize(
    "signals",
    [[signal.SIGINT], [signal.SIGTERM], [signal.SIGINT] * 2],
    ids=["ctrl-c", "sigterm", "ctrl-c twice"],
)
def test_last_command_is_a_ramp_to_rest(graph, signals) -> None:
    trajectories = graph.hear(JointTrajectory, "rotor_trajectory")
    commands = graph.hear(Float64MultiArray, "rotor_commands")
    controller = start(CONTROLLER, "-p", "use_sim_time:=true", "-p", "strategy:=paper")
    try:
        goals, poses = graph.speaker(PoseStamped, "goal_pose"), graph.speaker(PoseStamped, "pose")
        clock = graph.speaker(Clock, "/clock")
        goals.publish(pose_to_ros(CASE.goal, 0, 0.3))
        goals.wait_for_all_acked(Duration(seconds=5.0))
        began = time.monotonic()

        def pass_time() -> bool:
            now = round((time.monotonic() - began) * 5e9)
            poses.publish(pose_to_ros(CASE.start, now, 0.3))
            clock.publish(Clock(clock=stamp_to_ros(now)))
            if len(trajectories) < 3 or not commands:
                return False
            return bool(np.max(np.abs(commands[-1].data)) > 20.0)

        graph.until(pass_time)
        for number in signals:
            controller.send_signal(number)
            graph.spin_for(0.02)
        asked = time.monotonic()
        graph.until(lambda: controller.poll() is not None)
        assert controller.returncode == 0, controller.stderr.read()
        took = time.monotonic() - asked
        # Where others wait for the processor too, their number decides and not the node.
        busy = os.getloadavg()[0] > 2 * (os.cpu_count() or 1)
        assert busy or took < 4.0, "launch kills after five seconds"
        graph.until(lambda: not np.any(commands[-1].data))
    finally:
        controller.kill()
        controller.wait()
    before, last = (hold_from_trajectory(message, 0) for message in trajectories[-2:])
    assert not last.speeds[-1].any()
    assert last.end - last.start <= 0.25 + 1e-6, "100 rad/s at 400 rad/s^2"
    np.testing.assert_allclose(last.speeds[0], before.at(last.start), atol=1e-6)
    steps = np.abs(np.diff([command.data for command in commands[-30:]], axis=0))
    assert np.max(steps) < 60.0, "the sampled ramp has no jump to zero"


def test_signal_while_a_node_waits_is_noticed_at_once(graph) -> None:
    node = start(CONTROLLER)
    graph.until(lambda: graph.probe.count_publishers("controller/status") > 0)
    asked = time.monotonic()
    node.send_signal(signal.SIGINT)
    assert node.wait(timeout=10) == 0
    assert time.monotonic() - asked < 3.0


@pytest.mark.parametrize(
    "arguments, code, told",
    [
        (["-p", "horizon:=0"], 2, "horizon: given 0, expected 1 to 60"),
        (["-p", "robot.shell_mass:=heavy"], 2, "robot.shell_mass: given 'heavy', expected"),
        (["--params-file", "absent.yaml"], 2, "cannot start: .* Error opening YAML file"),
    ],
)
def test_wrong_parameter_ends_the_node_with_one_line(arguments, code, told) -> None:
    node = start(CONTROLLER, *arguments)
    _, errors = node.communicate(timeout=20)
    assert node.returncode == code
    assert len(errors.strip().splitlines()) == 1
    assert re.search(told, errors)


def test_argument_that_is_not_understood_is_told() -> None:
    done = subprocess.run(
        [sys.executable, "-c", CONTROLLER, "horizon:=3"],
        capture_output=True, text=True, timeout=20, check=False,
    )
    assert done.returncode == 2
    assert "horizon:=3: not understood" in done.stderr


def test_help_tells_topics_without_starting() -> None:
    done = subprocess.run(
        [sys.executable, "-c", CONTROLLER, "--help"],
        capture_output=True, text=True, timeout=20, check=False,
    )
    assert done.returncode == 0
    assert "goal_pose" in done.stdout and "--ros-args" in done.stdout
