# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The judges find each kind of wrong, and nothing wrong with right ones; what faults send."""

import random
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rclpy")

from faults import memory_at_ends
from floors import _AWAY, _area, _corners, _map
from hostile import FORGED, RADIUS, bad_map, map_message
from judge import STOPPING, TOO_EARLY, ContactCheck, Judge, LimitCheck
from rclpy.serialization import serialize_message
from trajectory_msgs.msg import JointTrajectory
from trial import Trial, faults_of_line

from sphere_nmpc.errors import SphereNmpcError
from sphere_nmpc.floor.floor import exact_distance
from sphere_nmpc.floor.layers import Layers
from sphere_nmpc.floor.occupancy import Grid, InvalidMapError, check_polygon
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.ros.cdr_messages import clock_message, trajectory_message
from sphere_nmpc.ros.floor_messages import keepout_of_message, map_of_message

SECOND = 10**9


def hold(*knots: tuple[float, float]) -> FirstOrderHold:
    """Return a hold from rows of time [s] and speed of the first rotor [rad/s]."""
    times, speeds = np.array(knots).T
    return FirstOrderHold(times, np.outer(speeds, [1.0, 0.0]))


IN_FORCE = hold((0.0, 0.0), (1.0, 50.0))
STEADY, LATE = hold((0.0, 20.0), (1.0, 20.0)), hold((0.5, 20.0), (0.6, 60.0))


@pytest.mark.parametrize(
    ("holds", "complaint"),
    [
        ([hold((0.0, -100.0), (0.5, 100.0))], ""),
        ([hold((0.0, 101.0))], "101 rad/s"),
        ([hold((0.0, 0.0), (0.1, 41.0))], "rad/s^2"),
        ([IN_FORCE, hold((0.5, 25.0), (1.0, 0.0))], ""),
        ([IN_FORCE, hold((0.5, 24.5), (1.0, 0.0))], "0.5 rad/s away"),
        # The drives catch up with the late one, which is delivered twice.
        ([STEADY, LATE, LATE, hold((0.575, 24.0), (1.0, 24.0))], ""),
        ([STEADY, LATE, LATE, hold((0.575, 52.0), (1.0, 52.0))], "2 rad/s away"),
    ],
)
def test_commands_beyond_a_limit_are_violations(holds, complaint) -> None:
    check = LimitCheck()
    for one in holds:
        check.sent(one)
        check.delivered(one, 0.575 if one is LATE else one.start)
    assert len(check.broken) == bool(complaint)
    assert complaint in "".join(check.broken)


