# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Decoded messages of a bag: MCAP or SQLite, split, compressed, complete or truncated."""

import sqlite3
import struct
from collections import Counter
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import zstandard
from mcap.records import Channel, Message, Metadata, Schema
from mcap.stream_reader import StreamReader
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_typestore
from ruamel.yaml import YAML

from sphere_sim.recording.bag_files import (
    BagError,
    custom_data,
    find_files,
    one_line_reason,
    storage_name,
)

TopicFilter = Callable[[str, str], bool]
"""Returns from topic and message type whether its messages are selected."""
_DAMAGED = "is truncated or damaged"


@dataclass
class _Storage:
    """Content of a storage file.

    It has the message types of its topics, topic, log time [ns] and data of the selected messages
    in the order written, the number of messages read, selected or not, and the custom data of the
    bag; `problem` describes a damage.
    """

    types: dict[str, str] = field(default_factory=dict)
    messages: list[tuple[str, int, bytes]] = field(default_factory=list)
    count: int = 0
    custom_data: dict[str, str] = field(default_factory=dict)
    problem: str = ""


@dataclass
class Messages:
    """Messages of a bag.

    Attributes
    ----------
    path : Path
        The bag.
    types : dict of str to str
        Message type of each topic that the bag announces.
    decoded : dict of str to list of (int, Any)
        Log time [ns] and message, in order of time, for each selected topic that has messages.
    custom_data : dict of str to str
        Custom data of the bag.
    notes : list of str
        Messages for users on what is missing or invalid in the bag.
    truncated : bool
        Whether more may have been recorded than can be read.
    """

    path: Path
    types: dict[str, str] = field(default_factory=dict)
    decoded: dict[str, list[tuple[int, Any]]] = field(default_factory=dict)
    custom_data: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    truncated: bool = False

    def incomplete(self, missing: str) -> str:
        """Return the reason of an error for `missing` content that may have been recorded."""
        return f"{missing} in what can be read of it: {'; '.join(self.notes)}"


def read_messages(path: Path, selects: TopicFilter) -> Messages:
    """Read a bag.

    Parameters
    ----------
    path : Path
        Folder with or without ``metadata.yaml``, or a single ``.mcap`` or ``.db3`` file, each of
        them also with the suffix ``.zstd``.
    selects : callable
        Returns from topic and message type whether to decode the messages.

    Raises
    ------
    BagError
        If there is no bag, nothing in it can be read, or the files are of several bags.
    """
    bag = find_files(path)
    messages = Messages(path, notes=bag.notes)
    storages = [_read(path, file, selects) for file in bag.files]
    for file, storage in zip(bag.files, storages, strict=True):
        if storage.problem:
            read = f"; {storage.count} messages before that were read" if storage.count else ""
            messages.notes.append(f"{file.name} {storage.problem}{read}")
        messages.truncated |= bool(storage.problem)
        messages.types.update(storage.types)
        messages.custom_data.update(storage.custom_data)
    messages.custom_data.update(bag.custom_data)
    if messages.truncated and not messages.types:
        problems = "; ".join(messages.notes)
        raise BagError(path, f"nothing can be read of it: {problems}")
    _decode(messages, storages)
    return messages


def _read(path: Path, file: Path, selects: TopicFilter) -> _Storage:
    try:
        return _read_storage(file, selects)
    except OSError as error:
        raise BagError(path, f"{file.name} cannot be read: {error.strerror or error}") from error


def _decode(messages: Messages, storages: list[_Storage]) -> None:
    """Decode the selected messages in order of log time."""
    store, zstd = get_typestore(Stores.ROS2_JAZZY), zstandard.ZstdDecompressor()
    invalid: Counter[str] = Counter()
    raw = [entry for storage in storages for entry in storage.messages]
    # Recorders that compress messages in several threads write them in any order.
    for topic, stamp, data in sorted(raw, key=lambda entry: entry[1]):
        msgtype = messages.types[topic]
        try:
            if data.startswith(zstandard.FRAME_HEADER):
                # The bag compresses each message; CDR data never begins with these bytes.
                data = zstd.decompressobj().decompress(data)
            message = store.deserialize_cdr(data, msgtype)
        except (SerdeError, zstandard.ZstdError, ValueError, IndexError, KeyError, struct.error):
            invalid[msgtype] += 1
        else:
            messages.decoded.setdefault(topic, []).append((stamp, message))
    messages.notes += [f"{n} messages of type {name} are invalid" for name, n in invalid.items()]


def _read_storage(file: Path, selects: TopicFilter) -> _Storage:
    """Read a ``.mcap`` or ``.db3`` file, also with the suffix ``.zstd``, up to any damage."""
    storage = _Storage()
    with file.open("rb") as stream:  # an error is that of the file system here, later damage
        if not stream.read(1):
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
                problem = f"{_DAMAGED} ({error})"
        _read_plain(plain, storage, selects)
    storage.problem = problem or storage.problem
    return storage


def _read_plain(file: Path, storage: _Storage, selects: TopicFilter) -> None:
    (_read_mcap if file.suffix == ".mcap" else _read_sqlite)(file, storage, selects)


def _read_mcap(file: Path, storage: _Storage, selects: TopicFilter) -> None:
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
            # Such files raise anything, from MemoryError to the private errors of decompressors.
            storage.problem = f"{_DAMAGED} ({one_line_reason(error)})"


def _read_sqlite(file: Path, storage: _Storage, selects: TopicFilter) -> None:
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
        storage.problem = f"{_DAMAGED} ({one_line_reason(error)})"


def _are_names(*values: object) -> bool:
    """Return whether values are names that a topic or a type can have, which notes will show.

    Those of damaged files, or of files that are made to fool their reader, are not.
    """
    return all(isinstance(it, str) and it.isprintable() and len(it) < 256 for it in values)


def _add_metadata(storage: _Storage, text: str) -> None:
    """Add the custom data of the metadata that recorders store in the file as well."""
    try:
        storage.custom_data.update(custom_data(YAML(typ="safe").load(text)))
    except Exception as error:
        # The messages are intact: this record only repeats metadata.yaml.
        storage.problem = f"has damaged metadata ({one_line_reason(error)})"
