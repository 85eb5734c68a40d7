# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Best known times: for which robot they are searched, where, and how they are kept."""

import json
import math
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sphere_nmpc.cache import CACHE_VARIABLE
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.solver.hold_solver import HoldSolver
from sphere_sim.scenario.scenarios import Scenario, draw_scenarios
from sphere_sim.study import best_known
from sphere_sim.study.best_known import best_known_time, best_known_times
from sphere_sim.study.workers import Workers

SCENARIOS = draw_scenarios(2, 11)
ROBOT = RobotParameters()


def times(scenarios: list[Scenario] = SCENARIOS, robot: RobotParameters = ROBOT) -> list[float]:
    with Workers() as workers:
        return best_known_times(scenarios, robot, workers)


@pytest.fixture(autouse=True)
def brief(monkeypatch) -> None:
    """Spend little on each search: these tests do not need short times."""
    monkeypatch.setattr(best_known, "EFFORT", 30_000)
    monkeypatch.setattr(best_known, "SEARCHES", 1)
    monkeypatch.setattr(best_known, "GRIDS", best_known.GRIDS[:1])
    HoldSolver()  # loads the compiled one before its folder is taken away


@pytest.fixture
def cache(tmp_path, monkeypatch) -> Path:
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "cache"))
    return tmp_path / "cache" / "best_known_times.jsonl"


@pytest.fixture
def searched(cache, monkeypatch) -> list[tuple[Scenario, RobotParameters]]:
    """Return a list of the searches that are made; their results are their numbers."""
    made: list[tuple[Scenario, RobotParameters]] = []

    def search(scenario: Scenario, robot: RobotParameters) -> float:
        made.append((scenario, robot))
        return float(len(made))

    monkeypatch.setattr(best_known, "best_known_time", search)
    return made


def test_times_are_kept_and_found_again(cache, monkeypatch) -> None:
    found = times()
    assert [line[1] for line in map(json.loads, cache.read_text().splitlines())] == found

    def search(scenario: Scenario, robot: object) -> float:
        raise AssertionError("searched for again")

    monkeypatch.setattr(best_known, "best_known_time", search)
    assert times() == found


@pytest.mark.parametrize(
    "change",
    [
        {"shell_mass": 1.5},
        {"shell_radius": 0.35},
        {"rotor_axial_inertia": 0.01},
        {"max_rotor_speed": 60.0},
        {"max_rotor_acceleration": 250.0},
        {"max_rotor_torque": 1.6},
    ],
    ids=str,
)
def test_another_robot_has_times_of_its_own(searched, change) -> None:
    assert times() == [1.0, 2.0]
    assert times(robot=replace(ROBOT, **change)) == [3.0, 4.0]
    assert times() == [1.0, 2.0]


def test_robots_that_move_alike_share_their_times(searched) -> None:
    first = times()
    # The rotors' transverse inertia moved into the counterweights', which sit at the same axes,
    # and a torque limit that is never reached.
    alike = replace(
        ROBOT, rotor_transverse_inertia=0.003, counterweight_transverse_inertia=0.005,
        max_rotor_torque=10.0,
    )
    assert times(robot=alike) == first


@pytest.mark.parametrize(
    ("name", "value"),
    [("SEARCH_VERSION", -1), ("SEARCHES", 3), ("EFFORT", 1000), ("GRIDS", (0.5, 0.25))],
)
def test_another_search_has_times_of_its_own(searched, monkeypatch, name, value) -> None:
    times()
    monkeypatch.setattr(best_known, name, value)
    assert times() == [3.0, 4.0]


def test_time_depends_on_start_and_goal_alone(searched) -> None:
    first = times()
    relabelled = [replace(s, seed=s.seed + 1, extra={"note": "a"}) for s in SCENARIOS]
    assert times(relabelled) == first
    assert times([replace(s, goal=s.start) for s in SCENARIOS]) == [3.0, 4.0]


def test_torque_limit_of_the_robot_costs_time() -> None:
    strong, weak = (
        best_known_time(SCENARIOS[0], replace(ROBOT, max_rotor_torque=limit))
        for limit in (0.0, 0.4)
    )
    assert weak > 1.05 * strong


def test_search_whose_refinement_fails_leaves_what_the_other_found(monkeypatch) -> None:
    alone = best_known_time(SCENARIOS[0], ROBOT)
    monkeypatch.setattr(best_known, "SEARCHES", 2)
    monkeypatch.setattr(best_known, "GRIDS", (0.25, 0.125))
    refined = iter([False, True])
    monkeypatch.setattr(
        best_known, "_refined", lambda arrival, *others: arrival if next(refined) else None
    )
    assert 0.0 < best_known_time(SCENARIOS[0], ROBOT) < 2.0 * alone


def test_start_at_the_goal_takes_no_time() -> None:
    assert best_known_time(replace(SCENARIOS[0], goal=SCENARIOS[0].start), ROBOT) == 0.0


def test_damaged_lines_of_the_cache_are_skipped(cache, caplog) -> None:
    found = times()
    first, second = cache.read_bytes().splitlines()
    key = json.dumps(json.loads(first)[0]).encode()
    damaged = [b"\xff", b"", b"{}", b"[1]", b"[[], 1.0]", b"[" * 100_000, first[:-3]]
    damaged += [b"[%s, %s]" % (key, value) for value in (b"-1", b"Infinity", b'"1"', b"null")]
    cache.write_bytes(b"\n".join([*damaged, first, second, b""]))
    assert times() == found
    assert not caplog.messages


def test_of_several_times_the_shortest_counts(cache) -> None:
    found = times()
    keys = [json.loads(line)[0] for line in cache.read_text().splitlines()]
    cache.write_text(
        "".join(
            f"{json.dumps([key, value])}\n"
            for key in keys
            for value in (np.nan, 0.5, 9.0)
        )
    )
    assert times() == [0.5, 0.5] != found


def file_in_place_of_the_folder(cache: Path) -> None:
    cache.parent.write_text("")


def folder_in_place_of_the_file(cache: Path) -> None:
    cache.mkdir(parents=True)


def pipe(cache: Path) -> None:
    cache.parent.mkdir()
    os.mkfifo(cache)


@pytest.mark.parametrize(
    "obstacle", [file_in_place_of_the_folder, folder_in_place_of_the_file, pipe]
)
def test_cache_that_cannot_be_used_is_one_warning(cache, obstacle, caplog) -> None:
    obstacle(cache)
    assert all(math.isfinite(seconds) for seconds in times())
    (warning,) = caplog.messages
    assert str(cache) in warning and "\n" not in warning
