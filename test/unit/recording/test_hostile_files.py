# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Files that are made to fill memory and disk of their reader, or not to end, are read in part."""

import os
import re
import shutil
import sqlite3
import struct
from contextlib import closing
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import Channel, Chunk, Header, Metadata, Schema
from recorded_bags import POSE, run_messages, write_own

from sphere_sim.recording import storage_reader
from sphere_sim.recording.bag_files import BagError
from sphere_sim.recording.run_reader import read_run

MB = 1 << 20
ZEROS = bytes(8 * MB)
UNKNOWN = struct.pack("<BQ", 0x99, 3 * MB) + ZEROS[: 3 * MB]
"""A record of an unknown kind."""
PACKED = zstandard.compress(ZEROS)
UNSIZED = zstandard.ZstdCompressor(write_content_size=False).compress(ZEROS)
LONGER = "it takes longer to read than any recording of its size"
ALIASES = "\n".join(
    f"a{i}: &a{i} [{', '.join([f'*a{i - 1}' if i else 'x'] * 10)}]" for i in range(10)
)
"""A value of 10 thousand million texts."""
HOSTILE_TEXTS = {
    "aliases": (f"{ALIASES}\nrosbag2_bagfile_information: {{relative_file_paths: [*a9]}}\n"
                "custom_data: {any: *a9}", "given an alias, expected each value written out"),
    # libyaml itself has a limit since its version 0.2.6, which it reaches while it looks ahead.
    "brackets": ("[" * 100_000, "expected at most 10 levels|exceeded maximum nesting depth"),
    "long": ("# " + "x" * 5 * MB, "expected at most 4194304 bytes"),
}
ENDLESS = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT "
TOPICS = (
    "CREATE TABLE topics(id INTEGER, name TEXT, type TEXT, serialization_format TEXT); "
    f"INSERT INTO topics VALUES (1, '/pose', '{POSE}', 'cdr');"
)
MESSAGES = "CREATE TABLE messages(topic_id INTEGER, timestamp INTEGER, data BLOB);"


@pytest.fixture(autouse=True)
def low_limits(monkeypatch) -> None:
    """Set limits that small files exceed."""
    monkeypatch.setattr(storage_reader, "_LEAST_CONTENT", 6 * MB)
    monkeypatch.setattr(storage_reader, "_LEAST_STEPS", 50_000)
    monkeypatch.setattr(storage_reader, "_MOST_RECORD", 4 * MB)
    monkeypatch.setattr(storage_reader, "_MOST_MEMORY", 32 * MB)


def records(*entries) -> bytes:
    builder = RecordBuilder()
    for entry in entries:
        entry.write(builder)
    return builder.end()


HEAD = b"\x89MCAP0\r\n" + records(Header(profile="ros2", library=""))
POSES = records(Schema(id=1, name=POSE, encoding="ros2msg", data=b""),
                Channel(id=1, topic="/pose", message_encoding="cdr", metadata={}, schema_id=1))


def chunk(data: bytes, compression: str) -> bytes:
    return records(Chunk(
        compression=compression, data=data, message_start_time=0, message_end_time=0,
        uncompressed_crc=0, uncompressed_size=len(ZEROS),
    ))


def message(data: bytes, log: int = 1) -> bytes:
    return struct.pack("<BQHIQQ", 5, 22 + len(data), 1, 0, log, log) + data


METADATA = records(
    Metadata(name="rosbag2", metadata={"serialized_metadata": HOSTILE_TEXTS["aliases"][0]})
)


def small_messages(number: int, data: bytes) -> bytes:
    return chunk(zstandard.compress(message(data) * number), "zstd")


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (chunk(PACKED, "zstd"), "a part of it unpacks to more than 4194304 bytes"),
        (chunk(UNSIZED, "zstd"), "a part of it unpacks to more than 4194304 bytes"),
        (chunk(lz4.frame.compress(ZEROS), "lz4"), "a part of it unpacks to more than"),
        (chunk(b"", "rar"), r"damaged \(compression rar"),
        (POSES + message(PACKED), "a part of it unpacks to more than 4194304 bytes"),
        (POSES + message(UNSIZED), "a part of it unpacks to more than 4194304 bytes"),
        (POSES + chunk(zstandard.compress(UNKNOWN), "zstd") * 3,
         "it unpacks to more than 6291456 bytes"),
        (POSES + small_messages(100_000, b"") * 10, LONGER),
        (POSES + message(ZEROS[: MB]) * 5, "its messages take more than 33554432 bytes"),
        (struct.pack("<BQ", 0x99, 1 << 40), "exceeds limit 4194304"),
        (b"", r"damaged \(EndOfFile"),
        (METADATA + storage_reader._END, "has damaged metadata .*an alias"),
    ],
    ids=["zstd", "zstd, no size", "lz4", "unknown", "message", "message, no size", "chunks",
         "small messages", "memory", "record", "empty", "metadata"],
)
def test_bomb_in_an_mcap_file_is_read_in_part(tmp_path, content, told) -> None:
    file = tmp_path / "a.mcap"
    file.write_bytes(HEAD + content)
    with pytest.raises(BagError, match=told):
        read_run(file)


