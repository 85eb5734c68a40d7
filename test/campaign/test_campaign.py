# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The hardest faults on running nodes over DDS, several at once; the command around the trials."""

import itertools

import pytest

pytest.importorskip("rclpy")

from catalogue import FAULTS, chosen, combined
from faults import main
from outcome import Outcome, read_outcomes, write_json
from trial import Plan, Settings, run_trials

from sphere_nmpc.errors import SphereNmpcError
from sphere_nmpc.model.parameters import RobotParameters

ROBOT = RobotParameters()
PLANS = (
    Plan(("pose_dropped_100", "clock_back", "worker_killed")),
    Plan(("goal_malformed", "controller_killed", "disk_full")),
)
CONTACT = (Plan(("pose_nan", "burst_commands", "controller_stopped")),)
OF_A_BUSY_MACHINE = ("rotors turned for", "rotor_trajectory starts")
"""Complaints that a busy machine alone can cause: the controller was not run for a while."""
IN_COMMON = {
    "seed": 0, "rtf": 2.0, "strategy": "time_optimal", "plant": "rolling", "rate": 20.0,
}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("plant", "plans", "rtf"),
    # Slowly, as the nodes share processors with other tests.
    [("rolling", PLANS, 1.0), ("rigid_body", CONTACT, 0.5)],
)
def test_faults_at_once_are_named_and_the_goal_is_reached_within_the_limits(
    tmp_path, plant, plans, rtf
) -> None:
    if plant == "rigid_body":
        pytest.importorskip("mujoco")
    outcomes = list(run_trials(plans, Settings(rtf=rtf, plant=plant), tmp_path, 1))
    assert [outcome.fault for outcome in outcomes] == [plan.name for plan in plans]
    for outcome in outcomes:
        assert [c for c in outcome.complaints if not c.startswith(OF_A_BUSY_MACHINE)] == []
        assert outcome.recovery >= 0.0
        assert 0.0 < outcome.worst_speed <= ROBOT.max_rotor_speed * 1.001
        assert 0.0 < outcome.worst_slew <= ROBOT.max_rotor_acceleration * 1.01


def test_campaign_that_is_complete_runs_nothing_when_it_is_resumed(tmp_path, capsys) -> None:
    path = tmp_path / "f.json"
    outcomes = [Outcome("pose_nan", 1.0), Outcome("pose_nan", 3.0, repetition=1)]
    write_json(path, outcomes, IN_COMMON)
    assert read_outcomes(path, IN_COMMON) == outcomes
    given = ["--json", str(path), "--fault", "pose_nan", "--repeat", "2", "--resume"]
    assert main(given) == 0
    printed = capsys.readouterr().out
    assert "| pose_nan | 2 of 2 | 2.0 | 3.0 |" in printed and "2 of 2 trials survived" in printed
    with pytest.raises(SphereNmpcError, match="'seed': 0"):
        main([*given, "--seed", "1"])


def test_quick_campaign_has_each_group_and_less_than_half_of_the_faults() -> None:
    quick = chosen(FAULTS.values(), quick=True)
    assert {fault.group for fault in quick} == {fault.group for fault in FAULTS.values()}
    assert len(quick) < len(FAULTS) / 2


@pytest.mark.parametrize("size", [2, 3])
def test_combined_faults_have_different_actions_and_do_not_undo_each_other(size) -> None:
    impossible = (
        {"controller_killed", "parameters_live"}, {"parameters_at_start", "parameters_live"},
        {"recorder_killed", "disk_full"}, {"simulator_killed", "push"},
        {"simulator_stopped", "tilt"}, {"simulator_stopped", "parameters_live"},
        {"controller_stopped", "cpu_starved"}, {"controller_stopped", "controller_killed"},
        {"burst_clock", "clock_lost"}, {"controller_killed", "worker_killed"},
        {"worker_stopped", "cpu_starved"},
    )
    everything = combined(FAULTS.values(), size, 100_000, seed=0)
    assert 500 < len(everything) < 100_000
    assert combined(FAULTS.values(), size, 20, seed=0) == everything[:20]
    for faults in everything:
        for one, other in itertools.combinations(faults, 2):
            assert one.group == "pose" or one.action is not other.action
            assert {one.name, other.name} not in impossible
