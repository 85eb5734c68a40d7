# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Messages in the storage files of a bag, MCAP or SQLite, read in bounded time and memory.

Anyone's file is read, also one that is made to fill the memory or the disk of its reader. What is
read of the files of a bag is limited to a multiple of their size, and its messages by the memory
that their records take.
"""

import io
import os
import sqlite3
import sys
import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import lz4.frame
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import Channel, Chunk, Footer, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import MCAP0_MAGIC

from sphere_nmpc.errors import InvalidInputError
from sphere_nmpc.foreign.file import open_file
from sphere_nmpc.ros.cdr import RECORDS, read
from sphere_sim.recording.bag_files import (
    custom_data,
    foreign_format,
    full_topic_name,
    metadata_values,
    one_line_reason,
    storage_name,
)

_LEAST_CONTENT, _CONTENT = 1 << 29, 100
"""Bytes to which any bag may unpack, and a byte of one where that is more. Recordings shrink to a
tenth to a thirtieth, zeros to a 30 000th."""
_LEAST_STEPS, _STEPS = 500_000, 5
"""Parts of records and steps of queries that are read of any bag, and besides for each byte of it.
A message has eight, and takes three bytes at least, however well it is compressed."""
_MOST_RECORD = 1 << 28
"""Bytes of a record, chunk or message: the largest map has 100 million, an image 25 million."""
_MOST_MEMORY = 1 << 32
_OBJECTS = 8
"""Memory of the messages that are read [bytes], and bytes that a byte of a message takes as
objects, also in one that has thousands of empty texts."""
_LATEST = 1 << 62
"""Log time that no recorder can have [ns]: of the year 2116."""
_HOLES = 10
"""Size of a file that is stored in a tenth of it, as by a file system that compresses."""
_CDR = "cdr"
_BLOCK, _QUERY_STEPS = 1 << 20, 1000
"""Bytes that are unpacked at once, and steps of a query between two looks at the allowance."""
_DAMAGED = "is truncated or damaged"


class _LimitError(Exception):
    """Limit that is reached; its message says which one."""


class _Allowance:
    """What may still be read of the files of a bag.

    It is given in bytes after decompression, in parts of records and steps of queries, and in
    bytes of memory.
    """

    def __init__(self, files: Sequence[Path]) -> None:
        size = sum(_size(it) for file in files for it in (file, _log_of(file)))
        self.content = max(_LEAST_CONTENT, _CONTENT * size)
        self.steps = _LEAST_STEPS + _STEPS * size
        self.memory = _MOST_MEMORY
        self._most = self.content

    def check(self) -> None:
        """Raise `_LimitError` if one of them is used up."""
        if self.steps < 0:
            raise _LimitError("it takes longer to read than any recording of its size")
        if self.content < 0:
            raise _LimitError(f"it unpacks to more than {self._most} bytes")
        if self.memory < 0:
            raise _LimitError(f"its messages take more than {_MOST_MEMORY} bytes of memory")


class _Metered:
    """Stream whose bytes and parts are taken from an allowance."""

    def __init__(self, stream: Any, allowance: _Allowance) -> None:
        self._read, self._allowance = stream.read, allowance

    def read(self, size: int) -> bytes:
        """Return up to `size` bytes."""
        data: bytes = self._read(size)
        left = self._allowance
        left.content -= len(data)
        left.steps -= 1
        if left.content < 0 or left.steps < 0:
            left.check()
        return data


class StorageReader:
    """Reader of the storage files of a bag.

    Its methods return why a file was not read completely; empty where it was.

    Attributes
    ----------
    types, decoded, custom_data : dict
        As in `Messages`, but for the order of the messages of a topic.
    count : int
        Number of messages read, selected or not.
    invalid, unread : Counter of str
        Messages that could not be decoded by their types, and topics by encodings other than CDR.
    """

    def __init__(self, files: Sequence[Path], selects: Callable[[str, str], bool]) -> None:
        self.types: dict[str, str] = {}
        self.decoded: dict[str, list[tuple[int, Any]]] = {}
        self.custom_data: dict[str, str] = {}
        self.count = 0
        self.invalid: Counter[str] = Counter()
        self.unread: Counter[str] = Counter()
        self._selects = selects
        self._left = _Allowance(files)
        self._zstd = zstandard.ZstdDecompressor()

    def read(self, file: Path) -> str:
        """Read a ``.mcap`` or ``.db3`` file, also with the suffix ``.zstd``."""
        with open_file(file) as stream:  # its errors are those of the file system, later damage
            head = stream.peek(_BLOCK)[:32] if isinstance(stream, io.BufferedReader) else b""
            if not head:
                return "has 0 bytes"
            if kind := foreign_format(head, file.suffix):
                return f"is {kind}"
            plain: Any = stream
            if packed := file.suffix == ".zstd":
                plain = self._zstd.stream_reader(stream, read_across_frames=True)
            try:
                if not storage_name(file).endswith(".db3"):
                    return self._read_mcap(plain)
                if not packed:
                    return self._read_sqlite(file)
                with TemporaryDirectory() as folder:
                    unpacked = Path(folder) / storage_name(file)
                    problem = self._unpack(plain, unpacked)
                    return self._read_sqlite(unpacked) or problem
            except _LimitError as error:
                return f"is read in part, as {error}"

    def _unpack(self, packed: Any, file: Path) -> str:
        with file.open("wb") as unpacked:
            try:
                while block := packed.read(_BLOCK):
                    self._left.content -= len(block)
                    self._left.check()
                    unpacked.write(block)
            except zstandard.ZstdError as error:
                return f"{_DAMAGED} ({one_line_reason(error)})"
        return ""

    def _read_mcap(self, stream: Any) -> str:
        """Read an MCAP file sequentially, without its index, which may be missing."""
        schemas = {0: ""}
        channels: dict[int, tuple[str, bool]] = {}
        problem = ""
        try:
            for record in self._records(stream):
                if isinstance(record, Message):
                    channel = channels.get(record.channel_id, ("", False))
                    self._add(*channel, record.log_time, record.data)
                elif isinstance(record, Schema):
                    schemas[record.id] = record.name
                elif isinstance(record, Channel) and record.schema_id in schemas:
                    self._add_topic(channels, record.id, record.topic, schemas[record.schema_id],
                                    record.message_encoding)
                elif isinstance(record, Metadata) and record.name == "rosbag2":
                    text = record.metadata.get("serialized_metadata", "")
                    problem = self._add_metadata(text) or problem
        except _LimitError:
            raise
        except Exception as error:
            # Such files raise anything, from MemoryError to the private errors of decompressors.
            problem = f"{_DAMAGED} ({one_line_reason(error)})"
        return problem

    def _records(self, stream: Any) -> Iterator[McapRecord]:
        """Yield the records of a file and those in its chunks, which hold no chunks themselves."""
        options: dict[str, Any] = {"emit_chunks": True, "record_size_limit": _MOST_RECORD}
        outer: Any = _Metered(stream, self._left)
        for record in StreamReader(outer, validate_crcs=True, **options).records:
            if not isinstance(record, Chunk):
                yield record
                continue
            content = io.BytesIO(self._unpacked_chunk(record) + _END)
            inner: Any = _Metered(content, self._left)
            yield from StreamReader(inner, skip_magic=True, **options).records

    def _unpacked_chunk(self, chunk: Chunk) -> bytes:
        if chunk.compression == "zstd":
            data = self._unzstd(chunk.data, _MOST_RECORD)
        elif chunk.compression == "lz4":
            unpacker = lz4.frame.LZ4FrameDecompressor()
            data = unpacker.decompress(chunk.data, _MOST_RECORD)
            if not (unpacker.eof or unpacker.needs_input):
                raise _LimitError(f"a part of it unpacks to more than {_MOST_RECORD} bytes")
        elif chunk.compression:
            raise ValueError(f"compression {chunk.compression}")
        else:
            data = chunk.data
        if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
            raise ValueError("the checksum of a chunk is wrong")
        return data

    def _unzstd(self, data: bytes, most: int) -> bytes:
        """Return what data unpacks to; raise `_LimitError` for more than `most` bytes."""
        size = zstandard.frame_content_size(data)  # -1 where the frame does not say it
        found = b""
        if size <= most:
            found = self._zstd.stream_reader(data).read((size if size >= 0 else most) + 1)
        if max(size, len(found)) > most:
            raise _LimitError(f"a part of it unpacks to more than {most} bytes")
        return found

    def _read_sqlite(self, file: Path) -> str:
        # A killed recorder leaves its last messages in a write-ahead log beside the file.
        mode = "mode=ro" if _log_of(file).is_file() else "immutable=1"
        topics: dict[int, tuple[str, bool]] = {}
        problem = ""

        def interrupts() -> bool:
            self._left.steps -= _QUERY_STEPS
            return self._left.steps < 0

        try:
            with closing(sqlite3.connect(f"{file.absolute().as_uri()}?{mode}", uri=True)) as found:
                # Views and generated columns yield without end what no file could hold.
                found.set_progress_handler(interrupts, _QUERY_STEPS)
                if sys.version_info >= (3, 11):
                    found.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _MOST_RECORD)
                # Without this SQLite refuses a truncated file instead of reading it up to its end.
                found.execute("PRAGMA writable_schema=ON")
                query = "SELECT id, name, type, serialization_format FROM topics"
                for row in found.execute(query):
                    self._add_topic(topics, *row)
                query = "SELECT topic_id, timestamp, data FROM messages"
                for number, stamp, data in found.execute(query):
                    self._left.content -= len(data)
                    self._left.check()
                    self._add(*topics.get(number, ("", False)), stamp, data)
                tables = {name for (name,) in found.execute("SELECT name FROM sqlite_master")}
                if "metadata" in tables:  # written last, so missing first in a truncated file
                    for (text,) in found.execute("SELECT metadata FROM metadata ORDER BY id"):
                        problem = self._add_metadata(text) or problem
        except _LimitError:
            raise
        except Exception as error:
            # Damaged pages also give text with a wrong encoding, and missing tables.
            self._left.check()  # as it interrupts queries
            problem = f"{_DAMAGED} ({one_line_reason(error)})"
        return problem

    def _add(self, topic: str, selected: bool, stamp: Any, data: Any) -> None:
        """Decode a message, given its log time [ns], of a topic that may be selected."""
        self.count += 1
        if not selected:
            return
        msgtype = self.types[topic]
        if not (isinstance(data, bytes) and isinstance(stamp, int) and abs(stamp) < _LATEST):
            self.invalid[msgtype] += 1
            return
        try:
            if data.startswith(zstandard.FRAME_HEADER):
                # The bag compresses each message; CDR data never begins with these bytes.
                data = self._unzstd(data, min(_MOST_RECORD, self._left.memory // _OBJECTS))
                self._left.content -= len(data)
            self._left.memory -= _OBJECTS * len(data)
            self._left.check()
            message = read(data, RECORDS[msgtype])
        except (InvalidInputError, zstandard.ZstdError):
            self.invalid[msgtype] += 1
        else:
            self.decoded.setdefault(topic, []).append((stamp, message))

    def _add_topic(
        self, topics: dict[int, tuple[str, bool]], number: int, topic: Any, msgtype: Any,
        encoding: Any,
    ) -> None:
        """Add a topic whose names a topic and a type can have, as notes will show them.

        Those of damaged files, or of files that are made to fool their reader, are not. Of the
        types that publishers of one topic have, the first that is selected counts. A type in
        another encoding than that of ROS 2 is another type.
        """
        if not all(isinstance(it, str) and it.isprintable() and len(it) < 256
                   for it in (topic, msgtype, encoding)):
            return
        topic, msgtype = full_topic_name(topic), msgtype or "no type"
        if encoding != _CDR:
            self.unread[encoding] += number not in topics
            msgtype = f"{msgtype} in {encoding or 'no encoding'}"
        elif msgtype.count("/") == 1:
            msgtype = msgtype.replace("/", "/msg/")  # as the first releases of ROS 2 wrote it
        selected = self._selects(topic, msgtype)
        if topic not in self.types or (selected and not self._selects(topic, self.types[topic])):
            self.types[topic] = msgtype
        topics[number] = topic, selected and self.types[topic] == msgtype

    def _add_metadata(self, text: str) -> str:
        """Add the custom data of the metadata that recorders store in the file as well."""
        try:
            self.custom_data.update(custom_data(metadata_values(text)))
        except Exception as error:
            # The messages are intact: this record only repeats metadata.yaml.
            return f"has damaged metadata ({one_line_reason(error)})"
        return ""


def _size(file: Path) -> int:
    """Return the size of a file [bytes], where holes count up to `_HOLES` times what is stored."""
    try:
        found = os.stat(file)
    except OSError:
        return 0  # which its reading will report
    stored = 512 * found.st_blocks or found.st_size  # some file systems do not count blocks
    return min(found.st_size, _HOLES * stored)


def _log_of(file: Path) -> Path:
    return file.with_name(f"{file.name}-wal")


def _end() -> bytes:
    """Return the last records of a file, without which the reader reports a truncated one."""
    builder = RecordBuilder()
    Footer(summary_start=0, summary_offset_start=0, summary_crc=0).write(builder)
    encoded: bytes = builder.end()
    return encoded + bytes(MCAP0_MAGIC)


_END = _end()
