# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Frames of a live robot and of a recorded run."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sphere_nmpc.floor.occupancy import Grid
from sphere_nmpc.model.disturbance import UNDISTURBED
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.goal import Goal
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import make_state
from sphere_nmpc.solver.roll_out import roll_out
from sphere_sim.evaluation.series import Series
from sphere_sim.recording.message_fields import ReportedSolve
from sphere_sim.recording.run import Run
from sphere_sim.viewer import replay as module
from sphere_sim.viewer.live_frame import LiveFrame
from sphere_sim.viewer.replay import Replay
from sphere_sim.viewer.source import DEFAULT_RADIUS, Pause, Reset, Seek, SetGoal, SetSpeed


def state(x: float) -> np.ndarray:
    return make_state((x, 0.0), (1.0, 0.0, 0.0, 0.0))


@pytest.mark.parametrize(
    ("stamp", "x", "restarted"), [(5.1, 2.0, False), (5.1, 2.2, True), (4.9, 0.0, True)]
)
def test_restart_is_a_step_back_in_time_or_an_impossible_speed(stamp, x, restarted) -> None:
    live = LiveFrame(0.0)
    live.add_pose(5.0, state(0.0), 0.3, 0.0)
    assert not live.take(0.0, 1).restarted, "the first pose is not a restart"
    live.add_pose(stamp, state(x), 0.3, 0.1)
    assert live.take(0.1, 1).restarted is restarted
    assert not live.take(0.1, 1).restarted, "a restart is reported once"


def test_poses_are_estimates_while_there_are_true_ones() -> None:
    live = LiveFrame(0.0)
    live.add_pose(0.9, state(0.5), 0.3, 0.0)
    for i, sign in enumerate((1.0, -1.0, 1.0)):  # signs of a quaternion mean nothing
        true = state(0.1 * i)
        true[2:] *= sign
        live.add_true_pose(1.0 + 0.01 * i, true, 0.3, 0.1)
    half = 0.5 * 0.02
    live.add_pose(1.005, make_state((0.05, 0.003), (np.cos(half), 0, 0, np.sin(half))), 0.3, 0.2)
    frame = live.take(0.2, 1)
    assert frame.time == 1.02 and frame.state[0] == 0.2, "the true one"
    assert frame.estimate[1] == 0.003
    np.testing.assert_allclose(frame.estimate_error, (0.003, 0.02), rtol=1e-9)
    live.add_pose(1.03, state(0.9), 0.3, 0.2)
    assert live.take(0.2, 1).estimate_error[0] == pytest.approx(0.003), "none of that time"
    live.add_true_pose(1.03, state(0.8), 0.3, 0.2)
    np.testing.assert_allclose(live.take(0.2, 1).estimate_error, (0.1, 0.0), atol=1e-12)
    live.add_pose(2.0, state(0.3), 0.3, 2.1)
    frame = live.take(2.1, 1)
    assert frame.state[0] == 0.3 and frame.estimate is None, "no true poses any more"


def test_numbers_and_texts_that_cannot_be_shown_are_replaced() -> None:
    live, long = LiveFrame(0.0), 100_000 * "x"
    for height in (0.0, -0.3, 11.0, float("inf"), float("nan")):
        live.add_pose(1.0, state(0.0), height, 0.0)
        assert live.frame.radius == DEFAULT_RADIUS
    live.add_pose(1.0, state(0.0), 0.25, 0.0)
    assert live.frame.radius == 0.25
    for number in (np.inf, 1e308, -1e31):
        live.add_rotors(np.array([number, 1e9]), np.array([-1e9, number]))
        names = ("cost", "momentum_x", "solve_time_s", "arrival_s")
        live.add_status({"time_s": "0", **dict.fromkeys(names, str(number))})
        np.testing.assert_array_equal(live.frame.rotor_speeds, [np.nan, 1e9])
        np.testing.assert_array_equal(live.frame.rotor_torques, [-1e9, np.nan])
        assert np.isnan(
            [live.frame.cost, live.frame.solve_time, live.frame.to_go, live.frame.momentum[0]]
        ).all()
    live.add_status({"mode": long, "giving_up": long, "solve_time_s": "?"})
    frame = replace(live.take(0.1, 1), notices=(long, "short"))
    cut = 297 * "x" + "..."
    assert cut == frame.mode == frame.notices[0]
    assert f"the strategy gives up {long}"[:297] + "..." in frame.alerts


def test_cancelled_goal_is_not_shown_until_there_is_another() -> None:
    live = LiveFrame(0.0)
    live.add_goal("1.000000000", state(1.0))
    assert live.take(0.0, 1).goal is not None, "without a status, too"
    for stamp, shown in (("1.0", True), ("", False), ("2.0", True)):
        live.add_status({"goal_stamp": stamp})
        assert (live.take(0.0, 1).goal is not None) is shown


