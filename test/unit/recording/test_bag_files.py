# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Missing, truncated, damaged and foreign files of a bag are named as such."""

import shutil
import sqlite3
from contextlib import closing

import pytest
from mcap.reader import make_reader
from mcap.writer import Writer as McapWriter
from recorded_bags import run_messages, write_own, write_rosbag2

from sphere_sim.recording.bag_files import BagError
from sphere_sim.recording.run_reader import read_run


def truncate(file, share: float) -> None:
    data = file.read_bytes()
    file.write_bytes(data[: int(share * len(data))])


def test_files_are_read_as_metadata_lists_them(tmp_path) -> None:
    bag = write_rosbag2(tmp_path / "mine", run_messages(), "sqlite3", parts=3)
    (bag / "mine_1.db3").rename(bag / "other_0.db3")
    run = read_run(bag)
    assert run.notes == (
        "mine_1.db3 is missing, though metadata.yaml lists it",
        "other_0.db3 was ignored: metadata.yaml does not list it",
    )
    assert 190 < len(run.times) < 210 and run.metrics() is not None


def test_metadata_that_counts_other_messages_than_the_files_have_is_told(tmp_path) -> None:
    bag = write_own(tmp_path / "bag", run_messages())
    metadata = bag / "metadata.yaml"
    text = metadata.read_text()
    count = sum(1 for _ in run_messages())
    metadata.write_text(text.replace(f"message_count: {count}", "message_count: 17"))
    run = read_run(bag)
    assert run.notes == (
        f"metadata.yaml counts 17 messages, the storage has {count}: all of these are read",
    )
    assert len(run.times) == 301


def test_files_of_several_bags_are_refused_and_one_is_read(tmp_path) -> None:
    # Some of these characters have a meaning in the addresses of databases.
    bag = write_rosbag2(tmp_path / "mine", run_messages(), "sqlite3", parts=12)
    bag = bag.rename(tmp_path / "50% of it?#")
    with pytest.raises(BagError, match=r"holds no .mcap or .db3 file; there is one in 50% of it"):
        read_run(tmp_path)
    (bag / "metadata.yaml").unlink()
    assert len(read_run(bag).times) == 301, "ten and more files are in order"
    one = (bag / "mine_1.db3").rename(bag / "other_1.db3")
    with pytest.raises(BagError, match=r"several bags \(mine.*, other.*\).*give one of the files"):
        read_run(bag)
    run = read_run(one)
    assert run.name == "other_1" and 1 < len(run.times) < 301
    assert "only mine_3.db3 was read, not mine_0.db3, " in read_run(bag / "mine_3.db3").notes[0]


def test_unknown_compression_is_refused_and_damaged_metadata_ignored(tmp_path) -> None:
    bag = write_rosbag2(tmp_path / "mine", run_messages(), "mcap", "message")
    metadata = bag / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace("format: zstd", "format: lz4"))
    with pytest.raises(BagError, match="is compressed with 'lz4', expected 'zstd' or nothing"):
        read_run(bag)
    truncate(metadata, 0.02)
    run = read_run(bag)
    assert len(run.times) == 301 and "metadata.yaml is ignored, it cannot be" in run.notes[0]


@pytest.mark.parametrize(
    ("kind", "compression"), [("mcap", "file"), ("sqlite3", ""), ("sqlite3", "message")]
)
def test_truncated_file_is_read_up_to_its_end(tmp_path, kind, compression) -> None:
    # In a larger database, pages near the end are needed to find the others.
    entries = list(run_messages()) * (30 if kind == "mcap" else 5)
    bag = write_rosbag2(tmp_path / "mine", entries, kind, compression)
    file = next(file for file in bag.iterdir() if file.name.startswith("mine_0"))
    truncate(file, 0.6)
    run = read_run(bag)
    assert len(run.times) > 100 and run.metrics() is not None
    assert run.notes[0].startswith(f"{file.name} is truncated or damaged (")
    assert "messages before that were read" in run.notes[0]
    truncate(file, 0.01)
    with pytest.raises(BagError, match="is truncated or damaged"):
        read_run(bag)


