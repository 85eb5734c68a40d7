# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Faults of the graph around a controller that follows a simulated clock which has stopped."""

import pytest

from sphere_nmpc.ros.graph_faults import SILENCE_LIMIT, GraphState, find_faults

LONG = 10.0 * SILENCE_LIMIT


@pytest.mark.parametrize(
    ("pose_silence", "pose_age", "kinds"),
    [(0.1, 0.0, []), (0.1, -5.0, ["clock stopped"]), (LONG, 0.0, ["clock stopped"])],
    ids=["paused", "no clock messages", "ended"],
)
def test_stopped_clock_is_a_fault_unless_the_simulator_repeats_its_last_pose(
    pose_silence, pose_age, kinds
) -> None:
    state = GraphState(
        follows_clock=True, time=3.0, clock_silence=LONG, pose_silence=pose_silence,
        pose_age=pose_age, pose_timeout=0.5, clocks=["/simulator"], poses=["/simulator"],
    )
    assert [fault.kind for fault in find_faults(state)] == kinds
