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
    goal_at,
    in_order,
    joints,
    pose,
    rolling_messages,
    run_messages,
    status,
    write_own,
    write_rosbag2,
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
def test_remapped_topics_of_a_run_are_found(tmp_path, names) -> None:
    expected = read_run(write_own(tmp_path / "own", run_messages()))
    run = read_run(write_own(tmp_path / "bag", renamed(run_messages(), **names)))
    assert run.metrics() == expected.metrics() and len(run.plans) == len(expected.plans)
    assert list(run.notes) == [f"/{name} is missing; that of this robot is {topic}"
                               for name, topic in names.items()]


def test_names_without_a_leading_slash_are_the_same(tmp_path) -> None:
    entries = [(entry[0].lstrip("/"), *entry[1:]) for entry in run_messages()]
    run = read_run(write_rosbag2(tmp_path / "bag", entries))
    assert run.metrics() == read_run(write_own(tmp_path / "own", run_messages())).metrics()
    assert run.notes == () and len(run.plans) == 7
    assert len(read_run(tmp_path / "bag", "/", pose_topic="pose").times) == 301


@pytest.mark.parametrize(
    "others",
    [stream("/vrpn_mocap/table/pose", STANDING), stream("/target", MOVING),
     stream("/camera/pose", MOVING, "camera"), stream("/clicked", MOVING[:5])],
    ids=["standing", "moving goal", "another frame", "a few poses"],
)
def test_poses_are_those_of_a_sphere_that_rolls(tmp_path, others) -> None:
    bag = write_own(tmp_path / "bag", in_order(*rolling(CAPTURED), *others))
    run = read_run(bag)
    assert run.states[-1, 0] == pytest.approx(0.8) and len(run.times) == 201
    assert run.notes[0] == f"/pose is missing; that of this robot is {CAPTURED}"


def test_several_topics_that_roll_are_told_and_one_is_chosen(tmp_path) -> None:
    second = renamed(rolling_messages(2.0), pose="/vrpn_mocap/filtered")
    bag = write_own(tmp_path / "bag", in_order(*rolling(CAPTURED), *second))
    with pytest.raises(BagError, match=(
        rf"in namespace /, choose one with --pose-topic: {CAPTURED}, /vrpn_mocap/filtered$"
    )):
        read_run(bag)
    assert len(read_run(bag, pose_topic=CAPTURED).times) == 201
    assert len(read_run(bag, pose_topic="vrpn_mocap/filtered").times) == 101
    with pytest.raises(BagError, match=rf"/odd: expected .*PoseStamped.*one of {CAPTURED}"):
        read_run(bag, pose_topic="/odd")


def test_topic_that_the_run_states_has_the_poses(tmp_path) -> None:
    entries = in_order(*rolling(CAPTURED), *stream("/pose", MOVING))
    assert len(read_run(write_own(tmp_path / "named", entries)).times) == 150
    custom = {"topics:/": json.dumps({"pose": CAPTURED})}
    assert len(read_run(write_rosbag2(tmp_path / "a", entries, custom=custom)).times) == 201
    says = status(time_s=1.0, pose_topic=CAPTURED)
    said = ("/controller/status", "diagnostic_msgs/msg/DiagnosticStatus", S, says)
    run = read_run(write_rosbag2(tmp_path / "b", in_order(said, *entries)))
    assert len(run.times) == 201 and not any("missing; that" in note for note in run.notes)
    # What is damaged, or names a topic that the bag does not have, is no statement.
    for i, text in enumerate(("[3]", "{", '{"pose": 3}', '{"pose": "/elsewhere"}')):
        bag = write_rosbag2(tmp_path / f"c{i}", entries, custom={"topics:/": text})
        assert len(read_run(bag).times) == 150


def test_poses_alone_need_their_name(tmp_path) -> None:
    bag = write_own(tmp_path / "bag", renamed(rolling_messages(), pose="/optitrack/ball"))
    with pytest.raises(BagError, match=r"no topic 'pose'.*--pose-topic takes one of /optitrack"):
        read_run(bag)
    assert len(read_run(bag, pose_topic="/optitrack/ball").times) == 201


def test_poses_of_another_robot_are_not_taken(tmp_path) -> None:
    left = [it for it in run_messages("/left") if not it[0].endswith("/pose")]
    bag = write_own(tmp_path / "bag", in_order(*left, *run_messages("/right")))
    with pytest.raises(BagError, match=r"several robots.*/left, /right"):
        read_run(bag)
    assert len(read_run(bag, "right").times) == 301
    assert read_run(bag, pose_topic="/right/pose").notes == ()
    with pytest.raises(BagError, match=r"no topic 'pose' of type .* in namespace /left"):
        read_run(bag, "left")
    with pytest.raises(BagError, match="no robot in namespace 'up'"):
        read_run(bag, "up")


def test_messages_of_another_type_on_the_topic_are_ignored(tmp_path) -> None:
    kind = "diagnostic_msgs/msg/DiagnosticStatus"
    other = [("pose", kind, 6 * S, status(time_s=1.0)), ("pose/", kind, 4 * S, status())]
    run = read_run(write_rosbag2(tmp_path / "bag", in_order(*run_messages(), *other)))
    assert len(run.times) == 301 and run.notes == ()
    bag = write_own(tmp_path / "other", other[:1])
    with pytest.raises(BagError, match=r"no topic 'pose' .*; has: /pose \(DiagnosticStatus\)"):
        read_run(bag)
