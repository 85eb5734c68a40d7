# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Silence is told in time and in words; the plots' series hold what they should."""

import numpy as np
import pytest

pytest.importorskip("viser")

from sphere_nmpc.model.state import make_state
from sphere_sim.viewer.frame import Frame
from sphere_sim.viewer.health import Health
from sphere_sim.viewer.history import History
from sphere_sim.viewer.plots import upright_range
from sphere_sim.viewer.presets import PRESETS


def test_all_is_well_while_both_are_heard() -> None:
    assert Health(pose_at=9.9, controller_at=9.4, controllers=1).alerts(10.0) == ()


def test_who_was_never_heard_is_told() -> None:
    assert Health().alerts(10.0) == ("no pose yet", "no controller yet")


def test_silence_is_told_within_two_seconds() -> None:
    health = Health(pose_at=10.0, controller_at=10.0, controllers=1)
    assert health.alerts(10.7) == ("no pose for 0.7 s",)
    assert health.alerts(11.9) == ("no pose for 1.9 s", "controller silent for 1.9 s")


def test_a_controller_that_left_is_told_sooner() -> None:
    health = Health(pose_at=10.5, controller_at=10.0, controllers=0)
    assert health.alerts(10.7) == ("controller gone",)


def test_a_refused_pose_is_told_with_its_reason() -> None:
    health = Health(pose_at=9.0, controller_at=9.9, controllers=1, refused="frame: given 'map'")
    assert health.alerts(10.0) == ("pose refused: frame: given 'map'",)


def frame(time: float, fresh: bool = False) -> Frame:
    state = make_state((time, 0.0), (1.0, 0.0, 0.0, 0.0))
    goal = make_state((0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
    return Frame(time=time, state=state, goal=goal, cost=2.0, solve_time=1e-3, fresh=fresh)


def test_history_forgets_what_is_old_and_thins_what_is_dense() -> None:
    history = History(window=10.0, limit=100)
    for t in np.arange(0.0, 30.0, 0.01):
        history.add(frame(float(t)))
    times = history.series()["time"]
    assert times[0] >= 19.9 and 90 <= len(times) <= 102
    assert np.allclose(history.series()["distance"], times)


def test_a_fresh_frame_begins_a_new_history() -> None:
    history = History()
    history.add(frame(5.0))
    history.add(frame(1.0, fresh=True))
    assert history.series()["time"].tolist() == [1.0]


def test_nothing_in_the_history_gives_empty_series() -> None:
    assert all(len(line) == 0 for line in History().series().values())


def test_axes_show_at_least_what_a_quantity_may_be_and_change_in_steps() -> None:
    still = np.array([np.nan, 1e-12, -1e-12])
    assert upright_range([still], (-100.0, 100.0)) == (-100.0, 100.0)
    assert upright_range([np.array([np.nan])], (0.0, 1.0)) == (0.0, 1.0)
    assert upright_range([np.array([-5.0, 100.1]), still], (0.0, 1.0)) == (-50.0, 100.0)
    once = upright_range([np.array([0.0, 132.0])], (0.0, 1.0))
    assert once == upright_range([np.array([0.0, 149.0])], (0.0, 1.0)) == (0.0, 150.0)


def test_every_preset_is_a_state() -> None:
    here = make_state((1.0, 2.0), (0.5, 0.5, 0.5, 0.5))
    for name, make in PRESETS.items():
        goal = make(here)
        assert goal.shape == (6,) and abs(np.linalg.norm(goal[2:]) - 1.0) < 1e-12, name
        if name.endswith("here"):
            assert goal[:2].tolist() == [1.0, 2.0], name
