# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Writer of MCAP files that are complete on disk after every commit.

The writers of the ``mcap`` and ``rosbags`` packages write index and footer once, at the end; a
process that is killed earlier leaves a file that most tools refuse. Here every commit writes the
new chunk with index and footer behind it, with one system call, over the index and footer of the
commit before. The file is therefore complete on disk at any moment except during that call.
"""

import contextlib
import os
import zlib
from pathlib import Path

import zstandard
from mcap import records
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC

from sphere_sim.recording.bag_files import BagError

_COMPRESSION = "zstd"


def _encode(*entries: records.McapRecord) -> bytes:
    builder = RecordBuilder()
    for entry in entries:
        entry.write(builder)
    encoded: bytes = builder.end()
    return encoded


class McapWriter:
    """New MCAP file that takes messages and is complete after every commit.

    `library` is the name and version of the writer. Raises `BagError` if the file exists, or
    cannot be created or written.
    """

    def __init__(self, path: Path, library: str) -> None:
        self.statistics = records.Statistics(
            attachment_count=0, channel_count=0, channel_message_counts={}, chunk_count=0,
            message_count=0, message_start_time=0, message_end_time=0, metadata_count=1,
            schema_count=0,
        )
        """Numbers and times of the messages, committed or not, as the file stores them."""
        self._schemas: dict[str, records.Schema] = {}
        self._channels: list[records.Channel] = []
        # Index records of the chunks on disk, encoded once: a long recording has thousands.
        self._chunk_indexes = b""
        self._definitions = RecordBuilder()
        self._messages = RecordBuilder()
        self._pending: dict[int, list[tuple[int, int]]] = {}
        self._path = path
        self._end = 0
        self._tail = b""
        try:
            self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
        except OSError as error:
            raise BagError(path, f"cannot be created: {error.strerror}") from error
        try:
            header = records.Header(profile="ros2", library=library)
            self._write(MCAP0_MAGIC + _encode(header), b"")
        except BagError:
            self.close()
            raise

    @property
    def pending(self) -> int:
        """Size of the messages that are not committed yet [bytes]."""
        size: int = self._messages.count
        return size

    def add_channel(
        self, topic: str, msgtype: str, definition: str, metadata: dict[str, str]
    ) -> int:
        """Add a topic, with the definition of its message type; return its channel."""
        schema = self._schemas.get(msgtype)
        if schema is None:
            schema = records.Schema(
                id=len(self._schemas) + 1, name=msgtype, encoding="ros2msg",
                data=definition.encode(),
            )
            self._schemas[msgtype] = schema
            schema.write(self._definitions)
        channel = records.Channel(
            id=len(self._channels) + 1, topic=topic, message_encoding="cdr", metadata=metadata,
            schema_id=schema.id,
        )
        self._channels.append(channel)
        channel.write(self._definitions)
        self.statistics.channel_message_counts[channel.id] = 0
        self.statistics.channel_count = len(self._channels)
        self.statistics.schema_count = len(self._schemas)
        return channel.id

    def add_message(self, channel: int, stamp: int, data: bytes) -> None:
        """Add a message in CDR with a log time [ns] to the chunk in progress."""
        total = self.statistics
        self._pending.setdefault(channel, []).append((stamp, self._messages.count))
        records.Message(
            channel_id=channel, log_time=stamp, publish_time=stamp, data=data,
            sequence=total.channel_message_counts[channel],
        ).write(self._messages)
        first = not total.message_count
        total.message_start_time = stamp if first else min(total.message_start_time, stamp)
        total.message_end_time = stamp if first else max(total.message_end_time, stamp)
        total.channel_message_counts[channel] += 1
        total.message_count += 1

    def commit(self, metadata: str) -> None:
        """Write everything added so far, with this metadata of the bag in the form of rosbag2.

        Raises
        ------
        BagError
            If the disk is full or fails; the file then has the content of the commit before.
        """
        body: bytes = self._definitions.end()
        if self._pending:
            body += self._chunk(self._end + len(body))
        self._write(body, self._make_tail(self._end + len(body), metadata))

    def close(self) -> None:
        """Close the file; its content is that of the last commit."""
        os.close(self._file)

    def _write(self, body: bytes, tail: bytes) -> None:
        """Append to the body of the file, over its tail, and add a new tail."""
        try:
            position, rest = self._end, memoryview(body + tail)
            while rest:  # once, unless the disk accepts less
                written = os.pwrite(self._file, rest, position)
                position, rest = position + written, rest[written:]
        except OSError as error:
            # The blocks of the old tail are still allocated, so that a full disk has space for
            # it; a device that fails or was removed accepts nothing.
            with contextlib.suppress(OSError):
                os.ftruncate(self._file, self._end + len(self._tail))
                os.pwrite(self._file, self._tail, self._end)
            raise BagError(self._path, f"cannot be written: {error.strerror}") from error
        self._end += len(body)
        self._tail = tail

    def _chunk(self, position: int) -> bytes:
        """Encode the pending messages for `position` of the file, and extend the index."""
        raw = self._messages.end()
        packed = zstandard.compress(raw)
        stamps = [stamp for entries in self._pending.values() for stamp, _ in entries]
        start, end = min(stamps), max(stamps)
        chunk = _encode(records.Chunk(
            compression=_COMPRESSION, data=packed, message_start_time=start,
            message_end_time=end, uncompressed_crc=zlib.crc32(raw), uncompressed_size=len(raw),
        ))
        indexes, offsets = b"", {}
        for channel, entries in self._pending.items():
            offsets[channel] = position + len(chunk) + len(indexes)
            indexes += _encode(records.MessageIndex(channel_id=channel, records=entries))
        self._chunk_indexes += _encode(records.ChunkIndex(
            chunk_length=len(chunk), chunk_start_offset=position, compression=_COMPRESSION,
            compressed_size=len(packed), message_start_time=start, message_end_time=end,
            message_index_length=len(indexes), message_index_offsets=offsets,
            uncompressed_size=len(raw),
        ))
        self.statistics.chunk_count += 1
        self._pending = {}
        return chunk + indexes

    def _make_tail(self, position: int, metadata: str) -> bytes:
        """Encode metadata, index and footer for `position` of the file."""
        name = "rosbag2"
        record = _encode(records.Metadata(name=name, metadata={"serialized_metadata": metadata}))
        index = records.MetadataIndex(offset=position, length=len(record), name=name)
        record += _encode(records.DataEnd(data_section_crc=0))
        start = position + len(record)
        summary, offsets = b"", []
        for opcode, group in (
            (Opcode.SCHEMA, _encode(*self._schemas.values())),
            (Opcode.CHANNEL, _encode(*self._channels)),
            (Opcode.STATISTICS, _encode(self.statistics)),
            (Opcode.CHUNK_INDEX, self._chunk_indexes),
            (Opcode.METADATA_INDEX, _encode(index)),
        ):
            if group:
                offsets.append(records.SummaryOffset(opcode, start + len(summary), len(group)))
            summary += group
        offsets_at = start + len(summary)
        summary += _encode(*offsets)
        # The checksum covers the footer up to its own four bytes at the end.
        unsigned = _encode(records.Footer(start, offsets_at, 0))[:-4]
        footer = _encode(records.Footer(start, offsets_at, zlib.crc32(summary + unsigned)))
        return record + summary + footer + MCAP0_MAGIC
