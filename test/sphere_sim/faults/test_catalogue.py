# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Faults have actions, are selected by name or group, and are combined by a seed."""

import itertools

import pytest

from sphere_sim.faults.catalogue import FAULTS, chosen, combined, name_of
from sphere_sim.ros.faults.actions import action_of

GROUPS = {
    "pose", "burst", "goal", "clock", "process", "solver", "cpu", "disk", "rival", "parameters",
    "disturbance", "worker",
}

IMPOSSIBLE = (
    {"controller_killed", "parameters_live"}, {"parameters_at_start", "parameters_live"},
    {"recorder_killed", "disk_full"}, {"simulator_killed", "push"}, {"simulator_killed", "tilt"},
    {"simulator_stopped", "push"}, {"simulator_stopped", "parameters_live"},
    {"controller_stopped", "cpu_starved"}, {"controller_stopped", "controller_killed"},
    {"burst_clock", "clock_lost"}, {"controller_killed", "worker_killed"},
    {"worker_stopped", "cpu_starved"},
)
"""Pairs of which the second fault needs the process that the first has ended or stopped, or undoes
the first."""


def test_every_group_is_there_and_the_quick_campaign_has_each() -> None:
    assert {fault.group for fault in FAULTS.values()} == GROUPS
    assert {fault.group for fault in chosen(FAULTS.values(), quick=True)} == GROUPS


def test_quick_campaign_has_less_than_half_of_the_faults() -> None:
    quick = {fault.name for fault in chosen(FAULTS.values(), quick=True)}
    assert {"pose_dropped_100", "pose_nan", "controller_killed"} <= quick
    assert len(quick) < len(FAULTS) / 2


@pytest.mark.parametrize("fault", FAULTS.values(), ids=lambda fault: fault.name)
def test_fault_has_an_action_for_its_options(fault) -> None:
    action = action_of(fault)
    assert all(callable(getattr(action, step)) for step in ("begin", "keep_on", "end", "clear"))


def test_disturbances_of_poses_are_different() -> None:
    options = [fault.options for fault in FAULTS.values() if fault.action == "pose"]
    assert len({tuple(sorted(given.items())) for given in options}) == len(options) > 10


def test_controller_has_to_report_that_it_gets_no_poses() -> None:
    blind = [fault for fault in FAULTS.values() if fault.blind]
    assert blind
    assert [fault.name for fault in blind if not fault.named_by] == []


def test_faults_are_selected_by_their_names_and_groups() -> None:
    names = [fault.name for fault in chosen(FAULTS.values(), ["pose_nan", "goal"], quick=True)]
    assert names == ["pose_nan", "goal_burst", "goal_unreachable", "goal_malformed"]


@pytest.mark.parametrize("size", [2, 3])
def test_combinations_are_those_of_the_seed_and_none_is_drawn_twice(size) -> None:
    drawn = combined(FAULTS.values(), size, 20, seed=5)
    assert drawn == combined(FAULTS.values(), size, 20, seed=5)
    assert drawn != combined(FAULTS.values(), size, 20, seed=6)
    assert len({name_of(faults) for faults in drawn}) == 20
    assert {len(faults) for faults in drawn} == {size}


@pytest.mark.parametrize("size", [2, 3])
def test_combined_faults_have_different_actions_and_do_not_undo_each_other(size) -> None:
    everything = combined(FAULTS.values(), size, 100_000, seed=0)
    assert 500 < len(everything) < 100_000
    for faults in everything:
        for one, other in itertools.combinations(faults, 2):
            assert one is not other
            assert one.action == "pose" or one.action != other.action
            assert {one.name, other.name} not in IMPOSSIBLE


def test_poses_and_commands_are_lost_alone_and_together() -> None:
    bursts = {fault.options["of"]: fault for fault in chosen(FAULTS.values(), ["burst"])}
    assert set(bursts) == {("poses",), ("commands",), ("poses", "commands"), ("clock",)}
    assert {fault.duration for fault in bursts.values()} == {2.0}
