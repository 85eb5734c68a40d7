# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Frames of a live robot: restarts, pauses, radius, alerts, and values of status messages."""

from dataclasses import replace

import numpy as np
import pytest

from sphere_nmpc.model.state import make_state
from sphere_sim.viewer.frame import DEFAULT_RADIUS
from sphere_sim.viewer.live_frame import LiveFrame


def state(x: float) -> np.ndarray:
    return make_state((x, 0.0), (1.0, 0.0, 0.0, 0.0))


@pytest.mark.parametrize(
    ("stamp", "x", "restarted"),
    [
        (5.1, 0.3, False),
        (5.1, 2.0, False),  # the fastest motion that is not a restart: 20 m/s and 0.1 m
        (5.1, 2.2, True),
        (5.0, 0.05, False),
        (4.9, 0.0, True),
    ],
)
def test_restart_is_a_step_back_in_time_or_an_impossible_speed(stamp, x, restarted) -> None:
    live = LiveFrame(0.0)
    live.add_pose(5.0, state(0.0), 0.3, 0.0)
    assert not live.take(0.0, 1).restarted, "the first pose is not a restart"
    live.add_pose(stamp, state(x), 0.3, 0.1)
    assert live.take(0.1, 1).restarted is restarted
    assert not live.take(0.1, 1).restarted, "a restart is reported once"
    for step_back in (1.0, 1.1):  # and not lost between two frames
        live.add_pose(step_back, state(0.0), 0.3, 0.2)
    assert live.take(0.2, 1).restarted


def test_clock_is_paused_while_poses_repeat_a_stamp() -> None:
    live = LiveFrame(0.0)
    assert not live.paused
    live.add_pose(1.0, state(0.0), 0.3, 10.0)
    live.add_pose(1.0, state(0.0), 0.3, 10.4)
    assert not live.paused
    live.add_pose(1.0, state(0.0), 0.3, 10.6)
    assert live.paused
    live.take(99.0, 1)
    assert live.paused, "missing poses do not resume the clock"
    live.add_pose(1.1, state(0.0), 0.3, 99.0)
    assert not live.paused


@pytest.mark.parametrize(
    ("height", "radius"),
    [(0.25, 0.25), *((height, DEFAULT_RADIUS) for height in (0.0, -0.3, 1e-3, 11.0, 1e300,
                                                             float("inf"), float("nan")))],
)
def test_radius_is_the_height_of_the_centre_if_a_robot_can_have_it(height, radius) -> None:
    live = LiveFrame(0.0)
    live.add_pose(1.0, state(0.0), height, 0.0)
    assert live.frame.radius == radius


def test_missing_messages_are_alerts_with_their_age() -> None:
    live = LiveFrame(0.0)
    assert live.take(0.0, 1).alerts == ("no pose yet", "no controller yet")
    live.controller_seen(10.0)
    live.refuse_pose("frame: given 'map'")
    assert live.take(10.1, 1).alerts == ("pose refused: frame: given 'map'",)
    live.add_pose(1.0, state(0.0), 0.3, 10.0)
    assert live.take(10.5, 1).alerts == ()
    assert live.take(10.7, 1).alerts == ("no pose for 0.7 s",)
    assert live.take(11.9, 1).alerts == ("no pose for 1.9 s", "controller silent for 1.9 s")
    assert live.take(10.7, 0).alerts == ("no pose for 0.7 s", "controller gone")


def test_status_gives_momentum_and_what_is_given_up_as_an_alert() -> None:
    live = LiveFrame(0.0)
    live.add_pose(1.0, state(0.0), 0.3, 0.0)
    live.controller_seen(0.0)
    assert np.all(np.isnan(live.frame.momentum))
    live.add_status({"momentum_x": "0.1", "momentum_y": "-0.2", "momentum_z": "0",
                     "giving_up": "2 degrees of the goal"})
    assert live.frame.momentum.tolist() == [0.1, -0.2, 0.0]
    assert live.take(0.1, 1).alerts == ("2 degrees of the goal",)
    live.add_status({"momentum_x": "0", "momentum_y": "0", "momentum_z": "0", "giving_up": ""})
    assert not live.frame.momentum.any() and live.take(0.1, 1).alerts == ()
    live.add_status({"giving_up": "", "no_progress": "given a sphere that has stood"})
    assert live.take(0.1, 1).alerts == ("no progress: given a sphere that has stood",)
    live.add_status({"mode": "at the goal"})  # of a controller that reports no momentum
    assert np.all(np.isnan(live.frame.momentum)) and live.take(0.1, 1).alerts == ()


@pytest.mark.parametrize("number", [np.inf, -np.inf, 1e308, -1e31])
def test_numbers_that_cannot_be_drawn_are_unknown(number) -> None:
    live = LiveFrame(0.0)
    live.add_rotors(np.array([number, 1e9]), np.array([-1e9, number]))
    live.add_status({name: str(number) for name in ("cost", "momentum_x", "solve_time_s")})
    np.testing.assert_array_equal(live.frame.rotor_speeds, [np.nan, 1e9])
    np.testing.assert_array_equal(live.frame.rotor_torques, [-1e9, np.nan])
    assert np.isnan([live.frame.cost, live.frame.solve_time, *live.frame.momentum]).all()
    live.add_status({"time_s": "0", "arrival_s": str(number)})
    assert np.isnan(live.frame.to_go)


def test_long_texts_are_cut() -> None:
    live, long = LiveFrame(0.0), 100_000 * "x"
    live.add_status({"mode": long, "strategy": long, "giving_up": long, "no_progress": "short"})
    frame = replace(live.take(0.1, 1), notices=(long, "short"))
    assert frame.mode == frame.strategy == frame.notices[0] == frame.alerts[2] == (
        297 * "x" + "..."
    )
    assert frame.alerts[3] == "no progress: short" and frame.notices[1] == "short"


@pytest.mark.parametrize(
    ("values", "cost", "to_go", "solve_time"),
    [
        ({"time_s": "2", "arrival_s": "5", "solve_time_s": "0.01", "cost": "3"},
         np.nan, 3.0, 0.01),
        ({"time_s": "2", "plan": "holding", "cost": "0"}, np.nan, 0.0, np.nan),
        ({"time_s": "2", "solve_time_s": "0.02", "cost": "7"}, 7.0, np.nan, 0.02),
        ({"solve_time_s": "0", "cost": "?"}, np.nan, np.nan, np.nan),
    ],
)
def test_status_gives_either_time_to_go_or_cost(values, cost, to_go, solve_time) -> None:
    live = LiveFrame(0.0)
    live.add_status({**values, "strategy": "paper", "mode": "tracking"})
    frame = live.frame
    np.testing.assert_array_equal(
        [frame.cost, frame.to_go, frame.solve_time], [cost, to_go, solve_time]
    )
    assert (frame.strategy, frame.mode) == ("paper", "tracking")
