# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Bags of every recorder give the same arrays and times; others give one clear error."""

import dataclasses
from collections.abc import Sequence

import numpy as np
import pytest
from recorded_bags import (
    POSE,
    START,
    STEP,
    Entry,
    changed,
    demand,
    diagnostics,
    goal_at,
    in_order,
    momentum_messages,
    on_the_system_clock,
    pose,
    run_messages,
    walled_messages,
    without,
    write_rosbag2,
)
from rosbags.rosbag2 import Reader

from sphere_nmpc.model.disturbance import UNDISTURBED, imbalance_of_offset, slope_torque
from sphere_nmpc.model.goal import Orientation
from sphere_nmpc.model.parameters import RobotParameters
from sphere_sim.recording.bag_files import BagError
from sphere_sim.recording.run_reader import read_run

POSE_PERIOD = 0.01
STARTS = 0.5 * np.arange(7)
"""Times of the plans and solves of `run_messages` [s]."""


def figures(run) -> dict[str, float]:
    metrics = run.metrics()
    assert metrics is not None, run.notes
    return dataclasses.asdict(metrics)


def test_run_is_read_as_arrays(whole) -> None:
    run = whole
    assert run.notes == ()
    np.testing.assert_allclose(run.times, np.arange(301) * 0.01, atol=1e-9)
    np.testing.assert_allclose(run.states[0], [2, -1, np.cos(0.5), 0, 0, np.sin(0.5)])
    assert np.max(np.abs(np.diff(run.states, axis=0))) < 0.1, "no jump to the other sign"
    np.testing.assert_allclose(run.rotor_speeds.values[0], [100.0, -50.0])
    np.testing.assert_allclose(run.rotor_torques.values[0], [1.0, -0.5])
    np.testing.assert_allclose(run.goal, [0, 0, 1, 0, 0, 0])
    assert run.goals.times.tolist() == [0.0]
    assert len(run.plans) == 7
    np.testing.assert_allclose(run.plans.values[1].times, [0.5, 1.0])
    np.testing.assert_allclose(run.plans.values[1].speeds, [[1, 2], [3, 4]])
    np.testing.assert_allclose(run.solves.times, STARTS, atol=1e-9)
    np.testing.assert_allclose(run.solves.column("duration")[:2], [1e-3, 51e-3])
    assert {solve.plan for solve in run.solves.values} == {"solved"}
    assert not run.has_momentum
    # |x - x_d| = decay * |(2, -1, 1/2)| for small angles.
    expected = 3.01 * np.log(100.0 * np.sqrt(5.25)) / 10.0
    assert figures(run)["settle_time_s"] == pytest.approx(expected, abs=0.02)


def shift(message) -> None:
    for pair in message.values:
        if pair.key == "time_s":
            pair.value = str(float(pair.value) + 70.0)


UNDATED = [
    changed(entry, stamp=0) if entry[0] == "/rotor_trajectory" else
    changed(entry, edit=shift) if entry[0] == "/controller/status" else entry
    for entry in run_messages()
]
"""A run whose plans and solves have no time of their own, so that their log times count."""


