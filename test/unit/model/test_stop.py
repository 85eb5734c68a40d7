# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Stop on the planned path: it keeps the path and every limit, and takes half a second at most."""

from functools import cache

import numpy as np
import pytest
from motions import largest_distance, moved

from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import POSE, Vector, without_momentum
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.time_optimal.background import solver_for
from sphere_nmpc.strategy.time_optimal.search import ArrivalSearch
from sphere_nmpc.strategy.time_optimal.settings import TimeOptimalSettings
from sphere_sim.scenario.scenarios import draw_scenarios

ROBOT = RobotParameters()
LIMIT, SPEED = ROBOT.max_rotor_acceleration, ROBOT.max_rotor_speed
SPACING = 2e-3
"""Spacing of the poses that are compared [s]; chords of the path are off it by 2e-6 m."""
OFF = 8e-4
"""Largest distance from the path in R^6: 120 other stops have left it by 5.7e-4 at the most."""


@cache
def plans() -> list[tuple[Vector, FirstOrderHold]]:
    """Return starts and the plans from there."""
    found, solver = [], solver_for(ROBOT, TimeOptimalSettings())
    for scenario in draw_scenarios(8, 77, "anywhere"):
        start = without_momentum(scenario.start)
        situation = Situation(0.0, start, scenario.goal, np.zeros(2), ROBOT.lumped)
        arrival = ArrivalSearch(solver, situation, 1).improve(50_000)
        assert arrival is not None
        found.append((start, arrival.hold))
    return found


def test_sphere_stops_on_its_path_within_half_a_second() -> None:
    rng, durations = np.random.default_rng(5), []
    for start, hold in plans():
        path = moved(start, hold, 0.0, hold.end, SPACING)
        for time in rng.uniform(0.0, hold.end, 5):
            here = moved(start, hold, 0.0, time, SPACING)[-1]
            stop = hold.starting_at(time, hold.at(time)).stop(time, LIMIT)
            durations.append(stop.end - time)
            np.testing.assert_array_equal(stop.speeds[0], hold.at(time))
            assert not stop.speeds[-1].any()
            assert np.max(np.abs(stop.speeds)) <= SPEED
            slopes = np.diff(stop.speeds, axis=0) / np.diff(stop.times)[:, None]
            assert np.max(np.abs(slopes)) <= LIMIT * (1.0 + 1e-9)
            stopped = moved(here, stop, time, stop.end, SPACING)
            assert largest_distance(stopped[:, POSE], path[:, POSE]) < OFF
            ramp = FirstOrderHold.constant(time, hold.at(time)).stop(time, LIMIT)
            assert stop.end <= max(ramp.end + 0.25, time + 0.5)
    assert max(durations) < 0.5


def test_steady_rolling_stops_as_fast_as_a_ramp() -> None:
    hold = FirstOrderHold(np.array([2.0, 9.0, 9.5]), np.array([[60.0, -30.0]] * 2 + [[0.0, 0.0]]))
    assert hold.stop(2.0, LIMIT).end - 2.0 == pytest.approx(60.0 / LIMIT, abs=1e-6)


@pytest.mark.parametrize("speeds", [[[0.0, 0.0]], [[0.0, 0.0], [0.0, 0.0]]])
def test_sphere_at_rest_stays_there(speeds: list[list[float]]) -> None:
    hold = FirstOrderHold(np.arange(len(speeds), dtype=float), np.array(speeds))
    assert not hold.stop(0.0, LIMIT).speeds.any()


def test_stop_of_a_stop_takes_no_longer() -> None:
    _, hold = plans()[0]
    time = 0.4 * hold.end
    stop = hold.starting_at(time, hold.at(time)).stop(time, LIMIT)
    later = 0.5 * (time + stop.end)
    again = stop.stop(later, LIMIT)
    assert again.end <= stop.end + 1e-6
    assert float(np.linalg.norm(again.at(again.end))) == 0.0
