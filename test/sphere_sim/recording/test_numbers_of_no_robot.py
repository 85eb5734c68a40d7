# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Bags of others with numbers that no robot has: read, replayed and reported without a warning."""

from collections.abc import Callable, Iterator
from itertools import cycle
from typing import Any

import numpy as np
import pytest

pytest.importorskip("viser")

from recorded_bags import (
    changed,
    in_order,
    momentum_messages,
    run_messages,
    write_own,
    write_rosbag2,
)

from sphere_sim.recording.run_reader import read_run
from sphere_sim.report import report_files
from sphere_sim.report.report_files import write_report
from sphere_sim.report.reported import Reported, select_goals
from sphere_sim.viewer.replay import Replay
from sphere_sim.viewer.source import Seek
from sphere_sim.viewer.viewer import Viewer

NUMBERS = cycle((1e308, -1e308, 1e200, -1e100, 1e31, float("inf"), float("nan"), 1e300))


def of_a_pose(message: Any) -> None:
    part, name = next(PARTS)
    setattr(getattr(message.pose, part), name, next(NUMBERS))


PARTS = cycle((("position", "x"), ("position", "z"), ("orientation", "w"), ("position", "y"),
               ("orientation", "z")))


def of_joints(message: Any) -> None:
    message.velocity[:], message.effort[:] = next(NUMBERS), next(NUMBERS)


def of_a_plan(message: Any) -> None:
    message.points[0].velocities[:], message.points[1].velocities[:] = 1e308, -1e308


def of_a_status(message: Any) -> None:
    for pair in message.values:
        if pair.key != "plan":
            pair.value = str(next(NUMBERS))


def of_a_push(message: Any) -> None:
    message.vector.x = next(NUMBERS)


ALTERED: dict[str, Callable[[Any], None]] = {
    "pose": of_a_pose, "active_goal": of_a_pose, "joint_states": of_joints,
    "rotor_trajectory": of_a_plan, "status": of_a_status, "pushed": of_a_push,
}


def altered(entries: Iterator[Any]) -> Iterator[Any]:
    """Yield entries, and two of three again with numbers of no robot, a little later."""
    for i, (topic, kind, stamp, message) in enumerate(entries):
        yield topic, kind, stamp, message
        alter = ALTERED.get(topic.rpartition("/")[2])
        if alter is not None and i % 3:
            yield changed((topic, kind, stamp, message), log=stamp + 1, edit=alter)


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_numbers_that_no_robot_has_are_left_out(tmp_path, monkeypatch) -> None:
    ordinary = read_run(write_own(tmp_path / "ordinary", run_messages()))
    entries = in_order(*altered(run_messages()), *altered(momentum_messages()))
    run = read_run(write_rosbag2(tmp_path / "strange", entries))
    np.testing.assert_array_equal(run.times, ordinary.times)
    np.testing.assert_array_equal(np.abs(run.states), np.abs(ordinary.states))
    np.testing.assert_array_equal(run.goal, ordinary.goal)
    assert np.nanmax(np.abs(run.rotor_speeds)) <= 1e30
    assert all(np.abs(plan.speeds).max() < 5.0 for plan in run.plans)
    monkeypatch.setattr(
        report_files, "FIGURES",
        {name: report_files.FIGURES[name] for name in ("panels", "torque", "value")},
    )
    (out := tmp_path / "report").mkdir()
    reported = [Reported(run, select_goals(run, []))]
    assert write_report(reported, out, csv=True, parquet=False, animation=False).exists()
    replay = Replay(run)
    viewer = Viewer(replay, 0, live=False)
    try:
        for moment in np.linspace(0.0, 3.0, 4):
            replay.handle(Seek(float(moment)))
            viewer._panel_updated = 0.0
            viewer.tick()
            viewer._plots.show(viewer._history, viewer._frame.drive)
    finally:
        viewer.close()
    assert np.isfinite(viewer._frame.plan).all()
