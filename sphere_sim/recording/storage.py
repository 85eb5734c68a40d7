# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""What one storage file of a bag holds: MCAP or SQLite, compressed or not, whole or broken off."""

import os
import sqlite3
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory

import zstandard
from mcap.records import Channel, Message, Metadata, Schema
from mcap.stream_reader import StreamReader
from ruamel.yaml import YAML

from sphere_sim.recording.bag_files import custom_data, storage_name

Wanted = Callable[[str, str], bool]
"""Tells from topic and message type whether its messages are wanted."""
_BREAKS_OFF = "breaks off"
_MCAP_MAGIC = b"\x89MCAP0\r\n"
"""A MCAP file begins and ends with this."""
_SQLITE_MAGIC, _SQLITE_HEADER = b"SQLite format 3\0", 100
"""What a database begins with, and the length of its header [bytes]."""


@dataclass
class Storage:
    """Content of a storage file.

    Attributes
    ----------
    types : dict of str to str
        Message type of each topic that it announces.
    messages : list of (str, int, bytes)
        Topic, log time [ns] and data of the messages that were wanted, in the order written.
    count : int
        How many messages were read, wanted or not.
    custom_data : dict of str to str
        What the recorder said about the run.
    problem : str
        Why there may be less than was recorded, in words; empty where the file is whole.
    """

    types: dict[str, str] = field(default_factory=dict)
    messages: list[tuple[str, int, bytes]] = field(default_factory=list)
    count: int = 0
    custom_data: dict[str, str] = field(default_factory=dict)
    problem: str = ""


def read_storage(file: Path, wanted: Wanted) -> Storage:
    """Read a ``.mcap`` or ``.db3`` file, or one with ``.zstd`` behind, as far as it goes.

    Raises
    ------
    OSError
        If it cannot be opened.
    """
    storage = Storage()
    if not file.is_dir() and file.stat().st_size == 0:
        storage.problem = "has 0 bytes"
        return storage
    if file.suffix != ".zstd":
        _read_plain(file, storage, wanted)
        return storage
    with TemporaryDirectory() as folder:
        plain = Path(folder) / storage_name(file)
        problem = ""
        with file.open("rb") as packed, plain.open("wb") as unpacked:
            try:
                zstandard.ZstdDecompressor().copy_stream(packed, unpacked)
            except zstandard.ZstdError as error:
                problem = f"is damaged ({error})"
        _read_plain(plain, storage, wanted)
    storage.problem = problem or storage.problem
    return storage


def _read_plain(file: Path, storage: Storage, wanted: Wanted) -> None:
    (_read_mcap if file.suffix == ".mcap" else _read_sqlite)(file, storage, wanted)


def _read_mcap(file: Path, storage: Storage, wanted: Wanted) -> None:
    """Read from front to back: an index is of no use to who wants it all, and may be missing."""
    schemas: dict[int, Schema] = {}
    channels: dict[int, tuple[str, bool]] = {}
    with file.open("rb") as stream:
        try:
            for record in StreamReader(stream, validate_crcs=True).records:
                if isinstance(record, Message) and record.channel_id in channels:
                    storage.count += 1
                    topic, taken = channels[record.channel_id]
                    if taken:
                        storage.messages.append((topic, record.log_time, record.data))
                elif isinstance(record, Schema):
                    schemas[record.id] = record
                elif isinstance(record, Channel) and record.schema_id in schemas:
                    msgtype = schemas[record.schema_id].name
                    storage.types[record.topic] = msgtype
                    channels[record.id] = record.topic, wanted(record.topic, msgtype)
                elif isinstance(record, Metadata) and record.name == "rosbag2":
                    _take_metadata(storage, record.metadata.get("serialized_metadata", ""))
        except Exception as error:
            # What is cut or damaged raises anything, from MemoryError to what a decompressor has
            # of its own; the end tells which.
            storage.problem = f"is damaged ({_words(error)})"
            magic, size = len(_MCAP_MAGIC), stream.seek(0, os.SEEK_END)
            stream.seek(0)
            begins = _MCAP_MAGIC.startswith(stream.read(magic))
            stream.seek(max(magic, size - magic))
            if begins and stream.read() != _MCAP_MAGIC:
                storage.problem = _BREAKS_OFF


def _read_sqlite(file: Path, storage: Storage, wanted: Wanted) -> None:
    # What a recorder that was killed had not yet moved into the file is in a log beside it.
    beside = file.with_name(f"{file.name}-wal").exists()
    address = f"{file.absolute().as_uri()}?{'mode=ro' if beside else 'immutable=1'}"
    try:
        with closing(sqlite3.connect(address, uri=True)) as connection:
            # Otherwise SQLite refuses a file that breaks off, instead of reading up to there.
            connection.execute("PRAGMA writable_schema=ON")
            topics = {}
            for number, topic, msgtype in connection.execute("SELECT id, name, type FROM topics"):
                if isinstance(topic, str) and isinstance(msgtype, str):  # damaged ones are none
                    storage.types[topic] = msgtype
                    topics[number] = topic, wanted(topic, msgtype)
            rows = connection.execute("SELECT topic_id, timestamp, data FROM messages")
            for number, stamp, data in rows:
                storage.count += 1
                topic, taken = topics.get(number, ("", False))
                if taken and isinstance(data, bytes):
                    storage.messages.append((topic, int(stamp), data))
            tables = {name for (name,) in connection.execute("SELECT name FROM sqlite_master")}
            if "metadata" in tables:  # written last, so the first to be cut off
                for (text,) in connection.execute("SELECT metadata FROM metadata ORDER BY id"):
                    _take_metadata(storage, text)
    except Exception as error:
        # What SQLite makes of damaged pages may also be text that is none, or a lacking table.
        storage.problem = f"is damaged ({_words(error)})"
    if _is_cut(file):
        storage.problem = _BREAKS_OFF


def _is_cut(file: Path) -> bool:
    """Tell whether an SQLite file is shorter than its header says."""
    with file.open("rb") as stream:
        head = stream.read(_SQLITE_HEADER)
    if not _SQLITE_MAGIC.startswith(head[: len(_SQLITE_MAGIC)]):
        return False
    if len(head) < _SQLITE_HEADER:
        return True
    page_size, pages = int.from_bytes(head[16:18], "big"), int.from_bytes(head[28:32], "big")
    # The largest page size has no place in its two bytes and is written as 1.
    return file.stat().st_size < pages * (65536 if page_size == 1 else page_size)


def _take_metadata(storage: Storage, text: str) -> None:
    """Take custom data out of the metadata that recorders store in the file as well."""
    try:
        storage.custom_data.update(custom_data(YAML(typ="safe").load(text)))
    except Exception as error:
        # It repeats metadata.yaml and adds nothing to the messages.
        storage.problem = f"has damaged metadata ({_words(error)})"


def _words(error: Exception) -> str:
    return " ".join(str(error).split()).rstrip(".") or type(error).__name__
