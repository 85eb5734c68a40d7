# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""An MCAP file that is complete on disk after every commit.

The writers of the ``mcap`` and ``rosbags`` packages put index and footer down once, at the end; a
process killed before that leaves a file that most tools refuse. Here every commit writes the new
chunk *and* index and footer behind it with one system call, over the index and footer of the
commit before. What is on disk is therefore a valid file at any moment but during that call.
"""

import contextlib
import os
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Message,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from sphere_sim.recording.errors import BagError

_MAGIC = b"\x89MCAP0\r\n"
_COMPRESSION = "zstd"


def _encode(*records: McapRecord) -> bytes:
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    encoded: bytes = builder.end()
    return encoded


class McapWriter:
    """Write messages into chunks and keep the file complete.

    Parameters
    ----------
    path : Path
        File to create; must not exist.
    library : str
        Name and version of the writer, stored in the header.

    Raises
    ------
    BagError
        If the file cannot be created.
    """

    def __init__(self, path: Path, library: str) -> None:
        self._path = path
        self._schemas: dict[str, Schema] = {}
        self._channels: list[Channel] = []
        self._counts: dict[int, int] = {}
        self._span: tuple[int, int] | None = None
        self._chunks = 0
        # Index records of the chunks on disk, encoded once: a long recording has thousands.
        self._chunk_indexes = b""
        self._definitions = RecordBuilder()
        self._messages = RecordBuilder()
        self._offsets: dict[int, list[tuple[int, int]]] = {}
        self._tail = b""
        try:
            self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
        except OSError as error:
            raise BagError(path, f"cannot be created: {error.strerror}") from error
        self._end = 0
        try:
            self._put(_MAGIC + _encode(Header(profile="ros2", library=library)), b"")
        except BagError:
            self.close()
            raise

    @property
    def pending(self) -> int:
        """How much has not been committed yet [bytes]."""
        size: int = self._messages.count
        return size

    @property
    def span(self) -> tuple[int, int] | None:
        """Times of the earliest and the latest message [ns]; None without messages."""
        return self._span

    def add_channel(
        self, topic: str, msgtype: str, definition: str, metadata: Mapping[str, str]
    ) -> int:
        """Announce a topic and return the identifier its messages are written with."""
        schema = self._schemas.get(msgtype)
        if schema is None:
            number = len(self._schemas) + 1
            schema = Schema(
                id=number, name=msgtype, encoding="ros2msg", data=definition.encode()
            )
            self._schemas[msgtype] = schema
            schema.write(self._definitions)
        channel = Channel(
            id=len(self._channels) + 1,
            topic=topic,
            message_encoding="cdr",
            metadata=dict(metadata),
            schema_id=schema.id,
        )
        self._channels.append(channel)
        self._counts[channel.id] = 0
        channel.write(self._definitions)
        return channel.id

    def add_message(self, channel: int, stamp: int, data: bytes) -> None:
        """Add a serialised message to the chunk in progress.

        Parameters
        ----------
        channel : int
            As returned by `add_channel`.
        stamp : int
            Time of the message [ns].
        data : bytes
            The message in CDR.
        """
        self._offsets.setdefault(channel, []).append((stamp, self._messages.count))
        sequence = self._counts[channel]
        Message(
            channel_id=channel, log_time=stamp, publish_time=stamp, sequence=sequence, data=data
        ).write(self._messages)
        self._counts[channel] += 1
        low, high = self._span or (stamp, stamp)
        self._span = (min(low, stamp), max(high, stamp))

    def count(self, channel: int) -> int:
        """Return how many messages a channel has."""
        return self._counts[channel]

    def commit(self, metadata: Mapping[str, Mapping[str, str]]) -> None:
        """Bring everything added so far to the disk and leave a complete file there.

        Parameters
        ----------
        metadata : mapping of str to mapping of str to str
            Metadata records by name; they replace those of the commit before.

        Raises
        ------
        BagError
            If the disk does not take it; the file is then as the commit before left it.
        """
        body: bytes = self._definitions.end()
        if self._offsets:
            body += self._chunk(self._end + len(body))
        self._put(body, self._closing(self._end + len(body), metadata))

    def close(self) -> None:
        """Close the file as the last commit left it."""
        os.close(self._file)

    def _chunk(self, position: int) -> bytes:
        """Encode the pending messages, at `position` of the file, and note their index."""
        raw = self._messages.end()
        stamps = [stamp for entries in self._offsets.values() for stamp, _ in entries]
        packed = zstandard.compress(raw)
        chunk = _encode(
            Chunk(
                compression=_COMPRESSION,
                data=packed,
                message_start_time=min(stamps),
                message_end_time=max(stamps),
                uncompressed_crc=zlib.crc32(raw),
                uncompressed_size=len(raw),
            )
        )
        indexes = b""
        places = {}
        for channel, entries in self._offsets.items():
            places[channel] = position + len(chunk) + len(indexes)
            indexes += _encode(MessageIndex(channel_id=channel, records=entries))
        self._chunk_indexes += _encode(
            ChunkIndex(
                chunk_length=len(chunk),
                chunk_start_offset=position,
                compression=_COMPRESSION,
                compressed_size=len(packed),
                message_end_time=max(stamps),
                message_index_length=len(indexes),
                message_index_offsets=places,
                message_start_time=min(stamps),
                uncompressed_size=len(raw),
            )
        )
        self._chunks += 1
        self._offsets = {}
        return chunk + indexes

    def _closing(self, position: int, metadata: Mapping[str, Mapping[str, str]]) -> bytes:
        """Encode all that follows the last chunk, at `position` of the file."""
        records = b""
        indexes: list[McapRecord] = []
        for name, values in metadata.items():
            record = _encode(Metadata(name=name, metadata=dict(values)))
            indexes.append(
                MetadataIndex(offset=position + len(records), length=len(record), name=name)
            )
            records += record
        records += _encode(DataEnd(data_section_crc=0))
        low, high = self._span or (0, 0)
        statistics = Statistics(
            attachment_count=0,
            channel_count=len(self._channels),
            channel_message_counts=self._counts,
            chunk_count=self._chunks,
            message_count=sum(self._counts.values()),
            message_end_time=high,
            message_start_time=low,
            metadata_count=len(indexes),
            schema_count=len(self._schemas),
        )
        groups = (
            (Opcode.SCHEMA, _encode(*self._schemas.values())),
            (Opcode.CHANNEL, _encode(*self._channels)),
            (Opcode.STATISTICS, _encode(statistics)),
            (Opcode.CHUNK_INDEX, self._chunk_indexes),
            (Opcode.METADATA_INDEX, _encode(*indexes)),
        )
        start = position + len(records)
        summary = b""
        offsets: list[McapRecord] = []
        for opcode, group in groups:
            if group:
                offsets.append(SummaryOffset(opcode, start + len(summary), len(group)))
            summary += group
        offsets_at = start + len(summary)
        summary += _encode(*offsets)
        # The checksum covers the footer up to itself; the last four bytes are its place.
        unsigned = _encode(Footer(start, offsets_at, 0))[:-4]
        footer = _encode(Footer(start, offsets_at, zlib.crc32(summary + unsigned)))
        return records + summary + footer + _MAGIC

    def _put(self, body: bytes, tail: bytes) -> None:
        try:
            _write_all(lambda data, at: os.pwrite(self._file, data, at), body + tail, self._end)
        except OSError as error:
            # The old tail's blocks are still ours, so this needs no space; a device that fails
            # or has gone takes nothing at all.
            with contextlib.suppress(OSError):
                os.ftruncate(self._file, self._end + len(self._tail))
                os.pwrite(self._file, self._tail, self._end)
            raise BagError(self._path, f"cannot be written: {error.strerror}") from error
        self._end += len(body)
        self._tail = tail


def _write_all(write: Callable[[memoryview, int], int], data: bytes, position: int) -> None:
    """Write `data` at `position`; one call unless the disk takes less."""
    rest = memoryview(data)
    while rest:
        written = write(rest, position)
        position += written
        rest = rest[written:]