def test_goal_is_shown_once_the_status_says_what_it_demands() -> None:
    live = LiveFrame(0.0)

    def shown() -> tuple[float, str] | None:
        goal = live.take(0.0, 1).goal
        return goal and (goal.pose[0], goal.orientation.value)

    def tell(stamp: str, orientation: str) -> None:
        live.add_status({
            "goal_stamp": "1", "active_goal_stamp": stamp, "goal_orientation": orientation
        })

    tell("1.0", "any")
    assert shown() is None, "of which only the status has arrived"
    live.add_goal("1.0", state(1.0))
    assert shown() == (1.0, "any")
    live.add_goal("2.0", state(2.0))
    assert shown() == (1.0, "any"), "until a status is about the other one"
    tell("2.0", "any_heading")
    assert shown() == (2.0, "any_heading")
    live.add_status({"goal_stamp": "1"})
    assert shown() == (2.0, "full"), "of a controller that does not say"


def test_floor_is_shown_while_the_status_reports_a_clearance() -> None:
    live, grid = LiveFrame(0.0), Grid(np.zeros((2, 2), dtype=bool), 1.0)
    live.update(floor=grid)
    assert live.take(0.0, 1).floor is grid, "without a status, too"
    live.add_status({"clearance_m": "0.125"})
    frame = live.take(0.0, 1)
    assert frame.floor is grid and frame.clearance == 0.125
    live.add_status({"clearance_m": "nan"})
    assert live.take(0.0, 1).floor is grid and np.isnan(live.take(0.0, 1).clearance)
    live.add_status({"mode": "no goal"})
    assert live.take(0.0, 1).floor is None, "of a controller that was restarted without one"
    live.controller_at, live.floor_refused = 0.0, "map: given a resolution of 0 m"
    assert live.take(0.0, 1).alerts[-1] == "floor refused: map: given a resolution of 0 m"


def test_missing_messages_and_what_the_status_gives_up_are_alerts() -> None:
    live = LiveFrame(0.0)
    assert live.take(0.0, 1).alerts == ("no pose yet", "no controller yet")
    live.controller_at = 10.0
    live.refused = "frame: given 'map'"
    assert live.take(10.1, 1).alerts == ("pose refused: frame: given 'map'",)
    live.add_pose(1.0, state(0.0), 0.3, 10.0)
    assert live.take(10.5, 1).alerts == ()
    assert live.take(11.9, 1).alerts == ("no pose for 1.9 s", "controller silent for 1.9 s")
    assert live.take(10.7, 0).alerts == ("no pose for 0.7 s", "controller gone")
    live.add_status({"giving_up": "2 degrees of the goal", "no_progress": "given a still sphere"})
    assert live.take(10.1, 1).alerts == (
        "the strategy gives up 2 degrees of the goal", "no progress: given a still sphere"
    )
    reason = "given a still sphere; the strategy gives up the goal: it is occupied"
    live.add_status({"giving_up": "the goal: it is occupied", "no_progress": reason})
    assert live.take(10.1, 1).alerts == (f"no progress: {reason}",), "one reason once"
    live.add_status({"giving_up": "", "no_progress": ""})
    assert live.take(10.1, 1).alerts == ()


@pytest.mark.parametrize(
    ("values", "cost", "to_go", "solve_time"),
    [
        ({"time_s": "2", "arrival_s": "5", "solve_time_s": "0.01", "cost": "3"},
         np.nan, 3.0, 0.01),
        ({"time_s": "2", "plan": "holding", "cost": "0"}, np.nan, 0.0, np.nan),
        ({"time_s": "2", "solve_time_s": "0.02", "cost": "7"}, 7.0, np.nan, 0.02),
    ],
)
def test_status_gives_either_time_to_go_or_cost(values, cost, to_go, solve_time) -> None:
    live = LiveFrame(0.0)
    momentum = {f"momentum_{axis}": "0.1" for axis in "xyz"}
    live.add_status({**values, **momentum, "strategy": "paper", "mode": "tracking"})
    frame = live.frame
    np.testing.assert_array_equal(
        [frame.cost, frame.to_go, frame.solve_time, *frame.momentum],
        [cost, to_go, solve_time, 0.1, 0.1, 0.1],
    )
    assert (frame.strategy, frame.mode) == ("paper", "tracking")


DURATION = 20.0
MOMENTUM = np.array([0.0, 0.15, 0.0])
GRID = Grid(np.zeros((2, 2), dtype=bool), 1.0)
ROBOT = RobotParameters()
ERROR = np.array([0.2, 0.0])


@pytest.fixture
def wall(monkeypatch) -> list[float]:
    now = [0.0]
    monkeypatch.setattr(module.time, "monotonic", lambda: now[0])
    return now


