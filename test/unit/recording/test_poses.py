# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Stamps that cannot be used are counted and told, and no figure depends on them."""

import dataclasses

import numpy as np
import pytest
from recorded_bags import (
    START,
    STEP,
    changed,
    in_order,
    run_messages,
    walled_messages,
    write_own,
)

from sphere_sim.recording.bag_files import BagError
from sphere_sim.recording.run_reader import read_run

NOW = 1_800_000_000 * 10**9


def live(entries):
    """Return entries of a robot on the system clock, by log time and stamp."""
    return [changed(entry, log=entry[2] + NOW, stamp=entry[2] + NOW)
            if hasattr(entry[3], "header") else (*entry[:2], entry[2] + NOW, entry[3])
            for entry in entries]


def restamped(entries, ending: str, stamp_of) -> list:
    """Return entries with other stamps of a topic, from its number, log time; None leaves it."""
    found, number = [], 0
    for entry in entries:
        stamp = None
        if entry[0].endswith(ending):
            stamp, number = stamp_of(number, entry[2]), number + 1
        found.append(entry if stamp is None else changed(entry, stamp=stamp))
    return found


def figures(run):
    return pytest.approx(dataclasses.asdict(run.metrics()), nan_ok=True, rel=1e-6, abs=1e-6)


def test_poses_without_any_stamp_have_their_log_times(tmp_path) -> None:
    expected = read_run(write_own(tmp_path / "whole", live(run_messages())))
    entries = restamped(live(run_messages()), "/pose", lambda number, log: 0)
    run = read_run(write_own(tmp_path / "bag", entries))
    assert dataclasses.asdict(run.metrics()) == figures(expected)
    np.testing.assert_allclose(run.times, STEP * 1e-9 * np.arange(301), atol=1e-6)
    (note,) = run.notes
    assert note.startswith("/pose: 301 of 301 poses have the stamp 0, so that their log times")


@pytest.mark.parametrize(
    ("stamp", "note"),
    [
        (lambda number, log: 0 if number % 3 == 1 else None,
         "/pose: 100 poses with the stamp 0 were ignored"),
        (lambda number, log: 5 * 10**9 if number % 3 == 1 else None,
         "/pose: 100 poses were ignored, whose stamps are far from those around them"),
        (lambda number, log: log + 10**12 if number == 160 else None,
         "/pose: 1 poses were ignored, whose stamps are far from those around them"),
        (lambda number, log: log - 10**12 if number == 160 else None,
         "/pose: 1 poses were ignored, whose stamps are far from those around them"),
        (lambda number, log: log - 10**12 if number == 0 else None,
         "/pose: 1 poses were ignored, whose stamps are far from those around them"),
        (lambda number, log: log + 10**12 if number == 300 else None,
         "/pose: 1 poses were ignored, whose stamps are far from those around them"),
    ],
    ids=["0", "simulated", "later", "earlier", "first", "last"],
)
def test_poses_with_other_stamps_are_ignored_and_told(tmp_path, stamp, note) -> None:
    expected = read_run(write_own(tmp_path / "whole", live(run_messages())))
    run = read_run(write_own(tmp_path / "bag", restamped(live(run_messages()), "/pose", stamp)))
    assert run.notes == (note,)
    assert len(run.times) == 301 - int(note.split()[1])
    assert run.metrics().settle_time_s == pytest.approx(
        expected.metrics().settle_time_s, abs=0.011
    )
    assert run.times[-1] == pytest.approx(3.0, abs=0.011)


def test_stamp_0_at_the_beginning_of_simulated_time_is_one(tmp_path) -> None:
    entries = restamped(run_messages(), "/pose", lambda number, log: log - START)
    run = read_run(write_own(tmp_path / "bag", entries))
    assert len(run.times) == 301 and run.times[-1] == pytest.approx(3.0)


@pytest.mark.parametrize("ending", ["/joint_states", "/active_goal"])
def test_other_messages_without_a_stamp_have_their_log_times(tmp_path, ending) -> None:
    expected = read_run(write_own(tmp_path / "whole", live(run_messages())))
    entries = restamped(live(run_messages()), ending, lambda number, log: 0)
    run = read_run(write_own(tmp_path / "bag", entries))
    assert dataclasses.asdict(run.metrics()) == figures(expected)
    np.testing.assert_allclose(run.joint_times, expected.joint_times, atol=1e-6)
    (note,) = run.notes
    assert f"{ending}: " in note and "stamps are not of the clock of the poses" in note


def test_floor_without_a_stamp_has_its_log_time(tmp_path) -> None:
    entries = restamped(live(walled_messages(0.1)), "/floor", lambda number, log: 0)
    run = read_run(write_own(tmp_path / "bag", entries))
    assert run.floors.times == pytest.approx([0.0], abs=0.03)
    assert "/controller/floor: 1 stamps are not of the clock of the poses; the log times are " \
        "used" in run.notes


def test_poses_without_any_time_give_no_figures(tmp_path) -> None:
    entries = restamped(run_messages(), "/pose", lambda number, log: 0)
    entries = in_order(*(changed(entry, log=START) for entry in entries))
    with pytest.raises(BagError, match="/pose: no pose has a stamp or a log time of its own"):
        read_run(write_own(tmp_path / "bag", entries))