def test_file_with_holes_and_one_of_packed_zeros_end(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(storage_reader, "_LEAST_CONTENT", 1 << 40)
    file = tmp_path / "a.mcap"
    file.write_bytes(HEAD)
    os.truncate(file, 1 << 36)
    with pytest.raises(BagError, match=LONGER):
        read_run(file)
    packed = tmp_path / "b.mcap.zstd"
    packed.write_bytes(zstandard.compress(HEAD + ZEROS))
    with pytest.raises(BagError, match=LONGER):
        read_run(packed)


@pytest.mark.parametrize("suffix", [".mcap.zstd", ".db3.zstd"])
def test_unpacking_ends_at_the_limit_and_leaves_no_file(tmp_path, monkeypatch, suffix) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    beginning = HEAD + UNKNOWN if suffix == ".mcap.zstd" else b""
    folder = tmp_path / "bag"
    folder.mkdir()
    (folder / f"a{suffix}").write_bytes(zstandard.compress(beginning + ZEROS))
    told = LONGER if beginning else "it unpacks to more than 6291456 bytes"
    with pytest.raises(BagError, match=told):
        read_run(folder)
    assert [*tmp_path.iterdir()] == [folder]


@pytest.mark.parametrize(
    ("script", "told"),
    [
        (f"{MESSAGES} CREATE VIEW topics AS {ENDLESS} i AS id, '/' || i AS name, '' AS type, "
         "'cdr' AS serialization_format FROM n;", LONGER),
        (f"{TOPICS} CREATE VIEW messages AS {ENDLESS} 1 AS topic_id, i AS timestamp, x'00' AS "
         "data FROM n;", LONGER),
        (f"{TOPICS} CREATE VIEW messages AS {ENDLESS} 1 AS topic_id, i AS timestamp, x'00' AS "
         "data FROM n WHERE i < 0;", LONGER),
        (f"{TOPICS} CREATE VIEW messages AS {ENDLESS} 2 AS topic_id, i AS timestamp, "
         "zeroblob(4000000) AS data FROM n;", "it unpacks to more than 6291456 bytes"),
        (f"{TOPICS} {MESSAGES} CREATE VIEW metadata AS {ENDLESS} i AS id, '' AS metadata FROM n;",
         LONGER),
        (TOPICS, "damaged .no such table: messages"),
        ("CREATE TABLE topics(id, name);", "damaged .no such column: type"),
        ("CREATE TABLE other(id);", "damaged .no such table: topics"),
    ],
    ids=["topics", "messages", "no rows", "large rows", "metadata", "no messages", "columns",
         "another database"],
)
def test_database_that_yields_without_end_is_read_in_part(tmp_path, script, told) -> None:
    file = tmp_path / "a.db3"
    with closing(sqlite3.connect(file)) as database:
        database.executescript(script)
    with pytest.raises(BagError, match=told):
        read_run(file)


@pytest.mark.parametrize(("text", "told"), HOSTILE_TEXTS.values(), ids=HOSTILE_TEXTS)
def test_hostile_metadata_is_ignored(tmp_path, text, told) -> None:
    bag = write_own(tmp_path / "bag", run_messages())
    (bag / "metadata.yaml").write_text(text)
    run = read_run(bag)
    assert len(run.times) == 301
    assert re.search(f"metadata.yaml is ignored, it cannot be read .*({told})", run.notes[0])


def test_custom_data_that_is_nested_deeply_is_ignored(tmp_path) -> None:
    names = ("parameters:/controller", "parameters:/simulator", "topics:/")
    bag = write_own(tmp_path / "bag", run_messages(), dict.fromkeys(names, "[" * 100_000))
    run = read_run(bag)
    assert len(run.times) == 301 and run.notes == ()


def pipe(file: Path) -> None:
    file.unlink(missing_ok=True)
    os.mkfifo(file)


def test_pipes_and_devices_in_place_of_files_are_named(tmp_path) -> None:
    bag = write_own(tmp_path / "bag", run_messages())
    pipe(bag / "metadata.yaml")
    run = read_run(bag)
    assert len(run.times) == 301 and "given a pipe, expected a regular file" in run.notes[0]
    for name in ("a.mcap", "a.db3", "a.mcap.zstd"):
        pipe(tmp_path / name)
        with pytest.raises(BagError, match=f"{name} is a pipe, expected a regular file"):
            read_run(tmp_path / name)
    (tmp_path / "b.mcap").symlink_to("/dev/zero")
    with pytest.raises(BagError, match=r"b\.mcap is a device, expected a regular file"):
        read_run(tmp_path / "b.mcap")
    shutil.rmtree(bag)
    bag.mkdir()
    pipe(bag / "a.db3-wal")
    with closing(sqlite3.connect(bag / "a.db3")) as database:
        database.execute("PRAGMA journal_mode=OFF")
        database.executescript(f"{TOPICS} {MESSAGES}")
    with pytest.raises(BagError, match="/pose"):
        read_run(bag)
