# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Content of one storage file of a bag: MCAP or SQLite, compressed or not, possibly truncated."""

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
from mcap.writer import MCAP0_MAGIC
from ruamel.yaml import YAML

from sphere_sim.recording.bag_files import custom_data, storage_name
from sphere_sim.recording.errors import one_line_reason

TopicFilter = Callable[[str, str], bool]
"""Returns from topic and message type whether its messages are selected."""
_TRUNCATED = "is truncated"
_SQLITE_MAGIC, _SQLITE_HEADER = b"SQLite format 3\0", 100
"""First bytes of a database, and the length of its header [bytes]."""


@dataclass
class Storage:
    """Content of a storage file.

    Attributes
    ----------
    types : dict of str to str
        Message type of each topic that it announces.
    messages : list of (str, int, bytes)
        Topic, log time [ns] and data of the selected messages, in the order written.
    count : int
        Number of messages read, selected or not.
    custom_data : dict of str to str
        Custom data of the bag.
    problem : str
        Description of a truncation or damage; empty where the file is intact.
    """

    types: dict[str, str] = field(default_factory=dict)
    messages: list[tuple[str, int, bytes]] = field(default_factory=list)
    count: int = 0
    custom_data: dict[str, str] = field(default_factory=dict)
    problem: str = ""


def read_storage(file: Path, selects: TopicFilter) -> Storage:
    """Read a ``.mcap`` or ``.db3`` file, also with the suffix ``.zstd``, up to any damage.

    Raises
    ------
    OSError
        If the file cannot be opened.
    """
    storage = Storage()
    if not file.is_dir() and file.stat().st_size == 0:
        storage.problem = "has 0 bytes"
        return storage
    if file.suffix != ".zstd":
        _read_plain(file, storage, selects)
        return storage
    with TemporaryDirectory() as folder:
        plain = Path(folder) / storage_name(file)
        problem = ""
        with file.open("rb") as packed, plain.open("wb") as unpacked:
            try:
                zstandard.ZstdDecompressor().copy_stream(packed, unpacked)
            except zstandard.ZstdError as error:
                problem = f"is damaged ({error})"
        _read_plain(plain, storage, selects)
    storage.problem = problem or storage.problem
    return storage


def _read_plain(file: Path, storage: Storage, selects: TopicFilter) -> None:
    (_read_mcap if file.suffix == ".mcap" else _read_sqlite)(file, storage, selects)


def _read_mcap(file: Path, storage: Storage, selects: TopicFilter) -> None:
    """Read an MCAP file sequentially, without its index, which may be missing."""
    schemas: dict[int, Schema] = {}
    channels: dict[int, tuple[str, bool]] = {}
    with file.open("rb") as stream:
        try:
            for record in StreamReader(stream, validate_crcs=True).records:
                if isinstance(record, Message) and record.channel_id in channels:
                    storage.count += 1
                    topic, selected = channels[record.channel_id]
                    if selected:
                        storage.messages.append((topic, record.log_time, record.data))
                elif isinstance(record, Schema):
                    schemas[record.id] = record
                elif isinstance(record, Channel) and record.schema_id in schemas:
                    msgtype = schemas[record.schema_id].name
                    if _are_names(record.topic, msgtype):
                        storage.types[record.topic] = msgtype
                        channels[record.id] = record.topic, selects(record.topic, msgtype)
                elif isinstance(record, Metadata) and record.name == "rosbag2":
                    _add_metadata(storage, record.metadata.get("serialized_metadata", ""))
        except Exception as error:
            # Truncated and damaged files raise anything, from MemoryError to the private errors of
            # decompressors; the end of the file distinguishes the two.
            storage.problem = f"is damaged ({one_line_reason(error)})"
            magic, size = len(MCAP0_MAGIC), stream.seek(0, os.SEEK_END)
            stream.seek(0)
            is_mcap = MCAP0_MAGIC.startswith(stream.read(magic))
            stream.seek(max(magic, size - magic))
            if is_mcap and stream.read() != MCAP0_MAGIC:
                storage.problem = _TRUNCATED


def _read_sqlite(file: Path, storage: Storage, selects: TopicFilter) -> None:
    # A killed recorder leaves its last messages in a write-ahead log beside the file.
    has_log = file.with_name(f"{file.name}-wal").exists()
    address = f"{file.absolute().as_uri()}?{'mode=ro' if has_log else 'immutable=1'}"
    try:
        with closing(sqlite3.connect(address, uri=True)) as connection:
            # Without this SQLite refuses a truncated file instead of reading it up to its end.
            connection.execute("PRAGMA writable_schema=ON")
            topics = {}
            for number, topic, msgtype in connection.execute("SELECT id, name, type FROM topics"):
                if _are_names(topic, msgtype):
                    storage.types[topic] = msgtype
                    topics[number] = topic, selects(topic, msgtype)
            rows = connection.execute("SELECT topic_id, timestamp, data FROM messages")
            for number, stamp, data in rows:
                storage.count += 1
                topic, selected = topics.get(number, ("", False))
                if selected and isinstance(data, bytes):
                    storage.messages.append((topic, int(stamp), data))
            tables = {name for (name,) in connection.execute("SELECT name FROM sqlite_master")}
            if "metadata" in tables:  # written last, so missing first in a truncated file
                for (text,) in connection.execute("SELECT metadata FROM metadata ORDER BY id"):
                    _add_metadata(storage, text)
    except Exception as error:
        # Damaged pages also give text with a wrong encoding, and missing tables.
        storage.problem = f"is damaged ({one_line_reason(error)})"
    if _is_truncated(file):
        storage.problem = _TRUNCATED


def _are_names(*values: object) -> bool:
    """Return whether values are names that a topic or a type can have, which notes will show.

    Those of damaged files, or of files that are made to fool their reader, are not.
    """
    return all(isinstance(it, str) and it.isprintable() and len(it) < 256 for it in values)


def _is_truncated(file: Path) -> bool:
    """Return whether an SQLite file is shorter than its header says."""
    with file.open("rb") as stream:
        head = stream.read(_SQLITE_HEADER)
    if not _SQLITE_MAGIC.startswith(head[: len(_SQLITE_MAGIC)]):
        return False
    if len(head) < _SQLITE_HEADER:
        return True
    page_size, pages = int.from_bytes(head[16:18], "big"), int.from_bytes(head[28:32], "big")
    # The largest page size does not fit into two bytes and is stored as 1.
    return file.stat().st_size < pages * (65536 if page_size == 1 else page_size)


def _add_metadata(storage: Storage, text: str) -> None:
    """Add the custom data of the metadata that recorders store in the file as well."""
    try:
        storage.custom_data.update(custom_data(YAML(typ="safe").load(text)))
    except Exception as error:
        # The messages are intact: this record only repeats metadata.yaml.
        storage.problem = f"has damaged metadata ({one_line_reason(error)})"
