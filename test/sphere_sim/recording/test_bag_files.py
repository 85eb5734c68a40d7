# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Missing, truncated, damaged and foreign files of a bag are named as such."""

import re
import shutil
import sqlite3
from contextlib import closing

import pytest
from mcap.reader import make_reader

from sphere_sim.recording.errors import BagError
from sphere_sim.recording.run_reader import read_run


def truncate(file, share: float) -> None:
    data = file.read_bytes()
    file.write_bytes(data[: int(share * len(data))])


def test_missing_file_of_a_split_bag_is_noted(rosbag2, messages) -> None:
    bag = rosbag2(messages(), "mcap", parts=3)
    (bag / "mine_1.mcap").unlink()
    run = read_run(bag)
    assert run.notes == ("mine_1.mcap is missing, though metadata.yaml lists it",)
    assert 190 < len(run.times) < 210 and run.metrics() is not None


def test_file_that_metadata_does_not_list_is_ignored(rosbag2, messages) -> None:
    bag, other = rosbag2(messages(), "sqlite3"), rosbag2(messages("/b"), "sqlite3", name="other")
    (other / "other_0.db3").rename(bag / "other_0.db3")
    assert read_run(bag).notes == ("other_0.db3 was ignored: metadata.yaml does not list it",)


@pytest.mark.parametrize("kind", ["mcap", "sqlite3"])
def test_files_of_several_bags_are_refused(rosbag2, messages, kind) -> None:
    bag, other = rosbag2(messages(), kind), rosbag2(messages(), kind, name="other")
    for file in other.iterdir():
        file.rename(bag / file.name)
    (bag / "metadata.yaml").unlink()
    with pytest.raises(BagError, match=r"several bags \(mine.*, other.*\).*give one of the files"):
        read_run(bag)
    assert "mine_1" in " ".join(read_run(next(bag.glob("mine_0.*"))).notes)


def test_files_recorded_at_the_same_time_are_refused(rosbag2, messages) -> None:
    bag = rosbag2(messages(), "mcap", parts=1)
    other = rosbag2(messages(), "mcap", parts=1, name="other")
    (other / "other_0.mcap").rename(bag / "mine_1.mcap")
    (bag / "metadata.yaml").unlink()
    with pytest.raises(BagError, match=r"mine_1.mcap and the file before it were recorded at the"):
        read_run(bag)


def test_ten_and_more_files_are_read_in_their_order(rosbag2, messages) -> None:
    bag = rosbag2(messages(), "mcap", parts=12)
    (bag / "metadata.yaml").unlink()
    assert len(read_run(bag).times) == 301


@pytest.mark.parametrize("described", [True, False])
def test_decompressed_copy_is_not_read_twice(rosbag2, messages, described) -> None:
    bag, plain = rosbag2(messages(), "mcap", "file"), rosbag2(messages(), "mcap", name="plain")
    (plain / "plain_0.mcap").rename(bag / "mine_0.mcap")
    if not described:
        (bag / "metadata.yaml").unlink()
    assert len(read_run(bag).plans) == 7


def test_unknown_compression_is_refused(rosbag2, messages) -> None:
    bag = rosbag2(messages(), "mcap", "message")
    text = (bag / "metadata.yaml").read_text().replace("format: zstd", "format: lz4")
    (bag / "metadata.yaml").write_text(text)
    with pytest.raises(BagError, match="is compressed with 'lz4', expected 'zstd' or nothing"):
        read_run(bag)


def test_damaged_metadata_is_ignored(rosbag2, messages) -> None:
    bag = rosbag2(messages(), "mcap")
    truncate(bag / "metadata.yaml", 0.02)
    run = read_run(bag)
    assert len(run.times) == 301 and "metadata.yaml is ignored, it cannot be" in run.notes[0]


@pytest.mark.parametrize("compression", ["", "file", "message"])
@pytest.mark.parametrize("kind", ["mcap", "sqlite3"])
def test_truncated_file_is_read_up_to_its_end(rosbag2, messages, kind, compression) -> None:
    # In a larger database, pages near the end are needed to find the others.
    bag = rosbag2(list(messages()) * (30 if kind == "mcap" else 5), kind, compression, parts=1)
    file = next(file for file in bag.iterdir() if file.name.startswith("mine_0"))
    truncate(file, 0.6)
    run = read_run(bag)
    assert len(run.times) > 100 and run.metrics() is not None
    assert run.notes[0].startswith(f"{file.name} is truncated; ")