def test_damaged_chunk_ends_the_reading(tmp_path) -> None:
    bag = write_own(tmp_path / "bag", list(run_messages()) * 30)
    file = next(bag.glob("*.mcap"))
    with file.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    chunk, data = summary.chunk_indexes[1], bytearray(file.read_bytes())
    data[chunk.chunk_start_offset + chunk.chunk_length // 2] ^= 0xFF
    file.write_bytes(data)
    note = read_run(bag).notes[0]
    assert "damaged (" in note and "messages before that were read" in note


@pytest.mark.parametrize("name", ["thing.mcap", "thing.db3"])
def test_path_that_is_no_bag_is_refused(tmp_path, name) -> None:
    file = tmp_path / name
    with pytest.raises(BagError, match="no such file or folder"):
        read_run(file)
    for content, reason in ((b"", "has 0 bytes"), (b"rubbish" * 100, "is truncated or damaged")):
        file.write_bytes(content)
        with pytest.raises(BagError, match=f"nothing can be read of it: {name} {reason}"):
            read_run(file)
    with pytest.raises(BagError, match=r"expected a folder, a .mcap or a .db3 file"):
        read_run(file.rename(tmp_path / "thing.txt"))
    file.mkdir()
    with pytest.raises(BagError, match=r"holds no .mcap or .db3 file"):
        read_run(file)


def test_write_ahead_log_of_a_killed_recorder_is_read(tmp_path) -> None:
    bag = write_rosbag2(tmp_path / "mine", run_messages(), "sqlite3")
    with closing(sqlite3.connect(bag / "mine_0.db3")) as writer:
        rows = writer.execute("SELECT topic_id, timestamp, data FROM messages").fetchall()
        writer.execute("DELETE FROM messages WHERE id > 100")
        writer.commit()
        writer.execute("PRAGMA journal_mode=WAL")
        writer.executemany(
            "INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)", rows[100:]
        )
        writer.commit()
        killed = bag.parent / "killed"
        shutil.copytree(bag, killed)
    assert (killed / "mine_0.db3-wal").exists()
    assert len(read_run(killed).times) == 301


CONVERT = "'rosbags-convert --src FILE.bag --dst FOLDER' converts a bag of ROS 1"


@pytest.mark.parametrize(
    ("encoding", "typed", "told"),
    [
        ("ros1", True, f"than by ROS 2 \\(CDR\\): 2 in 'ros1'; {CONVERT}; has: "
         r"/controller/active_goal \(PoseStamped in ros1\), /pose \(PoseStamped in ros1\)$"),
        ("protobuf", True, r"2 in 'protobuf'; has: .*/pose \(PoseStamped in protobuf\)$"),
        ("json", False, r"2 in 'json'; has: .*/pose \(no type in json\)$"),
        ("cdr", False, r"a bag of another robot; has: .*/pose \(no type\)$"),
    ],
)
def test_encodings_that_are_not_those_of_ros_2_are_named(tmp_path, encoding, typed, told) -> None:
    file = tmp_path / "a.mcap"
    with file.open("wb") as stream:
        writer = McapWriter(stream)
        writer.start()
        number = 0
        if typed:
            number = writer.register_schema("geometry_msgs/PoseStamped", "ros1msg", b"")
        for topic in ("/pose", "/controller/active_goal"):
            channel = writer.register_channel(topic, encoding, number)
            writer.add_message(channel, 1, b"{}", 1)
        writer.finish()
    with pytest.raises(BagError, match=told):
        read_run(file)


def test_topics_in_another_encoding_are_named_beside_a_run(tmp_path) -> None:
    bag = write_rosbag2(tmp_path / "mine", run_messages(), "sqlite3")
    with closing(sqlite3.connect(bag / "mine_0.db3")) as database:
        change = "UPDATE topics SET serialization_format = 'json' WHERE name = '/joint_states'"
        database.execute(change)
        # As the first releases of ROS 2 wrote the types.
        database.execute("UPDATE topics SET type = replace(type, '/msg/', '/')")
        database.commit()
    run = read_run(bag)
    assert len(run.times) == 301
    assert run.notes == (
        "not read are topics encoded otherwise than by ROS 2 (CDR): 1 in 'json'",
        "/joint_states is missing; no rotor speeds and torques",
    )


@pytest.mark.parametrize(
    ("name", "begin", "told"),
    [
        ("a.bag", b"#ROSBAG V2.0\n", f"it is a recording of ROS 1; {CONVERT}; expected a folder"),
        ("a.mcap", b"#ROSBAG V2.0\n", f"a.mcap is a recording of ROS 1; {CONVERT}"),
        ("a.ulg", b"ULog\x01\x12\x35", r"it is a log of PX4 \(ULog\); expected"),
        ("a.mcap", b"version https://git-lfs.github.com/spec/v1\n", "is a pointer of Git LFS"),
        ("a.mcap", b"SQLite format 3\0", r"is a file whose name should end in \.db3"),
        ("a.db3", b"\x89MCAP0\r\n", r"is a file whose name should end in \.mcap"),
        ("a.mcap", b"\x28\xb5\x2f\xfd", r"is a file whose name should end in \.zstd"),
        ("a.mcap.zstd", b"\x89MCAP0\r\n", r"is a file whose name should end in \.mcap"),
        ("a.mcap", b"\x1f\x8b", "is compressed with gzip"),
        ("a.csv", b"time,x,y\n", "is not a bag: expected a folder"),
    ],
)
def test_recordings_of_other_formats_are_named(tmp_path, name, begin, told) -> None:
    file = tmp_path / name
    file.write_bytes(begin + bytes(100))
    with pytest.raises(BagError, match=told):
        read_run(file)
    if not name.endswith((".mcap", ".db3", ".zstd", ".csv")):
        with pytest.raises(BagError, match=f"holds no .mcap or .db3 file; {name} is a"):
            read_run(tmp_path)
