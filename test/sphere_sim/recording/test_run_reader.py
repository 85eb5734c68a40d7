# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Bags of the robot of every kind give the same arrays; anything else gives one clear error."""

import dataclasses

import numpy as np
import pytest

from sphere_nmpc.model.drift import imbalance_of_offset, momentum_of_push, slope_torque
from sphere_nmpc.model.parameters import RobotParameters
from sphere_sim.recording.errors import BagError
from sphere_sim.recording.run_reader import read_run


def without(entries, *names):
    return (entry for entry in entries if not entry[0].endswith(names))


@pytest.mark.parametrize("kind", ["own", "mcap", "sqlite3"])
def test_run_is_read_from_every_kind_of_bag(make_bag, messages, kind) -> None:
    run = read_run(make_bag(messages(), kind))
    assert run.notes == ()
    assert run.origin == 5.0
    np.testing.assert_allclose(run.times, np.arange(301) * 0.01, atol=1e-9)
    np.testing.assert_allclose(run.states[0], [2, -1, np.cos(0.5), 0, 0, np.sin(0.5)])
    np.testing.assert_allclose(run.rotor_speeds[0], [100.0, -50.0])
    np.testing.assert_allclose(run.rotor_torques[0], [1.0, -0.5])
    np.testing.assert_allclose(run.goal, [0, 0, 1, 0, 0, 0])
    assert run.goal_times.tolist() == [0.0]
    assert len(run.plans) == 7
    np.testing.assert_allclose(run.plans[1].times, [0.5, 1.0])
    np.testing.assert_allclose(run.plans[1].speeds, [[1, 2], [3, 4]])
    np.testing.assert_allclose(run.solves.times, np.arange(7) * 0.5, atol=1e-9)
    np.testing.assert_allclose(run.solves.durations[:2], [1e-3, 51e-3])
    assert set(run.solves.statuses) == {"solved"}


@pytest.mark.parametrize("kind", ["own", "mcap", "sqlite3"])
def test_momentum_and_pushes_are_read(make_bag, messages_with_momentum, kind) -> None:
    momentum = read_run(make_bag(messages_with_momentum(), kind)).momentum
    assert not momentum.is_zero
    np.testing.assert_allclose(momentum.times, np.arange(7) * 0.5, atol=1e-9)
    assert not momentum.values[:3].any()
    np.testing.assert_allclose(momentum.values[3:], np.tile([0.075, 0.15, 0.0], (4, 1)))
    np.testing.assert_allclose(momentum.push_times, [1.0], atol=1e-9)
    np.testing.assert_allclose(momentum.impulses, [[0.5, -0.25]])
    assert momentum.drift_at(-0.1).is_zero and momentum.drift_at(0.6).is_zero
    drift, robot = momentum.drift_at(1.6), RobotParameters()
    np.testing.assert_allclose(drift.momentum, momentum_of_push(robot, (0.5, -0.25)), rtol=1e-9)
    slope, offset = slope_torque(robot, np.radians(0.5), np.pi / 2), np.full(3, 1e-3)
    np.testing.assert_allclose(drift.slope, slope, atol=1e-9)
    np.testing.assert_allclose(drift.imbalance, imbalance_of_offset(robot, offset), rtol=1e-9)
    assert np.all(np.isnan(momentum.at(-0.1)))
    assert momentum.at(1.6).tolist() == momentum.at(99.0).tolist() == [0.075, 0.15, 0.0]


def test_bag_of_a_controller_that_reports_no_momentum_has_none(make_bag, messages) -> None:
    momentum = read_run(make_bag(messages())).momentum
    assert momentum.is_zero and momentum.times.shape == (0,) and momentum.values.shape == (0, 3)


def test_quaternions_do_not_jump_to_the_other_sign(make_bag, messages) -> None:
    run = read_run(make_bag(messages()))
    assert np.max(np.abs(np.diff(run.states, axis=0))) < 0.1


def test_metrics_are_those_of_the_recorded_motion(make_bag, messages) -> None:
    metrics = read_run(make_bag(messages())).metrics()
    assert metrics is not None and metrics.settled
    # |x - x_d| = decay * |(2, -1, 1/2)| for small angles.
    expected = 3.01 * np.log(100.0 * np.sqrt(5.25)) / 10.0
    assert metrics.settle_time_s == pytest.approx(expected, abs=0.02)
    assert metrics.max_rotor_speed == 100.0
    assert metrics.max_rotor_torque_nm == pytest.approx(1.0)


