# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The faults have distinct names, are chosen by them, and pairs are drawn by a seed."""

import pytest

from sphere_sim.faults.catalogue import FAULTS, chosen, name_of, pairs
from sphere_sim.faults.pose_stream import make_disturbance
from sphere_sim.ros.faults.actions import action_of

GROUPS = {
    "pose", "goal", "clock", "process", "solver", "cpu", "disk", "rival", "parameters",
}


def test_every_group_is_there_and_the_quick_campaign_has_each() -> None:
    assert {fault.group for fault in FAULTS.values()} == GROUPS
    assert {fault.group for fault in chosen(FAULTS.values(), quick=True)} == GROUPS


def test_quick_campaign_loses_sight_spoils_poses_and_kills() -> None:
    quick = {fault.name for fault in chosen(FAULTS.values(), quick=True)}
    assert {"pose_dropped_100", "pose_nan", "controller_killed"} <= quick
    assert len(quick) < len(FAULTS) / 2


@pytest.mark.parametrize("fault", FAULTS.values(), ids=lambda fault: fault.name)
def test_fault_can_be_brought_about(fault) -> None:
    assert action_of(fault)
    if fault.action == "pose":
        assert make_disturbance(fault.options)
    if fault.blind:
        assert fault.named_by, "who sees nothing has to say so"


def test_faults_are_chosen_by_their_names_and_groups() -> None:
    names = [fault.name for fault in chosen(FAULTS.values(), ["pose_nan", "goal"], quick=True)]
    assert names == ["pose_nan", "goal_burst", "goal_unreachable", "goal_malformed"]


def test_pairs_are_those_of_the_seed_and_none_comes_twice() -> None:
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
        assert {one.name, other.name} != {"controller_killed", "parameters_live"}