@pytest.mark.parametrize(
    ("servo_error", "extra", "violations"),
    [(0.0, 0.0, 0), (0.0, 0.06, 1), (0.07, 0.06, 0), (0.07, np.nan, 1)],
)
def test_measured_speeds_may_change_by_the_error_of_a_servo_more(
    servo_error, extra, violations
) -> None:
    check = LimitCheck(servo_error)
    check.joints(0, np.zeros(2))
    check.joints(SECOND // 20, np.array([0.0, 20.0 + extra]))  # 400 rad/s^2 and a little
    assert len(check.broken) == violations


def command(start: float, *speeds: float, spacing: float = 0.5) -> bytes:
    times = start + spacing * np.arange(len(speeds))
    return trajectory_message(FirstOrderHold(times, np.outer(speeds, [1.0, -1.0])), np.zeros(2))


@pytest.mark.parametrize(
    ("given", "complaint"),
    [
        (command(5.4, 0.0, 100.0, 0.0), ""),
        (command(5.6, 0.0, 100.0, 0.0), TOO_EARLY),
        (command(5.0, 0.0, 100.0), "ends at [100.0, -100.0]"),
        (command(5.0, 0.0, 100.0, 0.0, spacing=6.0), "lasts 12"),
        (serialize_message(JointTrajectory()), "is wrong"),
    ],
    ids=range(5),  # padding of messages differs between the processes of a test run
)
def test_each_bad_command_has_one_complaint(given, complaint) -> None:
    judge = Judge()
    judge.clock(clock_message(5 * SECOND), 10 * SECOND, 0)
    judge.trajectory(given, 10 * SECOND, 0)
    assert len(judge.limits.broken) == bool(complaint)
    assert complaint in "".join(judge.limits.broken)


def wall(x: float) -> Grid:
    """Floor of 6 m x 2 m, occupied beyond x [m]."""
    occupied = np.zeros((20, 60), dtype=bool)
    occupied[:, round(10 * x):] = True
    return Grid(occupied, 0.1)


def rolled(check: ContactCheck, start: float, end: float) -> list[str]:
    """Roll along the middle of the floor in steps of 1 cm; return the complaints."""
    found = [check.observe(np.array((x, 1.0))) for x in np.arange(start, end, 0.01)]
    return [text for text in found if text]


@pytest.mark.parametrize("x", [2.0, 4.0])
def test_rolling_into_what_is_in_force_is_found_once(x: float) -> None:
    check = ContactCheck()
    assert rolled(check, 0.5, 5.0) == []
    check.place = None
    rolled(check, 0.9, 1.0)
    check.floor(wall(x))
    assert rolled(check, 1.0, x - RADIUS - 0.01) == []
    (found,) = rolled(check, x - RADIUS - 0.01, x + 0.2)
    assert not check.excused
    assert "rolled on in contact" in found
    check.floor(None)
    assert rolled(check, x + 0.2, x + 0.5) == []


@pytest.mark.parametrize("x", [0.8, 1.0 + RADIUS, 1.0 + RADIUS + 0.4])
def test_what_comes_too_near_allows_the_way_of_a_stop(x: float) -> None:
    check = ContactCheck()
    rolled(check, 0.9, 1.0)
    check.floor(wall(x))
    end = max(1.0, x - RADIUS) + STOPPING - 0.03
    assert rolled(check, 1.0, end) == []
    assert check.excused
    # The same floor again allows no more.
    check.floor(wall(x))
    assert len(rolled(check, end, end + 0.2)) == 1


@pytest.mark.parametrize(
    ("line", "complaint"),
    [
        ("[WARN] [1.0] [controller]: pose refused: given 'm\\x1b', \u00fc", []),
        ("Traceback (most recent call last):", ["an uncaught exception in the log"]),
        ("x" * 501, ["a long line in the log"]),
        (FORGED, ["a forged line in the log"]),
        ("frame '\x1b[2J'", ["control characters in the log"]),
        ("a.py:1: RuntimeWarning: overflow", ["a warning of a library in the log"]),
    ],
)
def test_each_fault_of_a_log_has_one_complaint(line, complaint) -> None:
    assert list(faults_of_line(line)) == complaint


@pytest.mark.parametrize(
    ("line", "complaints"),
    [
        ("simulator: wall touched: by the sphere at [0.700, 0.000] m, t = 3.200 s; 1 contact so "
         "far", ["the sphere touched an obstacle"]),
        ("simulator: map refused: map: given a value of 101", []),
    ],
)
def test_sphere_that_touched_an_obstacle_has_a_complaint(line, complaints) -> None:
    reports = SimpleNamespace(name=lambda words: any(word in line for word in words))
    trial = Trial(SimpleNamespace(judge=Judge(), reports=reports, processes=[]), ())
    trial._judge_reports({})
    assert trial._complaints == complaints


def test_maps_of_faults_are_an_obstacle_at_its_place_or_refused() -> None:
    message = serialize_message(map_message(np.array([1.0, -2.0])))
    grid = map_of_message(message, "world")(0.65, False)
    rows, columns = np.nonzero(grid.occupied)
    places = grid.world(np.column_stack((columns, rows)) + 0.5)
    np.testing.assert_allclose(places.mean(axis=0), [1.0, -2.0])
    assert np.all(np.abs(places - [1.0, -2.0]) < 0.3) and len(places) == 36
    for seed in range(60):
        bad = serialize_message(bad_map(random.Random(seed)))
        with pytest.raises(InvalidMapError):
            map_of_message(bad, "world")(0.65, False)


def test_areas_and_maps_are_usable_or_refused_and_leave_room_for_a_stop() -> None:
    rng, place, goal = random.Random(0), np.array((0.3, -0.4)), np.array((1.5, 1.0))
    used = refused = over = 0
    for _ in range(300):
        corners = _corners(rng, place, goal)
        number, given = keepout_of_message(_area(7, corners), "world")
        assert number == 7
        if not given:
            continue
        try:
            polygon = check_polygon("keepout 7", given)
        except SphereNmpcError:
            refused += 1
            continue
        used += 1
        inside = np.linalg.norm(polygon - place, axis=1).min() < _AWAY - 1e-6
        over += inside
    assert min(used, refused, over) > 10
    for _ in range(20):
        grid = map_of_message(bytes(serialize_message(_map(rng, place))), "world")(0.65, False)
        assert exact_distance(grid, place, 3.0) >= _AWAY - 1e-6
        assert Layers(map=grid).grid(RADIUS) is grid


def test_memory_is_compared_in_the_first_and_the_last_quarter() -> None:
    assert memory_at_ends([1.0, 1.0, 5.0, 5.0, 5.0, 5.0, 2.0, 3.0]) == (1.0, 2.5)
    assert memory_at_ends([4.0]) == (4.0, 4.0)
    assert memory_at_ends([]) == (0.0, 0.0)
