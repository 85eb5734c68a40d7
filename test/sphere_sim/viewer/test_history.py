# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Time series of the plots, ranges of their axes, and goal presets."""

import numpy as np
import pytest

pytest.importorskip("viser")

from sphere_nmpc.model.state import make_state
from sphere_sim.viewer.frame import Frame
from sphere_sim.viewer.goal_presets import GOAL_PRESETS
from sphere_sim.viewer.history import History
from sphere_sim.viewer.plots import axis_range

HERE = make_state((1.0, 2.0), (0.5, 0.5, 0.5, 0.5))


def frame(time: float, restarted: bool = False) -> Frame:
    state = make_state((time, 0.0), (1.0, 0.0, 0.0, 0.0))
    goal = make_state((0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
    return Frame(time=time, state=state, goal=goal, cost=2.0, solve_time=1e-3, restarted=restarted)


def test_history_is_limited_in_length_and_density() -> None:
    history = History(window=10.0, limit=100)
    for t in np.arange(0.0, 30.0, 0.01):
        history.add(frame(float(t)))
    times = history.series()["time"]
    assert times[0] >= 19.9 and 90 <= len(times) <= 102
    assert np.allclose(history.series()["distance"], times)


def test_frame_of_a_restarted_run_deletes_the_history() -> None:
    history = History()
    history.add(frame(5.0))
    history.add(frame(1.0, restarted=True))
    assert history.series()["time"].tolist() == [1.0]


def test_empty_history_gives_empty_series() -> None:
    assert all(len(line) == 0 for line in History().series().values())


def test_axis_ranges_have_a_smallest_range_and_grow_in_steps() -> None:
    still = np.array([np.nan, 1e-12, -1e-12])
    assert axis_range([still], (-100.0, 100.0)) == (-100.0, 100.0)
    assert axis_range([np.array([np.nan])], (0.0, 1.0)) == (0.0, 1.0)
    assert axis_range([np.array([-5.0, 100.1]), still], (0.0, 1.0)) == (-50.0, 100.0)
    once = axis_range([np.array([0.0, 132.0])], (0.0, 1.0))
    assert once == axis_range([np.array([0.0, 149.0])], (0.0, 1.0)) == (0.0, 150.0)


@pytest.mark.parametrize("name", GOAL_PRESETS)
def test_preset_is_a_valid_state(name) -> None:
    goal = GOAL_PRESETS[name](HERE)
    assert goal.shape == (6,) and abs(np.linalg.norm(goal[2:]) - 1.0) < 1e-12


@pytest.mark.parametrize("name", [name for name in GOAL_PRESETS if name.endswith("here")])
def test_preset_here_keeps_the_position(name) -> None:
    assert GOAL_PRESETS[name](HERE)[:2].tolist() == [1.0, 2.0]
