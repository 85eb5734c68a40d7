# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Rotor speeds as piecewise linear functions of time, and stops on the planned path."""

from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from motions import largest_distance, largest_slope, moved
from situations import situation

from sphere_nmpc.errors import InvalidInputError
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import POSE, Vector
from sphere_nmpc.strategy.time_optimal.search import ArrivalSearch
from sphere_nmpc.strategy.time_optimal.search_task import solver_for
from sphere_nmpc.strategy.time_optimal.settings import TimeOptimalSettings
from sphere_sim.scenario.scenarios import draw_scenarios

MAX_SPEED = 100.0
MAX_ACCELERATION = 400.0
EPOCH = 1.7e9
"""Seconds since 1970 on a wall clock; a float resolves 2.4e-7 s there."""

speed = st.one_of(st.floats(-300.0, 300.0), st.floats(0.0, 1e-3))
speed_pairs = st.tuples(speed, speed).map(np.array)


@st.composite
def holds(draw: st.DrawFn) -> FirstOrderHold:
    gaps = draw(st.lists(st.floats(1e-3, 2.0), min_size=1, max_size=6))
    start = draw(st.sampled_from([0.0, -3.5, 1e4, EPOCH]))
    speeds = [draw(speed_pairs) for _ in gaps]
    return FirstOrderHold(start + np.cumsum(gaps), np.array(speeds))


@given(hold=holds(), place=st.floats(-0.5, 1.5))
def test_speeds_follow_eqs_21_and_22_and_hold_outside(hold: FirstOrderHold, place: float) -> None:
    time = hold.start + place * (hold.end - hold.start)
    expected = [np.interp(time, hold.times, column) for column in hold.speeds.T]
    np.testing.assert_allclose(hold.at(time), expected, atol=1e-9)
    assert np.array_equal(hold.at(hold.times[-1]), hold.speeds[-1])
    inside = hold.times[(hold.times > hold.start) & (hold.times < hold.end)]
    assert hold.knots_between(hold.start, hold.end) == inside.tolist()


@pytest.mark.parametrize(
    ("times", "speeds", "words"),
    [
        ([], np.zeros((0, 2)), "K >= 1"),
        ([0.0, 1.0], np.zeros((3, 2)), r"\(2,\).*\(3, 2\)"),
        ([0.0, 1.0], np.zeros((2, 3)), r"\(2, 3\)"),
        ([0.0, 0.0], np.zeros((2, 2)), "strictly rising"),
        ([0.0, np.nan], np.zeros((2, 2)), "finite"),
        ([0.0, 1.0], np.array([[0, 0], [0, np.nan]]), "finite"),
        ([0.0, 1e-3], np.array([[0, 0], [0, -1e308]]), "at most 1e\\+06 rad/s"),
        ([0.0], np.array([[1.1e6, 0]]), "at most 1e\\+06 rad/s"),
    ],
)
def test_invalid_knots_are_refused(
    times: list[float], speeds: Vector, words: str
) -> None:
    with pytest.raises(InvalidInputError, match=words):
        FirstOrderHold(np.array(times), speeds)


@given(hold=holds())
def test_limited_hold_keeps_both_limits_for_any_hold(hold: FirstOrderHold) -> None:
    started = hold.starting_at(hold.start, np.clip(hold.speeds[0], -MAX_SPEED, MAX_SPEED))
    limited = started.limited(MAX_SPEED, MAX_ACCELERATION)
    assert np.max(np.abs(limited.speeds)) <= MAX_SPEED
    # Rounding of a difference of speeds of up to 100 rad/s over 1e-3 s at least.
    assert largest_slope(limited) <= MAX_ACCELERATION + 1e-9
    np.testing.assert_array_equal(limited.times, hold.times)
    again = limited.limited(MAX_SPEED, MAX_ACCELERATION)
    np.testing.assert_allclose(again.speeds, limited.speeds, atol=1e-9)


@given(hold=holds())
def test_hold_within_the_limits_is_unchanged_and_ends_at_rest(hold: FirstOrderHold) -> None:
    same = hold.limited(300.0, 1.01 * largest_slope(hold) + 1.0)
    np.testing.assert_array_equal(same.speeds, hold.speeds)
    ended = same.stop(same.end, MAX_ACCELERATION)
    np.testing.assert_array_equal(ended.speeds[: len(hold.speeds)], hold.speeds)
    assert not ended.speeds[-1].any()


