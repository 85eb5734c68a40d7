# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Decoded messages of a bag: MCAP or SQLite, split, compressed, complete or truncated."""

import sqlite3
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
from ruamel.yaml import YAML

from sphere_nmpc.errors import InvalidInputError
from sphere_nmpc.foreign_text import shown
from sphere_nmpc.ros.cdr import RECORDS, read
from sphere_sim.recording.bag_files import (
    METADATA,
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
class Messages:
    """Messages of a bag.

    Attributes
    ----------
    types : dict of str to str
        Message type of each topic that the bag announces.
    decoded : dict of str to list of (int, Any)
        Log time [ns] and record, see `RECORDS`, in order of time, for each selected topic that
        has messages.
    custom_data, notes : dict of str to str, and list of str
        Custom data of the bag; messages for users on what is missing or invalid in it.
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


def full_topic_name(name: str) -> str:
    """Return a name with its leading slash, which some writers of bags leave out."""
    return f"/{name.strip('/')}"


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
    reader = _StorageReader(messages, selects)
    for file in bag.files:
        before = reader.count
        try:
            problem = reader.read(file)
        except OSError as error:
            reason = f"{file.name} cannot be read: {error.strerror or error}"
            raise BagError(path, reason) from error
        if problem:
            count = reader.count - before
            read = f"; {count} messages before that were read" if count else ""
            messages.notes.append(f"{file.name} {problem}{read}")
            messages.truncated = True
    messages.custom_data.update(bag.custom_data)
    if not messages.truncated and bag.message_count not in (None, reader.count):
        # As after a full disk; tools that show metadata.yaml alone do not know.
        messages.notes.append(
            f"{METADATA} counts {shown(bag.message_count)} messages, the storage has "
            f"{reader.count}: all of these are read"
        )
    if messages.truncated and not messages.types:
        problems = "; ".join(messages.notes)
        raise BagError(path, f"nothing can be read of it: {problems}")
    _decode(messages, reader.raw)
    return messages


def _decode(messages: Messages, raw: list[tuple[str, int, bytes]]) -> None:
    """Decode messages, with topic and log time [ns], in order of log time."""
    zstd = zstandard.ZstdDecompressor()
    invalid: Counter[str] = Counter()
    # Recorders that compress messages in several threads write them in any order.
    for topic, stamp, data in sorted(raw, key=lambda entry: entry[1]):
        msgtype = messages.types[topic]
        try:
            if data.startswith(zstandard.FRAME_HEADER):
                # The bag compresses each message; CDR data never begins with these bytes.
                data = zstd.decompressobj().decompress(data)
            message = read(data, RECORDS[msgtype])
        except (InvalidInputError, zstandard.ZstdError):
            invalid[msgtype] += 1
        else:
            messages.decoded.setdefault(topic, []).append((stamp, message))
    messages.notes += [f"{n} messages of type {name} are invalid" for name, n in invalid.items()]


class _StorageReader:
    """Reader of the storage files of a bag, which adds their topics and custom data to `messages`.

    Its methods return a description of the damage up to which a file was read; empty without any.
    """

    def __init__(self, messages: Messages, selects: TopicFilter) -> None:
        self.raw: list[tuple[str, int, bytes]] = []
        """Topic, log time [ns] and data of the selected messages, in the order written."""
        self.count = 0
        """Number of messages read, selected or not."""
        self._messages, self._selects = messages, selects

    def read(self, file: Path) -> str:
        """Read a ``.mcap`` or ``.db3`` file, also with the suffix ``.zstd``."""
        with file.open("rb") as stream:  # an error is that of the file system here, later damage
            if not stream.read(1):
                return "has 0 bytes"
        if file.suffix != ".zstd":
            return self._read_plain(file)
        with TemporaryDirectory() as folder:
            plain = Path(folder) / storage_name(file)
            problem = ""
            with file.open("rb") as packed, plain.open("wb") as unpacked:
                try:
                    zstandard.ZstdDecompressor().copy_stream(packed, unpacked)
                except zstandard.ZstdError as error:
                    problem = f"{_DAMAGED} ({error})"
            found = self._read_plain(plain)
            return problem or found

    def _read_plain(self, file: Path) -> str:
        return self._read_mcap(file) if file.suffix == ".mcap" else self._read_sqlite(file)

    def _read_mcap(self, file: Path) -> str:
        """Read an MCAP file sequentially, without its index, which may be missing."""
        schemas: dict[int, Schema] = {}
        channels: dict[int, tuple[str, bool]] = {}
        problem = ""
        with file.open("rb") as stream:
            try:
                for record in StreamReader(stream, validate_crcs=True).records:
                    if isinstance(record, Message):
                        channel = channels.get(record.channel_id, ("", False))
                        self._add(*channel, record.log_time, record.data)
                    elif isinstance(record, Schema):
                        schemas[record.id] = record
                    elif isinstance(record, Channel) and record.schema_id in schemas:
                        self._add_topic(
                            channels, record.id, record.topic, schemas[record.schema_id].name
                        )
                    elif isinstance(record, Metadata) and record.name == "rosbag2":
                        text = record.metadata.get("serialized_metadata", "")
                        problem = self._add_metadata(text) or problem
            except Exception as error:
                # Such files raise anything, from MemoryError to the private errors of
                # decompressors.
                problem = f"{_DAMAGED} ({one_line_reason(error)})"
        return problem

    def _read_sqlite(self, file: Path) -> str:
        # A killed recorder leaves its last messages in a write-ahead log beside the file.
        has_log = file.with_name(f"{file.name}-wal").exists()
        address = f"{file.absolute().as_uri()}?{'mode=ro' if has_log else 'immutable=1'}"
        topics: dict[int, tuple[str, bool]] = {}
        problem = ""
        try:
            with closing(sqlite3.connect(address, uri=True)) as connection:
                # Without this SQLite refuses a truncated file instead of reading it up to its end.
                connection.execute("PRAGMA writable_schema=ON")
                for row in connection.execute("SELECT id, name, type FROM topics"):
                    self._add_topic(topics, *row)
                rows = connection.execute("SELECT topic_id, timestamp, data FROM messages")
                for number, stamp, data in rows:
                    self._add(*topics.get(number, ("", False)), stamp, data)
                tables = {name for (name,) in connection.execute("SELECT name FROM sqlite_master")}
                if "metadata" in tables:  # written last, so missing first in a truncated file
                    for (text,) in connection.execute("SELECT metadata FROM metadata ORDER BY id"):
                        problem = self._add_metadata(text) or problem
        except Exception as error:
            # Damaged pages also give text with a wrong encoding, and missing tables.
            problem = f"{_DAMAGED} ({one_line_reason(error)})"
        return problem

    def _add(self, topic: str, selected: bool, stamp: int, data: Any) -> None:
        self.count += 1
        if selected and isinstance(data, bytes):
            self.raw.append((topic, int(stamp), data))

    def _add_topic(
        self, topics: dict[int, tuple[str, bool]], number: int, topic: Any, msgtype: Any
    ) -> None:
        """Add a topic whose names a topic and a type can have, as notes will show them.

        Those of damaged files, or of files that are made to fool their reader, are not. Of the
        types that publishers of one topic have, the first that is selected counts.
        """
        if not all(isinstance(it, str) and it.isprintable() and len(it) < 256
                   for it in (topic, msgtype)):
            return
        topic, types = full_topic_name(topic), self._messages.types
        selected = self._selects(topic, msgtype)
        if topic not in types or (selected and not self._selects(topic, types[topic])):
            types[topic] = msgtype
        topics[number] = topic, selected and types[topic] == msgtype

    def _add_metadata(self, text: str) -> str:
        """Add the custom data of the metadata that recorders store in the file as well."""
        try:
            self._messages.custom_data.update(custom_data(YAML(typ="safe").load(text)))
        except Exception as error:
            # The messages are intact: this record only repeats metadata.yaml.
            return f"has damaged metadata ({one_line_reason(error)})"
        return ""
