# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The hardest faults on running nodes over DDS, several at once; the command around the trials."""

import json

import pytest

pytest.importorskip("rclpy")

from catalogue import FAULTS, chosen
from faults import write_json
from judge import TOO_EARLY
from node_session import Settings
from trial import Outcome, run_trials

from sphere_nmpc.model.parameters import RobotParameters

ROBOT = RobotParameters()
TOGETHER = (
    ("pose_dropped_100", "clock_back", "worker_killed"),
    ("solver_raises", "controller_killed", "disk_full"),
)
OF_A_BUSY_MACHINE = ("rotors turned for", "rotor_trajectory starts", TOO_EARLY)
"""Complaints that a busy machine alone can cause: the controller was not run for a while."""


@pytest.mark.slow
def test_faults_at_once_are_named_and_the_goal_is_reached_within_the_limits(tmp_path) -> None:
    plans = [(tuple(FAULTS[name] for name in names), 0) for names in TOGETHER]
    # Slowly, as the nodes share processors with other tests.
    outcomes = list(run_trials(plans, Settings(rtf=1.0), tmp_path))
    assert [outcome.fault for outcome in outcomes] == [" + ".join(names) for names in TOGETHER]
    for outcome in outcomes:
        assert [c for c in outcome.complaints if not c.startswith(OF_A_BUSY_MACHINE)] == []
        assert outcome.recovery >= 0.0
        assert 0.0 < outcome.worst_speed <= ROBOT.max_rotor_speed * 1.001
        assert 0.0 < outcome.worst_slew <= ROBOT.max_rotor_acceleration * 1.01


def test_json_of_a_campaign_has_a_row_for_each_fault(tmp_path) -> None:
    path = tmp_path / "f.json"
    outcomes = [Outcome("pose_nan", 1.0), Outcome("pose_nan", 3.0, repetition=1), Outcome("tilt")]
    write_json(path, outcomes, {"seed": 0})
    written = json.loads(path.read_text())
    assert written.keys() == {"campaign", "faults", "trials"} and len(written["trials"]) == 3
    first, second = written["faults"]
    assert first["tried"] == first["survived"] == 2
    assert (first["recover_median_s"], first["recover_s"]) == (2.0, 3.0)
    assert second["recover_s"] is None


def test_quick_campaign_has_each_group_and_less_than_half_of_the_faults() -> None:
    quick = chosen(quick=True)
    assert {fault.group for fault in quick} == {fault.group for fault in FAULTS.values()}
    assert len(quick) < len(FAULTS) / 2
