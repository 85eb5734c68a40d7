# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The goal command: its arguments, its display, and how long a run is waited for."""

import math

import numpy as np
import pytest
from geometry_msgs.msg import PointStamped, PoseStamped
from nav_msgs.msg import Goals

from sphere_nmpc.control.goal_report import GoalReport
from sphere_nmpc.ros.messages import pose_from_ros
from sphere_sim.evaluation.metrics import GoalRun
from sphere_sim.ros.session.goal_arguments import parse
from sphere_sim.ros.session.goal_run import StalledError, wait_until_settled
from sphere_sim.scenario.scenarios import PAPER_CASES

UPRIGHT = [1.0, 0.0, 0.0, 0.0]
HALF_TURN = [0.0, 0.0, 0.0, 1.0]
GOAL = np.array([1.0, 0.0, *UPRIGHT])


@pytest.mark.parametrize(
    ("arguments", "kind", "goals", "told"),
    [
        (["1", "-2.5"], PoseStamped, [[1, -2.5, *UPRIGHT]], "goal x 1 y -2.5 m, quaternion"),
        (["0", "0", "--yaw", str(math.pi)], PoseStamped, [[0, 0, *HALF_TURN]], "goal"),
        (["0", "0", "--yaw", "-90", "--degrees"], PoseStamped,
         [[0, 0, 0.5**0.5, 0, 0, -(0.5**0.5)]], "goal"),
        (["-1", "2", "--quaternion", "0.5", "-0.5", "0.5", "0.5"], PoseStamped,
         [[-1, 2, 0.5, -0.5, 0.5, 0.5]], "goal"),
        (["--case", "2"], PoseStamped, [PAPER_CASES[2].goal], "goal"),
        (["1", "-2.5", "--point"], PointStamped, [[1, -2.5, *UPRIGHT]],
         "goal x 1 y -2.5 m, any orientation"),
        (["1", "0", "--then", "-1", "-2.5", "180", "--then", "0", "3", "--degrees"], Goals,
         [[1, 0, *UPRIGHT], [-1, -2.5, *HALF_TURN], [0, 3, *UPRIGHT]],
         "3 goals, the last one x 0 y 3 m, quaternion"),
    ],
)
def test_arguments_name_goals_which_are_sent_in_order(arguments, kind, goals, told) -> None:
    request = parse(arguments)
    message = request.message
    assert isinstance(message, kind) and str(request).startswith(told)
    np.testing.assert_allclose(request.goals, goals, atol=1e-5)
    if kind is PointStamped:
        assert [message.point.x, message.point.y] == goals[0][:2]
    else:
        sent = [pose_from_ros(pose) for pose in (message.goals if kind is Goals else [message])]
        np.testing.assert_allclose(sent, goals, atol=1e-5)


def test_path_is_read_from_a_file_and_its_deviation_is_shown(tmp_path, capsys) -> None:
    file = tmp_path / "path.csv"
    file.write_text("x,y\n0,0\n1,0\n1,2.5\n")
    request = parse(["--path", str(file), "--wait"])
    assert str(request) == "path of 3 places to x 1 y 2.5 m"
    places = [(it.pose.position.x, it.pose.position.y) for it in request.message.poses]
    assert places == [(0.0, 0.0), (1.0, 0.0), (1.0, 2.5)]
    for arguments, told in (
        (["1", "2"], "--path: given with goals"), (["--yaw", "1"], "not allowed with"),
        (["--degrees"], "--degrees: given without"),
    ):
        with pytest.raises(SystemExit, match="2"):
            parse(["--path", str(file), *arguments])
        assert told in capsys.readouterr().err
    pytest.importorskip("rich")
    from sphere_sim.ros.session.goal_display import GoalDisplay

    with GoalDisplay() as display:
        # From beside the path, and along it.
        for deviation in (3.0, 0.5, math.nan, 0.004, -0.0125, 0.003, math.nan):
            display.update(GoalReport("1.0", 0, 1, "m", time_left=1.0, deviation=deviation))
    assert capsys.readouterr().err == "     – m,   1.0 s left, 3000.0 mm off the path, m\n"
    assert display.largest_deviation == 0.0125


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["1"], "given 1 number, expected a position X Y [m]"),
        (["1", "2", "--case", "1"], "--case brings its own"),
        (["1", "2", "--quaternion", "1", "1", "0", "0"], "norm 1.41421"),
        (["1", "2", "--yaw", "90"], "--yaw: given 90 rad, expected -6.283 to 6.283; --degrees"),
        (["1", "2", "--yaw", "nan"], "--yaw: given nan, expected a finite number"),
        (["1", "inf"], "given inf, expected a finite number"),
        (["1", "2", "--quaternion", "1", "0", "0", "nan"], "--quaternion: given nan, expected"),
        (["1", "2", "--timeout", "nan"], "--timeout: given nan, expected a number from 0 on"),
        (["1", "2", "--timeout", "inf"], "--timeout: given inf, expected a number from 0 on"),
        (["1", "2", "--timeout", "-1"], "--timeout: given -1, expected a number from 0 on"),
        (["1", "2", "--degrees"], "--degrees: given without --yaw"),
        (["1", "2", "--then", "3"], "--then: given 1 number, expected X Y or X Y YAW"),
        (["1", "2", "--then", "3", "4", "90"], "--then: given 90 rad"),
        (["1", "2", "--then", "3", "nan"], "--then: given nan, expected a finite number"),
        (["1", "2", "--point", "--then", "3", "4"], "--point: given with further goals"),
        (["1", "2", "--point", "--yaw", "1"], "not allowed with"),
        (["1", "2", "--cancel-on-interrupt"], "given without --wait"),
    ],
)
def test_wrong_arguments_exit_with_2(arguments, message, capsys) -> None:
    with pytest.raises(SystemExit, match="2"):
        parse(arguments)
    assert message in capsys.readouterr().err


def test_share_grows_over_all_goals_and_falls_with_a_longer_way() -> None:
    pytest.importorskip("rich")
    from sphere_sim.ros.session.goal_display import Way

    way, shares = Way(), []
    for index, left in ((0, math.nan), (0, 4.0), (0, 1.0), (1, math.nan), (1, 2.0), (1, 3.0),
                        (1, 0.0)):
        way.add(GoalReport("1.0", index, 2, distance_left=left))
        shares.append(way.share)
    assert shares == [0.0, 0.0, 0.375, 0.5, 0.5, 0.5, 1.0]


@pytest.mark.parametrize("terminal", [True, False])
def test_display_is_a_bar_on_a_terminal_and_else_a_line(terminal, monkeypatch, capsys) -> None:
    pytest.importorskip("rich")
    from sphere_sim.ros.session.goal_display import GoalDisplay

    if terminal:
        monkeypatch.setenv("FORCE_COLOR", "1")
        monkeypatch.setenv("TERM", "xterm-256color")
    report = GoalReport("1.0", 1, 3, "on the way to the goal [bold]", time_left=4.25)
    with GoalDisplay() as display:
        display.update(GoalReport())  # nothing is known: nothing is shown
        display.update(report)
        display.update(report)  # not due yet
    printed = capsys.readouterr()
    text = "goal 2 of 3:      – m,   4.2 s left"
    assert printed.out == ""
    if terminal:
        assert text in printed.err and "\x1b[" in printed.err and "\u2501" in printed.err
    else:
        assert printed.err == f"{text}, on the way to the goal [bold]\n"


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
