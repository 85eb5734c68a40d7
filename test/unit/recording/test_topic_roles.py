# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Topics of a bag are found by their types and by what the run says, whatever their names."""

import json

import numpy as np
import pytest
from recorded_bags import (
    POSE,
    STEP,
    Entry,
    changed,
    estimated,
    goal_at,
    in_order,
    joints,
    pose,
    rolling_messages,
    run_messages,
    status,
    write_own,
)

from sphere_sim.recording.bag_files import BagError
from sphere_sim.recording.run_reader import read_run

S = 10**9
CAPTURED = "/vrpn_mocap/ball/pose"


def renamed(entries, **names: str) -> list[Entry]:
    """Return entries with other topics, by the last parts of their names."""
    return [(names.get(entry[0].rpartition("/")[2], entry[0]), *entry[1:]) for entry in entries]


def stream(topic: str, states, frame: str = "world") -> list[Entry]:
    """Return poses at 50 Hz from 1 s on."""
    def edit(message) -> None:
        message.header.frame_id = frame

    stamps = [S + 2 * STEP * i for i in range(len(states))]
    return [changed((topic, POSE, stamp, pose(stamp, state)), edit=edit)
            for stamp, state in zip(stamps, states, strict=True)]


def rolling(topic: str) -> list[Entry]:
    """Return the poses of a rolling sphere with its rotors and goal, as of a robot at /."""
    goal = changed(goal_at(0.8, 0.0), log=S, stamp=S)
    rotors = [("/joint_states", "sensor_msgs/msg/JointState", log, joints(log, (1.0, 2.0)))
              for log in range(S, 5 * S, S // 10)]
    return in_order(goal, *renamed(rolling_messages(), pose=topic), *rotors)


RNG = np.random.default_rng(3)
STANDING = np.tile([1.0, 2.0, 1.0, 0.0, 0.0, 0.0], (150, 1)) + np.hstack(
    (RNG.normal(0.0, 3e-4, (150, 2)), np.zeros((150, 4)))
)
"""A table seen by a capture system."""
MOVING = np.hstack((np.linspace(0.0, 1.0, 150)[:, None], np.zeros((150, 1)),
                    np.tile([1.0, 0.0, 0.0, 0.0], (150, 1))))
"""A goal that moves."""


@pytest.mark.parametrize(
    "names",
    [
        {"pose": CAPTURED},
        {"pose": "/optitrack/ball"},
        {"pose": CAPTURED, "joint_states": "/dynamixel/state", "rotor_trajectory": "/drives/cmd"},
    ],
)
def test_remapped_topics_of_a_run_are_found(read, whole, names) -> None:
    run = read(renamed(run_messages(), **names))
    assert run.metrics() == whole.metrics() and len(run.plans) == len(whole.plans)
    assert list(run.notes) == [f"/{name} is missing; that of this robot is {topic}"
                               for name, topic in names.items()]


@pytest.mark.parametrize(
    "others",
    [stream("/vrpn_mocap/table/pose", STANDING), stream("/target", MOVING),
     stream("/camera/pose", MOVING, "camera"), stream("/clicked", MOVING[:5])],
    ids=["standing", "moving goal", "another frame", "a few poses"],
)
def test_poses_are_those_of_a_sphere_that_rolls(read, others) -> None:
    run = read(in_order(*rolling(CAPTURED), *others))
    assert run.states[-1, 0] == pytest.approx(0.8) and len(run.times) == 201
    assert run.notes[0] == f"/pose is missing; that of this robot is {CAPTURED}"


def test_topic_that_the_run_states_has_the_poses(tmp_path, read) -> None:
    entries = in_order(*rolling(CAPTURED), *stream("/pose", MOVING))
    assert len(read(entries).times) == 150
    says = status(time_s=1.0, pose_topic=CAPTURED)
    said = ("/controller/status", "diagnostic_msgs/msg/DiagnosticStatus", S, says)
    run = read(in_order(said, *entries))
    assert len(run.times) == 201 and not any("missing; that" in note for note in run.notes)
    # What is damaged, or names a topic that the bag does not have, is no statement.
    stated = {json.dumps({"pose": CAPTURED}): 201}
    stated |= dict.fromkeys(("[3]", "{", '{"pose": 3}', '{"pose": "/elsewhere"}'), 150)
    for i, (text, count) in enumerate(stated.items()):
        bag = write_own(tmp_path / f"stated_{i}", entries, {"topics:/": text})
        assert len(read_run(bag).times) == count


@pytest.mark.parametrize("namespace", ["", "/left"])
def test_run_with_odometry_is_judged_on_the_true_poses(read, whole, namespace) -> None:
    run = read(estimated(run_messages(namespace), delay=3_000_000))
    assert run.metrics() == whole.metrics() and run.states.tolist() == whole.states.tolist()
    truth, own = f"{namespace}/ground_truth/pose", f"{namespace}/pose"
    assert run.notes == (f"{truth} has the true poses, on which the run is judged; {own} has "
                         "estimates",)
    assert run.estimates.times.tolist() == whole.times[::2].tolist(), "by their stamps"
    distances, headings = run.estimate_errors.values.T
    np.testing.assert_allclose(distances, 5e-3, rtol=1e-9)
    np.testing.assert_allclose(headings, 0.01 * (5.0 + run.estimates.times), rtol=1e-9)
    chosen = read(estimated(run_messages(namespace)), pose_topic=own)
    assert len(chosen.times) == 151 and not chosen.estimates, "as it was asked for"
    alone = read(it for it in estimated(run_messages(namespace)) if it[0] != own)
    assert alone.metrics() == whole.metrics() and not alone.estimates
    assert f"{own} is missing; no estimates of the poses" in alone.notes


LEFT = [it for it in run_messages("/left") if not it[0].endswith("/pose")]
KIND = "diagnostic_msgs/msg/DiagnosticStatus"


@pytest.mark.parametrize(
    ("entries", "choices", "refused"),
    [
        (
            in_order(*rolling(CAPTURED), *renamed(rolling_messages(2.0), pose="/vrpn_mocap/raw")),
            [(None, CAPTURED, 201), (None, "vrpn_mocap/raw", 101)],
            [(None, None, f"in namespace /, choose one with --pose-topic: {CAPTURED}, /vrpn_mocap"
              "/raw$"),
             (None, "/odd", f"/odd: expected .*PoseStamped.*one of {CAPTURED}")],
        ),
        (
            renamed(rolling_messages(), pose="/optitrack/ball"), [(None, "/optitrack/ball", 201)],
            [(None, None, "no topic 'pose'.*--pose-topic takes one of /optitrack")],
        ),
        # Without a leading slash names are the same.
        (
            [(entry[0].lstrip("/"), *entry[1:]) for entry in run_messages()],
            [(None, None, 301), ("/", "pose", 301)], [],
        ),
        (
            in_order(*LEFT, *run_messages("/right")),
            [("right", None, 301), (None, "/right/pose", 301)],
            [(None, None, "several robots.*/left, /right"),
             ("left", None, "no topic 'pose' of type .* in namespace /left"),
             ("up", None, "no robot in namespace 'up'")],
        ),
        (
            [("pose", KIND, 6 * S, status(time_s=1.0))], [],
            [(None, None, r"no topic 'pose' .*; has: /pose \(DiagnosticStatus\)")],
        ),
        (
            in_order(*run_messages(), ("pose", KIND, 6 * S, status(time_s=1.0)),
                     ("pose/", KIND, 4 * S, status())),
            [(None, None, 301)], [],
        ),
    ],
    ids=["two that roll", "poses alone", "names", "two robots", "another type",
         "another type as well"],
)
def test_poses_that_the_bag_leaves_open_are_to_be_chosen(
    tmp_path, entries, choices, refused
) -> None:
    bag = write_own(tmp_path / "bag", entries)
    for namespace, pose_topic, count in choices:
        assert len(read_run(bag, namespace, pose_topic=pose_topic).times) == count
    for namespace, pose_topic, told in refused:
        with pytest.raises(BagError, match=told):
            read_run(bag, namespace, pose_topic=pose_topic)
