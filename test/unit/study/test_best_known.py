# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Best known times: for which robot they are searched, where, and how they are kept."""

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sphere_nmpc.model.disturbance import (
    Disturbance,
    imbalance_of_offset,
    momentum_of_push,
    rest_speeds,
    slope_torque,
)
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import MOMENTUM, POSE, without_momentum
from sphere_sim.scenario.scenarios import draw_scenarios
from sphere_sim.study import best_known
from sphere_sim.study.best_known import BestKnownTimes, best_known_time, best_known_times
from sphere_sim.study.motion import Motion, motion_of
from sphere_sim.study.record import RunRecord
from sphere_sim.study.workers import Workers
from sphere_sim.world.disturbances import DisturbanceSettings

SCENARIOS = draw_scenarios(2, 11)
MOTIONS = [Motion(without_momentum(scenario.start), scenario.goal) for scenario in SCENARIOS]
ROBOT = RobotParameters()
PUSH = momentum_of_push(ROBOT, np.array([0.3, -0.4]))
PUSHED = np.concatenate((SCENARIOS[0].start, PUSH))
SLOPE = Disturbance(slope_torque(ROBOT, 0.01, 1.0))


def times(motions: list[Motion] = MOTIONS, robot: RobotParameters = ROBOT) -> list[BestKnownTimes]:
    with Workers() as workers:
        return best_known_times(motions, robot, workers)


def numbered(last: int) -> list[BestKnownTimes]:
    """Return the results of the searches that the fixture `searched` stands in for."""
    return [BestKnownTimes(float(number), 0.5 * number) for number in range(1, last + 1)]


@pytest.fixture
def cache(tmp_path, monkeypatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path / "sphere_nmpc" / "best_known_times.jsonl"


@pytest.fixture
def searched(cache, monkeypatch) -> list[tuple[Motion, RobotParameters]]:
    """Return a list of the searches that are made; the durations found are their numbers."""
    made: list[tuple[Motion, RobotParameters]] = []

    def search(motion: Motion, robot: RobotParameters, factor: float) -> BestKnownTimes:
        made.append((motion, robot))
        return numbered(len(made))[-1]

    monkeypatch.setattr(best_known, "best_known_time", search)
    return made


def test_times_are_kept_and_found_again(cache, searched) -> None:
    found = times()
    kept = [tuple(line[1:]) for line in map(json.loads, cache.read_text().splitlines())]
    assert kept == found == times() == numbered(2)


@pytest.mark.parametrize(
    "change",
    [
        {"robot": {"shell_mass": 1.5}}, {"robot": {"max_rotor_torque": 1.6}},
        {"motion": {"goal": SCENARIOS[1].goal}}, {"motion": {"speeds": np.array([1.0, 0.0])}},
        {"motion": {"start": PUSHED}}, {"motion": {"disturbance": SLOPE}},
        {"SEARCH_VERSION": -1}, {"EFFORT": 1000},
    ],
    ids=str,
)
def test_another_robot_motion_or_search_has_a_time_of_its_own(
    searched, monkeypatch, change
) -> None:
    assert times(MOTIONS[:1]) == numbered(1)
    for name, value in change.items():
        if name.isupper():
            monkeypatch.setattr(best_known, name, value)
    motion = replace(MOTIONS[0], **change.get("motion", {}))
    assert times([motion], replace(ROBOT, **change.get("robot", {}))) == numbered(2)[1:]


def test_motion_of_a_run_begins_at_its_push() -> None:
    scenario = replace(SCENARIOS[0], disturbances={"slope": 0.01, "slope_direction": 1.0})
    settings = DisturbanceSettings(slope=0.02, mass_offset_x=1e-3)
    at_push = np.concatenate((SCENARIOS[1].start, [3.0, 4.0], [0.1, 0.2, 0.0]))
    from_start = motion_of(scenario, RunRecord({}), ROBOT, settings)
    pushed = motion_of(scenario, RunRecord({}, at_push=at_push), ROBOT, settings)
    for motion, start in ((from_start, scenario.start), (pushed, SCENARIOS[1].start)):
        np.testing.assert_array_equal(motion.start[POSE], start)
        np.testing.assert_array_equal(motion.goal, scenario.goal)
        np.testing.assert_array_equal(motion.disturbance.slope, SLOPE.slope)
        expected = imbalance_of_offset(ROBOT, np.array([1e-3, 0.0, 0.0]))
        np.testing.assert_array_equal(motion.disturbance.imbalance, expected)
    assert from_start.starts_at_rest and not pushed.starts_at_rest
    np.testing.assert_array_equal(pushed.speeds, [3.0, 4.0])
    np.testing.assert_allclose(pushed.start[MOMENTUM], [12.5, 25.0, 0.0])


def test_fastest_motion_is_found_and_a_pushed_sphere_needs_time_also_at_its_goal(
    monkeypatch,
) -> None:
    # Little is spent on each search: no short times are needed here.
    monkeypatch.setattr(best_known, "EFFORT", 60_000)
    monkeypatch.setattr(best_known, "SEARCHES", 1)
    found = best_known_time(MOTIONS[0], ROBOT)
    assert 0.25 < found.settling < found.duration < 20.0
    upright = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    start = np.concatenate((upright, PUSH))
    held = Motion(start, upright, rest_speeds(PUSH, upright[2:]))
    assert best_known_time(held, ROBOT) == (0.0, 0.0)
    # At 400 rad/s^2 the rotors take 15 / 400 s to hold 11 and 15 rad/s.
    seconds = best_known_time(replace(held, speeds=np.zeros(2)), ROBOT).duration
    assert 15.0 / 400.0 < seconds < 1.0
    # A search for a motion from rest to rest in place would never end.
    slight = np.concatenate((upright, momentum_of_push(ROBOT, np.array([1e-4, 0.0]))))
    assert best_known_time(Motion(slight, upright), ROBOT) == (0.0, 0.0)


def test_cache_that_cannot_be_used_is_one_warning(cache, searched, caplog) -> None:
    cache.parent.mkdir()
    os.mkfifo(cache)
    assert times() == numbered(2)
    (warning,) = caplog.messages
    assert str(cache) in warning and "\n" not in warning
