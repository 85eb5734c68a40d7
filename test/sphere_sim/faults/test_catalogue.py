# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Faults have actions, are selected by name or group, and are combined in pairs by a seed."""

import pytest

from sphere_sim.faults.catalogue import FAULTS, chosen, name_of, pairs
from sphere_sim.ros.faults.actions import action_of

GROUPS = {
    "pose", "goal", "clock", "process", "solver", "cpu", "disk", "rival", "parameters",
    "disturbance",
}

IMPOSSIBLE = (
    {"controller_killed", "parameters_live"}, {"parameters_at_start", "parameters_live"},
    {"recorder_killed", "disk_full"}, {"simulator_killed", "push"}, {"simulator_killed", "tilt"},
)
"""Pairs of which the second fault needs the process that the first has ended."""


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


def test_pairs_are_those_of_the_seed_and_none_is_drawn_twice() -> None:
    drawn = pairs(FAULTS.values(), 20, seed=5)
    assert drawn == pairs(FAULTS.values(), 20, seed=5)
    assert drawn != pairs(FAULTS.values(), 20, seed=6)
    assert len({name_of(pair) for pair in drawn}) == 20


def test_a_pair_is_of_two_actions_that_do_not_undo_each_other() -> None:
    everything = pairs(FAULTS.values(), 10_000, seed=0)
    assert len(everything) < 10_000
    for one, other in everything:
        assert one is not other
        assert one.action == "pose" or one.action != other.action
        assert {one.name, other.name} not in IMPOSSIBLE
