# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The controller node over real DDS with clocks that stand, jump or are far ahead."""


import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from driven_controller import (
    ON_THE_WAY,
    STANDS_STILL,
    TICK,
    assert_joined,
    assert_within_acceleration,
)
from rclpy.parameter import Parameter
from rclpy.serialization import serialize_message
from ros_graph import values_of
from rosgraph_msgs.msg import Clock

from sphere_nmpc.quantities import NANOSECONDS
from sphere_nmpc.ros.cdr import hold_and_stamp
from sphere_nmpc.ros.controller.command_sender import CommandSender
from sphere_nmpc.ros.messages import stamp_to_ros

pytestmark = pytest.mark.slow


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
    assert robot.status()["mode"] == ON_THE_WAY


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
    assert robot.status()["mode"] == ON_THE_WAY


@pytest.mark.parametrize("returns", [True, False], ids=["one forged message", "the clock is set"])
def test_no_command_is_ahead_of_a_clock_that_jumps_ahead(
    begun, capfd, monkeypatch, returns
) -> None:
    robot, published, repeat = begun, [], CommandSender.repeat
    monkeypatch.setattr(
        CommandSender, "repeat", lambda sender: (published.append(robot.now), repeat(sender))
    )
    robot.send_goal()
    robot.until_on_the_way()
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
    robot.until_on_the_way()
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


def test_nanoseconds_are_resolved_at_the_time_of_a_bag_that_is_played(begun) -> None:
    robot = begun
    robot.now = played = 1_764_000_000 * NANOSECONDS
    robot.send_goal()
    robot.until_on_the_way()
    clock = robot.node._control_clock
    step = clock.time_of(robot.now + 1) - clock.time_of(robot.now)
    assert step == pytest.approx(1e-9, abs=2e-10), "control time is below 1e6 s"
    sent = len(robot.trajectories)
    robot.pass_time(1.0)
    for message in robot.trajectories[sent:]:
        assert_within_acceleration(hold_and_stamp(serialize_message(message), played)[0])