def test_single_file_and_folder_without_metadata_are_read(make_bag, messages) -> None:
    folder = make_bag(messages())
    (folder / "metadata.yaml").unlink()
    run = read_run(folder)
    assert len(run.times) == 301 and "metadata.yaml is missing" in run.notes[0]
    assert len(read_run(next(folder.glob("*.mcap"))).times) == 301


def test_missing_topics_are_noted_and_the_rest_is_read(make_bag, messages) -> None:
    names = ("joint_states", "rotor_trajectory", "active_goal", "goal_pose", "status")
    run = read_run(make_bag(without(messages(), *names)))
    assert len(run.times) == 301
    assert run.goal is None and run.metrics() is None
    notes = " ".join(run.notes)
    for name in ("joint_states", "rotor_trajectory", "active_goal", "reports a solve"):
        assert name in notes


@pytest.mark.parametrize("kind", ["mcap", "sqlite3"])
def test_names_that_act_on_a_terminal_are_no_topics(make_bag, messages, kind) -> None:
    lures = ("\x1b]0;mine\x07", "\n[FATAL] all is lost ", 1000 * "x")
    strange = [(f"/{lure}/active_goal", *next(messages())[1:]) for lure in lures]
    run = read_run(make_bag([*messages(), *strange], kind))
    assert run.notes == () and len(run.times) == 301


def test_goal_pose_replaces_a_missing_active_goal(make_bag, messages) -> None:
    run = read_run(make_bag(without(messages(), "active_goal")))
    assert run.goal is not None and any("goal_pose is used" in note for note in run.notes)


def test_goal_is_in_force_from_when_the_controller_accepted_it(make_bag, messages) -> None:
    entries = list(messages())
    place = next(i for i, e in enumerate(entries) if e[0] == "/controller/active_goal")
    topic, kind, stamp, goal = entries[place]
    entries[place] = (topic, kind, stamp + 40_000_000, dataclasses.replace(
        goal, header=dataclasses.replace(entries[place + 1][3].header)
    ))
    run = read_run(make_bag(entries))
    assert run.goal_times.tolist() == [0.0], "and its first solve is one of those measured"


def test_invalid_poses_are_ignored_with_a_note(make_bag, messages) -> None:
    entries = list(messages())
    poses = [i for i, entry in enumerate(entries) if entry[0] == "/pose"]
    place = entries[poses[5]][3].pose
    entries[poses[5]] = (
        *entries[poses[5]][:3],
        dataclasses.replace(
            entries[poses[5]][3],
            pose=dataclasses.replace(
                place, position=dataclasses.replace(place.position, x=float("nan"))
            ),
        ),
    )
    run = read_run(make_bag(entries))
    assert len(run.times) == 300 and np.all(np.isfinite(run.states))
    assert "1 invalid poses were ignored" in run.notes[0]


def test_robots_are_selected_by_namespace(make_bag, messages) -> None:
    bag = make_bag([*messages("/left"), *messages("/right")])
    with pytest.raises(BagError, match=r"several robots.*/left, /right"):
        read_run(bag)
    assert read_run(bag, "left").notes == ()
    with pytest.raises(BagError, match="no robot in namespace 'up'"):
        read_run(bag, "up")


def test_bag_of_another_robot_is_refused(make_bag, messages) -> None:
    with pytest.raises(BagError, match="another robot; has: /rotor_trajectory"):
        read_run(make_bag(e for e in messages() if e[0] == "/rotor_trajectory"))


def test_bag_with_other_joints_is_refused(make_bag, messages) -> None:
    entries = [
        (*entry[:3], dataclasses.replace(entry[3], name=["hip", "knee"]))
        if entry[0] == "/joint_states" else entry
        for entry in messages()
    ]
    with pytest.raises(BagError, match=r"names \['hip', 'knee'\].*another robot"):
        read_run(make_bag(entries))


def test_empty_bag_is_refused(make_bag) -> None:
    with pytest.raises(BagError, match="is empty: it has no topic at all"):
        read_run(make_bag([]))


@pytest.mark.parametrize(
    ("make", "reason"),
    [
        (lambda path: None, "no such file or folder"),
        (lambda path: path.mkdir(), "holds no .mcap or .db3 file"),
        (lambda path: path.write_text("x"), "expected a folder, a .mcap or a .db3 file"),
    ],
)
def test_path_that_is_not_a_bag_is_refused(tmp_path, make, reason) -> None:
    path = tmp_path / "thing"
    make(path)
    with pytest.raises(BagError, match=reason):
        read_run(path)