@pytest.mark.parametrize(
    ("kind", "compression", "entries", "exactly"),
    [
        ("sqlite3", "", [*run_messages()], 1e-9), ("sqlite3", "file", UNDATED, POSE_PERIOD),
        ("mcap", "", UNDATED, POSE_PERIOD), ("mcap", "message", [*run_messages()], 1e-9),
    ],
    ids=["sqlite", "sqlite, compressed", "mcap", "mcap, compressed"],
)
def test_bags_of_other_recorders_give_the_same_run(
    tmp_path, whole, kind, compression, entries, exactly
) -> None:
    """Log times are of the system clock; stamps relate them to simulated time."""
    entries = on_the_system_clock(entries)
    custom = {"parameters:/controller": '{"robot.shell_mass": 1.5}'}
    bag = write_rosbag2(tmp_path / "mine", entries, kind, compression, 2, custom)
    with Reader(bag) as reader:  # an independent reader takes the bag of this test
        assert [log for _, log, _ in reader.messages()] == [entry[2] for entry in entries]
    (bag / "metadata.yaml").unlink()
    run = read_run(bag)
    assert run.notes and run.robot.shell_mass == 1.5
    assert run.times == pytest.approx(whole.times, rel=1e-9, abs=1e-9)
    assert run.goals.times == pytest.approx([0.0], abs=0.011)
    assert run.plans.times == pytest.approx(STARTS, abs=exactly)
    assert run.solves.times == pytest.approx(STARTS, abs=exactly)
    settled = "settle_time_s"
    assert figures(run)[settled] == pytest.approx(figures(whole)[settled], abs=0.011)


def test_momentum_and_pushes_are_read(read) -> None:
    run = read(momentum_messages())
    momentum, disturbances = run.momentum, run.disturbances
    assert run.has_momentum
    np.testing.assert_allclose(momentum.times, STARTS, atol=1e-9)
    assert not momentum.values[:3].any()
    np.testing.assert_allclose(momentum.values[3:], np.tile([0.075, 0.15, 0.0], (4, 1)))
    np.testing.assert_allclose(run.pushes.times, [1.0], atol=1e-9)
    np.testing.assert_allclose(run.pushes.values, [[0.5, -0.25]])
    assert disturbances.at(-0.1, UNDISTURBED) is UNDISTURBED
    assert not disturbances.at(0.6).as_array().any()
    disturbance, robot = disturbances.at(1.6), RobotParameters()
    slope, offset = slope_torque(robot, np.radians(0.5), np.pi / 2), np.full(3, 1e-3)
    np.testing.assert_allclose(disturbance.slope, slope, atol=1e-9)
    imbalance = imbalance_of_offset(robot, offset)
    np.testing.assert_allclose(disturbance.imbalance, imbalance, rtol=1e-9)
    assert momentum.at(-0.1) is None
    assert momentum.at(1.6).tolist() == momentum.at(99.0).tolist() == [0.075, 0.15, 0.0]


@pytest.mark.parametrize(
    ("missing", "note"),
    [
        ("/joint_states", "/joint_states is missing; no rotor speeds and torques"),
        ("/controller/status", "no status of the controller reports a solve; no solve times"),
        ("/rotor_trajectory", "/rotor_trajectory is missing; no plans"),
        ("/controller/active_goal", "active_goal is missing; goal_pose is used instead"),
    ],
)
def test_every_topic_but_the_poses_may_be_missing(read, missing, note) -> None:
    run = read(without(run_messages(), missing))
    assert run.notes == (note,)
    assert np.isfinite(figures(run)["settle_time_s"])


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_invalid_messages_and_numbers_of_no_robot_are_ignored(read) -> None:
    def turn(message) -> None:
        message.pose.orientation.w = 0.3

    def name(message) -> None:
        message.joint_names = ["hip", "knee"]

    def throw(message) -> None:
        message.pose.position.x = 1e300

    def race(message) -> None:
        message.velocity[:], message.effort[:] = 1e308, float("inf")

    def think(message) -> None:
        for pair in (pair for pair in message.values if pair.key not in ("plan", "time_s")):
            pair.value = "-1e308"

    entries = list(run_messages())
    first = {entry[0]: entry for entry in reversed(entries)}
    broken = [
        changed(first[topic], edit=edit) for topic, edit in (
            ("/controller/active_goal", turn), ("/rotor_trajectory", name), ("/pose", throw),
            ("/controller/status", think),
        )
    ]
    entries = [changed(e, edit=race) if e is first["/joint_states"] else e for e in entries]
    lures = ("\x1b]0;mine\x07", "\n[FATAL] all is lost ", 1000 * "x")  # are no names of topics
    lures = [(f"/{lure}/active_goal", *entries[0][1:]) for lure in lures]
    run = read([*entries, *broken, *lures])
    assert len(run.goals) == 1 and len(run.plans) == len(run.solves.times) == 7
    assert len(run.times) == 301 and np.isnan(run.rotor_speeds.values[0]).all()
    assert run.notes == (
        "/pose: 1 invalid poses were ignored",
        "/controller/active_goal: 1 invalid goals were ignored",
        "/rotor_trajectory: 1 invalid trajectories were ignored",
    )
    figures(run)


