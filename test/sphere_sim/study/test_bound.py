# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Best known times are kept where that is possible; where not, they are found all the same."""

import json
import math
import os
from pathlib import Path

import pytest

from sphere_nmpc.cache import CACHE_VARIABLE
from sphere_nmpc.solver.hold_solver import HoldSolver
from sphere_sim.scenario.scenarios import Scenario, draw_scenarios
from sphere_sim.study import bound
from sphere_sim.study.bound import best_known_times

SCENARIOS = draw_scenarios(2, 11)


@pytest.fixture(autouse=True)
def brief(monkeypatch) -> None:
    """Spend little on each search: how good the times are is no matter here."""
    monkeypatch.setattr(bound, "EFFORT", 30_000)
    monkeypatch.setattr(bound, "SEARCHES", 1)
    monkeypatch.setattr(bound, "GRIDS", bound.GRIDS[:1])
    HoldSolver()  # loads the compiled one before its folder is taken away


@pytest.fixture
def cache(tmp_path, monkeypatch) -> Path:
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "cache"))
    return tmp_path / "cache" / "best_known_times.jsonl"


def test_times_are_kept_and_found_again(cache, monkeypatch) -> None:
    found = best_known_times(SCENARIOS)
    assert [line[1] for line in map(json.loads, cache.read_text().splitlines())] == found

    def search(scenario: Scenario, robot: object) -> float:
        raise AssertionError("searched for again")

    monkeypatch.setattr(bound, "best_known_time", search)
    assert best_known_times(SCENARIOS) == found


def test_rubbish_in_the_cache_is_passed_over(cache, caplog) -> None:
    found = best_known_times(SCENARIOS)
    first, second = cache.read_bytes().splitlines()
    key = json.dumps(json.loads(first)[0]).encode()
    rubbish = [b"\xff", b"", b"{}", b"[1]", b"[[], 1.0]", b"[" * 100_000, first[:-3]]
    rubbish += [b"[%s, %s]" % (key, value) for value in (b"-1", b"Infinity", b'"1"', b"null")]
    cache.write_bytes(b"\n".join([*rubbish, first, second, b""]))
    assert best_known_times(SCENARIOS) == found
    assert not caplog.messages


def in_place_of_folder(cache: Path) -> None:
    cache.parent.write_text("")


def in_place_of_file(cache: Path) -> None:
    cache.mkdir(parents=True)


def pipe(cache: Path) -> None:
    cache.parent.mkdir()
    os.mkfifo(cache)


@pytest.mark.parametrize("obstacle", [in_place_of_folder, in_place_of_file, pipe])
def test_cache_that_cannot_be_used_is_told_once(cache, obstacle, caplog) -> None:
    obstacle(cache)
    assert all(math.isfinite(seconds) for seconds in best_known_times(SCENARIOS))
    (told,) = caplog.messages
    assert str(cache) in told and "\n" not in told
