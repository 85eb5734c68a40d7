# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""What is missing, cut, damaged or of another bag is told as what it is."""

import re
import shutil
import sqlite3

import pytest
from mcap.reader import make_reader

from sphere_sim.recording.errors import BagError
from sphere_sim.recording.run_reader import read_run


def cut(file, share: float) -> None:
    data = file.read_bytes()
    file.write_bytes(data[: int(share * len(data))])


def test_a_missing_file_of_a_split_bag_is_told(rosbag2, messages) -> None:
    bag = rosbag2(messages(), "mcap", parts=3)
    (bag / "mine_1.mcap").unlink()
    run = read_run(bag)
    assert run.notes == ("mine_1.mcap is missing, though metadata.yaml names it",)
    assert 190 < len(run.times) < 210 and run.metrics() is not None


def test_a_file_that_metadata_does_not_name_is_left_out(rosbag2, messages) -> None:
    bag, other = rosbag2(messages(), "sqlite3"), rosbag2(messages("/b"), "sqlite3", name="other")
    (other / "other_0.db3").rename(bag / "other_0.db3")
    assert read_run(bag).notes == ("other_0.db3 was left out: metadata.yaml does not name it",)


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
def test_what_a_player_decompressed_is_not_read_twice(rosbag2, messages, described) -> None:
    bag, plain = rosbag2(messages(), "mcap", "file"), rosbag2(messages(), "mcap", name="plain")
    (plain / "plain_0.mcap").rename(bag / "mine_0.mcap")
    if not described:
        (bag / "metadata.yaml").unlink()
    assert len(read_run(bag).plans) == 7


def test_compression_that_is_not_known_is_told(rosbag2, messages) -> None:
    bag = rosbag2(messages(), "mcap", "message")
    text = (bag / "metadata.yaml").read_text().replace("format: zstd", "format: lz4")
    (bag / "metadata.yaml").write_text(text)
    with pytest.raises(BagError, match="is compressed with 'lz4', expected 'zstd' or nothing"):
        read_run(bag)


def test_damaged_metadata_is_left_out(rosbag2, messages) -> None:
    bag = rosbag2(messages(), "mcap")
    cut(bag / "metadata.yaml", 0.02)
    run = read_run(bag)
    assert len(run.times) == 301 and "metadata.yaml is left out, it cannot be" in run.notes[0]


@pytest.mark.parametrize("compression", ["", "file", "message"])
@pytest.mark.parametrize("kind", ["mcap", "sqlite3"])
def test_a_cut_file_is_read_as_far_as_it_goes(rosbag2, messages, kind, compression) -> None:
    # A larger database has pages near its end without which nothing is found in the others.
    bag = rosbag2(list(messages()) * (30 if kind == "mcap" else 5), kind, compression, parts=1)
    file = next(file for file in bag.iterdir() if file.name.startswith("mine_0"))
    cut(file, 0.6)
    run = read_run(bag)
    assert len(run.times) > 100 and run.metrics() is not None
    assert run.notes[0].startswith(f"{file.name} breaks off; ")


@pytest.mark.parametrize(("kind", "share"), [("mcap", 0.1), ("sqlite3", 0.3)])
def test_a_file_cut_before_the_first_pose_is_no_empty_bag(rosbag2, messages, kind, share) -> None:
    entries = list(messages())
    joints = [entry for entry in entries if entry[0] == "/joint_states"] * 20
    poses = [entry for entry in entries if entry[0] == "/pose"]
    bag = rosbag2([*joints, *poses], kind, parts=1)
    cut(next(file for file in bag.iterdir() if file.name.startswith("mine_0")), share)
    with pytest.raises(BagError, match=r"can be read of it: .*breaks off") as it:
        read_run(bag)
    assert "another robot" not in str(it.value) and "is empty:" not in str(it.value)


@pytest.mark.parametrize("kind", ["mcap", "sqlite3"])
def test_a_file_cut_anywhere_is_said_to_break_off(rosbag2, messages, kind) -> None:
    bag = rosbag2(messages(), kind, parts=1)
    file = next(file for file in bag.iterdir() if file.name.startswith("mine_0"))
    whole = file.read_bytes()
    lengths = {*range(1, 130, 16), *(len(whole) * k // 40 for k in range(1, 40)), len(whole) - 1}
    for length in sorted(lengths):
        file.write_bytes(whole[:length])
        try:
            told = "; ".join(read_run(bag).notes)
        except BagError as error:
            told = str(error)
        assert "breaks off" in told, (length, told)
        assert not re.search("another robot|is empty|is damaged", told), (length, told)


def test_a_folder_of_bags_says_which_there_are(rosbag2, messages) -> None:
    bag = rosbag2(messages(), "mcap", parts=1)
    with pytest.raises(BagError, match=f"holds no .mcap or .db3 file; there is one in {bag.name}"):
        read_run(bag.parent)


def test_a_folder_in_the_place_of_a_file_is_told(rosbag2, messages) -> None:
    bag = rosbag2(messages(), "sqlite3")
    (bag / "mine_1.db3").unlink()
    (bag / "mine_1.db3").mkdir()
    with pytest.raises(BagError, match=r"mine_1.db3 cannot be read: Is a directory"):
        read_run(bag)


def test_a_compressed_file_has_the_name_of_the_plain_one(rosbag2, messages) -> None:
    assert read_run(rosbag2(messages(), "mcap", "file") / "mine_0.mcap.zstd").name == "mine_0"


def test_a_damaged_chunk_is_not_taken_for_the_end(make_bag, messages) -> None:
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
def test_a_file_that_holds_nothing_is_told(tmp_path, name, content, reason) -> None:
    file = tmp_path / name
    file.write_bytes(content)
    begins = {"thing.mcap": b"\x89MCAP0\r\n", "thing.db3": b"SQLite format 3\0"}[name]
    reason = reason or ("breaks off" if begins.startswith(content) else "is damaged")
    with pytest.raises(BagError, match=f"nothing can be read of it: {name} {reason}"):
        read_run(file)


def test_what_a_killed_recorder_left_in_the_log_is_read(rosbag2, messages) -> None:
    bag = rosbag2(messages(), "sqlite3", parts=1)
    with sqlite3.connect(bag / "mine_0.db3") as writer:
        writer.execute("PRAGMA journal_mode=WAL")
        writer.execute("UPDATE messages SET timestamp = timestamp + 1")
        writer.commit()
        killed = bag.parent / "killed"
        shutil.copytree(bag, killed)
        assert (killed / "mine_0.db3-wal").stat().st_size > 0
    run, whole = read_run(killed), read_run(bag)
    assert len(run.times) == len(whole.times) == 301


def test_names_that_addresses_do_not_take_are_read(rosbag2, messages) -> None:
    bag = rosbag2(messages(), "sqlite3")
    assert len(read_run(bag.rename(bag.parent / "50% of it?#")).times) == 301


@pytest.mark.parametrize("kind", ["mcap", "sqlite3"])
def test_parameters_are_known_without_metadata(rosbag2, messages, kind) -> None:
    told = {"parameters:/controller": '{"robot.shell_mass": 1.5}'}
    bag = rosbag2(messages(), kind, custom=told)
    assert read_run(bag).robot.shell_mass == 1.5
    (bag / "metadata.yaml").unlink()
    assert read_run(bag).robot.shell_mass == 1.5