@pytest.mark.parametrize(("kind", "share"), [("mcap", 0.1), ("sqlite3", 0.3)])
def test_file_truncated_before_the_first_pose_is_not_called_empty(
    rosbag2, messages, kind, share
) -> None:
    entries = list(messages())
    joints = [entry for entry in entries if entry[0] == "/joint_states"] * 20
    poses = [entry for entry in entries if entry[0] == "/pose"]
    bag = rosbag2([*joints, *poses], kind, parts=1)
    truncate(next(file for file in bag.iterdir() if file.name.startswith("mine_0")), share)
    with pytest.raises(BagError, match=r"can be read of it: .*is truncated") as it:
        read_run(bag)
    assert "another robot" not in str(it.value) and "is empty:" not in str(it.value)


@pytest.mark.parametrize("kind", ["mcap", "sqlite3"])
def test_file_of_any_length_is_called_truncated(rosbag2, messages, kind) -> None:
    bag = rosbag2(messages(), kind, parts=1)
    file = next(file for file in bag.iterdir() if file.name.startswith("mine_0"))
    whole = file.read_bytes()
    lengths = {*range(1, 130, 16), *(len(whole) * k // 40 for k in range(1, 40)), len(whole) - 1}
    for length in sorted(lengths):
        file.write_bytes(whole[:length])
        try:
            text = "; ".join(read_run(bag).notes)
        except BagError as error:
            text = str(error)
        assert "is truncated" in text, (length, text)
        assert not re.search("another robot|is empty|is damaged", text), (length, text)


def test_error_on_a_folder_of_bags_lists_them(rosbag2, messages) -> None:
    bag = rosbag2(messages(), "mcap", parts=1)
    with pytest.raises(BagError, match=f"holds no .mcap or .db3 file; there is one in {bag.name}"):
        read_run(bag.parent)


def test_folder_in_place_of_a_file_is_refused(rosbag2, messages) -> None:
    bag = rosbag2(messages(), "sqlite3")
    (bag / "mine_1.db3").unlink()
    (bag / "mine_1.db3").mkdir()
    with pytest.raises(BagError, match=r"mine_1.db3 cannot be read: Is a directory"):
        read_run(bag)


def test_run_name_lacks_the_suffix_of_compression(rosbag2, messages) -> None:
    assert read_run(rosbag2(messages(), "mcap", "file") / "mine_0.mcap.zstd").name == "mine_0"


def test_damaged_chunk_is_not_called_truncation(make_bag, messages) -> None:
    file = next(make_bag(list(messages()) * 30).glob("*.mcap"))
    with file.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    chunk, data = summary.chunk_indexes[1], bytearray(file.read_bytes())
    data[chunk.chunk_start_offset + chunk.chunk_length // 2] ^= 0xFF
    file.write_bytes(data)
    note = read_run(file.parent).notes[0]
    assert f"{file.name} is damaged (" in note and "messages before that were read" in note


@pytest.mark.parametrize("name", ["thing.mcap", "thing.db3"])
@pytest.mark.parametrize(
    ("content", "reason"),
    [(b"", "has 0 bytes"), (b"rubbish" * 100, "is damaged"), (b"S", ""), (b"\x89MCAP0\r\n", ""),
     (b"SQLite format 3\0", "")],
)
def test_file_without_content_is_refused(tmp_path, name, content, reason) -> None:
    file = tmp_path / name
    file.write_bytes(content)
    begins = {"thing.mcap": b"\x89MCAP0\r\n", "thing.db3": b"SQLite format 3\0"}[name]
    reason = reason or ("is truncated" if begins.startswith(content) else "is damaged")
    with pytest.raises(BagError, match=f"nothing can be read of it: {name} {reason}"):
        read_run(file)


def test_write_ahead_log_of_a_killed_recorder_is_read(rosbag2, messages) -> None:
    bag = rosbag2(messages(), "sqlite3", parts=1)
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


def test_names_with_special_characters_of_urls_are_read(rosbag2, messages) -> None:
    bag = rosbag2(messages(), "sqlite3")
    assert len(read_run(bag.rename(bag.parent / "50% of it?#")).times) == 301


@pytest.mark.parametrize("kind", ["mcap", "sqlite3"])
def test_parameters_are_read_without_metadata(rosbag2, messages, kind) -> None:
    custom = {"parameters:/controller": '{"robot.shell_mass": 1.5}'}
    bag = rosbag2(messages(), kind, custom=custom)
    assert read_run(bag).robot.shell_mass == 1.5
    (bag / "metadata.yaml").unlink()
    assert read_run(bag).robot.shell_mass == 1.5