@pytest.mark.parametrize("order", [-1, 1], ids=["before", "behind"])
@pytest.mark.parametrize("shift", [0, STEP // 3])
def test_speeds_are_those_of_messages_that_have_velocities(read, whole, order, shift) -> None:
    """Another publisher of joint states has angles alone, for the display of the robot."""
    def stand(message) -> None:
        message.velocity = message.effort = np.empty(0)

    entries = list(run_messages())
    angles = [changed(entry, stamp=entry[2] + shift, edit=stand) for entry in entries
              if entry[0] == "/joint_states"]
    run = read(in_order(*(angles if order < 0 else ()), *entries, *(angles if order > 0 else ())))
    assert run.rotor_speeds.values.tolist() == whole.rotor_speeds.values.tolist()
    assert run.rotor_speeds.times.tolist() == whole.rotor_speeds.times.tolist()
    assert run.notes == ("/joint_states: 301 of 602 messages have no velocities",)
    alone = read([*without(entries, "/joint_states"), *angles])
    assert np.isnan(alone.rotor_speeds.values).all()
    assert alone.notes == ("/joint_states: 301 of 301 messages have no velocities",)


@pytest.mark.parametrize("log", [2**64 - 1, 2**63 - 1, 2**62])
def test_messages_with_log_times_that_no_recorder_has_are_invalid(tmp_path, read, log) -> None:
    entries = [e for e in run_messages() if e[0] == "/pose"]
    late = changed(entries[100], log=log)
    run = read([*entries, late])
    assert len(run.times) == 301
    assert run.notes[0] == "1 messages of type geometry_msgs/msg/PoseStamped are invalid"


def test_counts_of_contacts_that_are_no_numbers_are_ignored(read) -> None:
    counts = [diagnostics(START + i * STEP, "simulator: commands", wall_touched=count)
              for i, count in enumerate(("many", "1", "nan", "1e300", "2"))]
    run = read(in_order(*run_messages(), *counts))
    assert run.contacts.times == pytest.approx([0.01, 0.04])


def test_run_to_each_goal_has_what_belongs_to_it(read) -> None:
    entries = without(run_messages(), "active_goal")
    run = read(in_order(goal_at(5.0, 0.0), goal_at(0.0, 1.0), *entries))
    first, last = run.to_goal(1), run.to_goal(2)
    np.testing.assert_allclose(first.times, 0.01 * np.arange(100), atol=1e-9)
    np.testing.assert_allclose(last.times, 0.01 * np.arange(201), atol=1e-9)
    np.testing.assert_allclose(first.solves.times, [0.0, 0.5], atol=1e-9)
    np.testing.assert_allclose(last.solves.times, 0.5 * np.arange(5), atol=1e-9)
    assert last.plans.times == pytest.approx(0.5 * np.arange(5))
    assert len(first.rotor_speeds) == 100 and len(first.goals) == len(last.goals) == 1
    assert (first.name, last.name) == (f"{run.name}, goal 1", f"{run.name}, goal 2")
    assert run.metrics() == last.metrics() != first.metrics()
    assert first.goal[0] == 5.0 and last.goal[0] == 0.0


TILT = [np.cos(0.3), np.sin(0.3), 0.0, 0.0]


def given_in_turn(
    *kinds: str, same_pose: bool = False, turn: Sequence[float] = TILT
) -> list[Entry]:
    """Return poses that are at x = 0, 1, 2 m for a second each, with goals there.

    The goals are upright, unlike the sphere; their kinds are in the statuses. Those of kind ""
    have none. With the same pose for all goals, the sphere stays there.
    """
    poses = [
        ("/pose", POSE, stamp, pose(stamp, (x, 0.0, *turn)))
        for i in range(100 * len(kinds) + 1)
        for stamp, x in [(START + i * STEP, 0.0 if same_pose else min(i // 100, len(kinds) - 1))]
    ]
    goals = [goal_at(0.0 if same_pose else i, i) for i in range(len(kinds))]
    told = [demand(goal, kind) for goal, kind in zip(goals, kinds, strict=True) if kind]
    return in_order(*goals, *told, *poses)


NOT_ASKED, TILTED = (Orientation.ANY, True, np.nan), (Orientation.FULL, False, 0.6)


@pytest.mark.parametrize(
    ("kinds", "options", "judged"),
    [
        (("any", "any_heading", "full"), {},
         [NOT_ASKED, (Orientation.ANY_HEADING, False, 0.6), TILTED]),
        (("any_heading",), {"turn": [np.cos(0.3), 0.0, 0.0, np.sin(0.3)]},
         [(Orientation.ANY_HEADING, True, 0.0)]),
        (("",), {}, [TILTED]),
        (("upside down",), {}, [TILTED]),
        # A pose that is given again for its position alone is another goal.
        (("full", "any", "any"), {"same_pose": True}, [TILTED, NOT_ASKED]),
    ],
    ids=["each kind", "heading alone", "none told", "unknown", "same pose"],
)
def test_errors_are_those_to_what_the_goals_demand(read, kinds, options, judged) -> None:
    run = read(given_in_turn(*kinds, **options))
    assert run.goals.times == pytest.approx(np.arange(len(judged)), abs=1e-9)
    for number, (orientation, settled, error) in enumerate(judged, start=1):
        part = run.to_goal(number)
        metrics = part.metrics()
        goal = run.goals.values[number - 1]
        assert goal is run.goals.at(number - 0.5)
        assert (goal.orientation, metrics.settled) == (orientation, settled)
        assert metrics.final_position_error_m == 0.0
        assert metrics.final_orientation_error_rad == pytest.approx(error, abs=1e-9, nan_ok=True)
        if settled:  # the nearest pose that the goal allows is the last one
            np.testing.assert_allclose(part.goal, part.states[-1], atol=1e-12)
        if orientation is Orientation.ANY:
            assert metrics.settle_time_s == metrics.final_error == 0.0
            first = run.goal_errors[100 * (number - 1) : 100 * number]
            assert np.all(first[:, :2] == 0.0) and np.isnan(first[:, 2]).all()


def test_longest_run_is_used_after_a_restart_of_the_simulator(tmp_path) -> None:
    whole = list(run_messages())
    short = [entry for entry in whole if entry[2] < 7_000_000_000]
    logged = on_the_system_clock([*short, *whole, *short])
    run = read_run(write_rosbag2(tmp_path / "bag", logged))
    expected = read_run(write_rosbag2(tmp_path / "whole", on_the_system_clock(whole)))
    assert run.metrics() == expected.metrics()
    for name in ("times", "states", "goal_errors"):
        np.testing.assert_array_equal(getattr(run, name), getattr(expected, name))
    assert len(run.plans) == len(expected.plans) == 7 and len(run.solves.times) == 7
    assert run.notes[0].startswith("/pose: time goes back, so the bag holds several runs")


def hips(message) -> None:
    message.name = ["hip", "knee"]


@pytest.mark.parametrize(
    ("entries", "reason"),
    [
        ([e for e in run_messages() if e[0] == "/rotor_trajectory"],
         "another robot; has: /rotor_trajectory"),
        ([changed(e, edit=hips) if e[0] == "/joint_states" else e for e in run_messages()],
         r"names \['hip', 'knee'\].*another robot"),
        ([], "is empty: it has no topic at all"),
    ],
)
def test_bag_of_another_robot_is_refused(read, entries, reason) -> None:
    with pytest.raises(BagError, match=reason):
        read(entries)


@pytest.mark.parametrize(
    ("goals", "kept", "notes"),
    [
        # After the last pose; replaced before the next pose; sent again.
        ([(0.0, 0.0), (7.0, 3.5)], [0.0], ["goal at 3.5 s, poses from 0 to 3 s: ignored"]),
        ([(0.0, 0.0), *((float(i), 1.001 + 1e-3 * i) for i in range(1, 5))], [0.0, 4.0],
         ["3 goals were replaced before the next pose: ignored"]),
        ([(0.0, 0.5), (0.0, 1.5), (0.0, 2.5)], [0.0], []),
    ],
)
def test_goals_that_were_not_in_force_are_ignored(read, goals, kept, notes) -> None:
    given = [goal_at(x, time) for x, time in goals]
    run = read(in_order(*given, *without(run_messages(), "active_goal")))
    assert [goal.pose[0] for goal in run.goals.values] == pytest.approx(kept)
    assert run.goals.times[0] == pytest.approx(goals[0][1], abs=1e-9)
    assert list(run.notes) == [f"/controller/active_goal: {note}" for note in notes]


def test_floor_is_in_force_from_its_time_until_it_is_free(read) -> None:
    entries = [*walled_messages(0.1)]

    def another(seconds: int, **info) -> Entry:
        edit = lambda message: vars(message.info).update(info)  # noqa: E731
        return changed(entries[0], log=seconds * 10**9, stamp=seconds * 10**9, edit=edit)

    free, fine = another(4, width=0, height=0), another(3, resolution=1e-30)
    invalid = [fine, *(another(3, resolution=it) for it in (1e30, 0.0, np.nan, -0.1)),
               another(3, width=2**31), another(3, width=39), another(3, height=0)]
    run = read(in_order(*entries, *invalid, free))
    assert (
        "/controller/floor: 8 invalid floors were ignored; map: given a resolution of 1e-30 m, "
        "expected a positive number, 0.0001 or more"
    ) in run.notes
    assert run.floors.at(-0.1) is None and run.floors.at(3.0) is None
    grid = run.floors.at(2.5)
    assert grid.occupied.shape == (40, 40) and grid.origin == pytest.approx((2, -2, np.pi / 2))
    at_the_wall = grid.local(np.array([1.25, 0.05])).astype(int)
    assert grid.occupied[at_the_wall[1], at_the_wall[0]] and grid.occupied.sum() == 40
    assert [run.planned_clearances.at(t) for t in (1.0, 3.9)] == [0.25, 0.25]
    # The front of the sphere is at 0.3 m at the start, at 0.9 m after 3 s, the wall at 1.2 m.
    np.testing.assert_allclose(run.clearances[:150], 0.9 - 0.2 * run.times[:150], atol=1e-6)
    assert np.isnan(run.clearances[run.times >= 3.0]).all()


def test_floor_of_a_goal_is_the_one_that_was_in_force_then(read) -> None:
    goals = [changed(goal_at(x, 0.0), stamp=log, log=log)
             for x, log in ((1.0, 2 * 10**9), (2.0, 4 * 10**9))]
    run = read(in_order(*walled_messages(0.1), *goals))
    second = run.to_goal(2)
    assert second.floors.at(0.0) is run.floors.at(0.0) is not None
    assert np.nanmin(second.clearances) == pytest.approx(0.1, abs=1e-6)
    assert second.clearances[0] == pytest.approx(0.9 - 0.2 * 3.0, abs=1e-6)
    assert not second.planned_clearances and run.to_goal(1).planned_clearances.at(0.5) == 0.25