@pytest.fixture
def replay(wall) -> Replay:
    times = np.arange(0.0, DURATION + 0.005, 0.01)
    states = np.tile(make_state((0.0, 0.0), (1.0, 0.0, 0.0, 0.0)), (len(times), 1))
    states[:, 0] = times
    goal = make_state((DURATION, 0.0), (1.0, 0.0, 0.0, 0.0))
    hold = FirstOrderHold(np.array([5.0, 5.5, 6.0]), np.array([[0, 0], [10, 0], [0, 0]], float))
    joints = Series(times, np.ones((len(times), 2)))
    run = Run(
        Series(times, states), joints, joints, "run", Path("run"),
        goals=Series.of([(1.0, Goal(goal))], lasting=True), plans=Series.of([(5.0, hold)]),
        solves=Series.of([(5.0, ReportedSolve(2e-3, 7.0, np.nan, "solved"))]),
        momentum=Series(np.array([4.5]), MOMENTUM[None]),
        disturbances=Series.of([(4.5, UNDISTURBED)]),
        floors=Series.of([(2.0, GRID), (8.0, None)], lasting=True),
        planned_clearances=Series.of([(3.0, 0.125)]),
        estimates=Series(np.array([4.9]), states[490:491] + 0.2 * np.eye(6)[0]),
        estimate_errors=Series(np.array([4.9]), ERROR[None]),
    )
    return Replay(run)


def test_seek_speed_pause_and_reset(replay, wall) -> None:
    replay.handle(Pause(True))
    replay.handle(Seek(10.0))
    frames = replay.frames()
    assert np.all(np.diff([frame.time for frame in frames]) <= 0.05 + 1e-9), "smooth lines"
    assert [frame.restarted for frame in frames] == [True] + (len(frames) - 1) * [False]
    assert frames[0].time == 0.0 and frames[-1].state[0] == pytest.approx(10.0)
    wall[0] = 5.0
    assert replay.frames()[-1].time == pytest.approx(10.0), "it is paused"
    replay.handle(Reset())
    assert replay.frames()[-1].time == pytest.approx(0.0)
    replay.handle(SetSpeed(4.0))
    replay.handle(Pause(False))
    wall[0] = 6.0
    assert replay.frames()[-1].time == pytest.approx(4.0)
    wall[0] = 100.0
    last = replay.frames()[-1]
    assert last.time == pytest.approx(DURATION) and last.capabilities.paused
    replay.handle(Pause(False))
    assert replay.frames()[-1].time == pytest.approx(0.0), "it begins again after its end"
    assert "recording" in replay.handle(SetGoal(np.zeros(6)))


def test_time_left_is_that_of_the_newest_solve_less_the_time_since(replay) -> None:
    solves = Series.of([(5.0, ReportedSolve(2e-3, 7.0, 3.0, "solved"))])
    replay = Replay(replace(replay._run, solves=solves))
    for moment, left in ((4.0, np.nan), (5.0, 3.0), (7.25, 0.75), (9.0, 0.0)):
        replay.handle(Seek(moment))
        assert replay.frames()[-1].progress.time_left == pytest.approx(left, nan_ok=True)


def test_plan_solve_goal_momentum_and_floor_are_those_at_the_time_of_the_frame(replay) -> None:
    replay.handle(Seek(4.0))
    before = replay.frames()[-1]
    assert len(before.plan) == 0 and np.isnan([before.cost, *before.momentum]).all()
    replay.handle(Seek(5.2))
    frame = replay.frames()[-1]
    assert frame.plan.shape == (3, 6) and frame.plan[0, 0] == pytest.approx(5.1), "the estimate"
    assert frame.estimate[0] == pytest.approx(5.1) and frame.state[0] == pytest.approx(5.2)
    assert frame.estimate_error.tolist() == ERROR.tolist() and before.estimate is None
    start = np.concatenate((frame.plan[0], MOMENTUM / ROBOT.rotor_axial_inertia))
    speeds = np.array([[0.0, 0.0], [10.0, 0.0]])
    expected = roll_out(start, speeds, np.array([0.5]), ROBOT.lumped.as_array())
    np.testing.assert_allclose(frame.plan[1], expected[1, :6], atol=1e-12)
    assert (frame.cost, frame.solve_time, frame.mode) == (7.0, 2e-3, "solved")
    assert np.isnan(frame.to_go), "this solve reports no arrival"
    assert frame.goal.pose[0] == DURATION and frame.momentum.tolist() == MOMENTUM.tolist()
    for moment, floor, clearance in ((1.0, None, np.nan), (4.0, GRID, 0.125), (9.0, None, 0.125)):
        replay.handle(Seek(moment))
        frame = replay.frames()[-1]
        assert frame.floor is floor
        np.testing.assert_equal(frame.clearance, clearance)
