# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Frames of a recorded run, with pause, speed and seek."""

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
from sphere_sim.recording.run import Floors, Momentum, Run, Solves
from sphere_sim.viewer import replay as module
from sphere_sim.viewer.replay import Replay
from sphere_sim.viewer.source import Pause, Reset, Seek, SetGoal, SetSpeed

DURATION = 20.0
MOMENTUM = np.array([0.0, 0.15, 0.0])
GRID = Grid(np.zeros((2, 2), dtype=bool), 1.0)
ROBOT = RobotParameters()


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
    solves = Solves(
        np.array([5.0]), np.array([2e-3]), np.array([7.0]), ("solved",), np.array([np.nan])
    )
    run = Run(
        "run", Path("run"), times, states, times, np.ones((len(times), 2)),
        np.ones((len(times), 2)), np.array([1.0]), (Goal(goal),), (hold,), solves,
        Momentum(np.array([4.5]), MOMENTUM[None], (UNDISTURBED,)),
        Floors(np.array([2.0, 8.0]), (GRID, None), np.array([3.0]), np.array([0.125])),
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


def test_plan_solve_goal_momentum_and_floor_are_those_at_the_time_of_the_frame(replay) -> None:
    replay.handle(Seek(4.0))
    before = replay.frames()[-1]
    assert len(before.plan) == 0 and np.isnan([before.cost, *before.momentum]).all()
    replay.handle(Seek(5.2))
    frame = replay.frames()[-1]
    assert frame.plan.shape == (3, 6) and frame.plan[0, 0] == pytest.approx(5.0)
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