@given(speeds=speed_pairs, time=st.sampled_from([0.0, 12.5, EPOCH]))
def test_stop_of_constant_speeds_is_a_ramp_within_the_limit_of_acceleration(
    speeds: Vector, time: float
) -> None:
    ramp = FirstOrderHold.constant(time, speeds).stop(time, MAX_ACCELERATION)
    np.testing.assert_array_equal(ramp.at(ramp.end), [0.0, 0.0])
    assert ramp.start == time
    assert largest_slope(ramp) <= MAX_ACCELERATION * (1.0 + 1e-15)
    # The end is rounded up to what stamps and clock resolve, by two steps at most.
    fastest = np.max(np.abs(speeds))
    shortest = max(fastest / MAX_ACCELERATION, 1e-6 * (fastest > 0.0))
    assert ramp.end - ramp.start == pytest.approx(shortest, abs=2 * np.spacing(time) + 1e-9)


SPACING = 2e-3
"""Spacing of the poses that are compared [s]; chords of the path are off it by 2e-6 m."""
OFF = 8e-4
"""Largest distance from the path in R^6: 120 other stops have left it by 5.7e-4 at the most."""


@cache
def plans() -> list[tuple[Vector, FirstOrderHold]]:
    """Return starts and the plans from there."""
    robot, found = RobotParameters(), []
    solver = solver_for(robot, TimeOptimalSettings())
    for scenario in draw_scenarios(8, 77, "anywhere"):
        now = situation(scenario.goal, pose=scenario.start)
        arrival = ArrivalSearch(solver, now, 1).improve(50_000)
        assert arrival is not None
        found.append((now.state, arrival.hold))
    return found


def test_sphere_stops_on_its_path_within_half_a_second() -> None:
    rng, durations = np.random.default_rng(5), []
    for start, hold in plans():
        path = moved(start, hold, 0.0, hold.end, SPACING)
        for time in rng.uniform(0.0, hold.end, 5):
            here = moved(start, hold, 0.0, time, SPACING)[-1]
            stop = hold.starting_at(time, hold.at(time)).stop(time, MAX_ACCELERATION)
            durations.append(stop.end - time)
            np.testing.assert_array_equal(stop.speeds[0], hold.at(time))
            assert not stop.speeds[-1].any()
            assert np.max(np.abs(stop.speeds)) <= MAX_SPEED
            assert largest_slope(stop) <= MAX_ACCELERATION * (1.0 + 1e-9)
            stopped = moved(here, stop, time, stop.end, SPACING)
            assert largest_distance(stopped[:, POSE], path[:, POSE]) < OFF
            ramp = FirstOrderHold.constant(time, hold.at(time)).stop(time, MAX_ACCELERATION)
            assert stop.end <= max(ramp.end + 0.25, time + 0.5)
    assert max(durations) < 0.5


@pytest.mark.parametrize(
    ("speeds", "duration"),
    [([[0, 0]], 0.0), ([[0, 0], [0, 0]], 0.0), ([[60, -30], [60, -30], [0, 0]], 60 / 400.0)],
    ids=["at rest", "resting on", "steady rolling"],
)
def test_stop_takes_no_longer_than_a_ramp(speeds: list[list[float]], duration: float) -> None:
    hold = FirstOrderHold(7.0 * np.arange(len(speeds)), np.array(speeds, dtype=float))
    stop = hold.stop(0.0, MAX_ACCELERATION)
    assert stop.end == pytest.approx(duration, abs=1e-6) and stop.speeds.any() == (duration > 0.0)


def test_stop_of_a_stop_takes_no_longer() -> None:
    _, hold = plans()[0]
    time = 0.4 * hold.end
    stop = hold.starting_at(time, hold.at(time)).stop(time, MAX_ACCELERATION)
    later = 0.5 * (time + stop.end)
    again = stop.stop(later, MAX_ACCELERATION)
    assert again.end <= stop.end + 1e-6
    assert float(np.linalg.norm(again.at(again.end))) == 0.0
