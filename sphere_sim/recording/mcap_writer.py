# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Writer of MCAP files that are complete on disk after every commit.

The writers of the ``mcap`` and ``rosbags`` packages write index and footer once, at the end; a
process that is killed earlier leaves a file that most tools refuse. Here every commit writes the
new chunk with index and footer behind it, over the index and footer of the commit before.
"""

import zlib
from collections.abc import Mapping
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
from mcap.writer import MCAP0_MAGIC

from sphere_sim.recording.committed_file import CommittedFile

_COMPRESSION = "zstd"


def _encode(*records: McapRecord) -> bytes:
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    encoded: bytes = builder.end()
    return encoded


class McapWriter:
    """MCAP file that takes messages and is complete after every commit.

    Parameters
    ----------
    path : Path
        File to create; must not exist.
    library : str
        Name and version of the writer, stored in the header.

    Raises
    ------
    BagError
        If the file cannot be created or written.
    """

    def __init__(self, path: Path, library: str) -> None:
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
        header = MCAP0_MAGIC + _encode(Header(profile="ros2", library=library))
        self._file = CommittedFile(path, header)

    @property
    def pending(self) -> int:
        """Size of the messages that are not committed yet [bytes]."""
        size: int = self._messages.count
        return size

    @property
    def span(self) -> tuple[int, int] | None:
        """Times of the earliest and latest message [ns]; None without messages."""
        return self._span

    def add_channel(
        self, topic: str, msgtype: str, definition: str, metadata: Mapping[str, str]
    ) -> int:
        """Add a topic and return the identifier of its channel."""
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
        """Return the number of messages of a channel."""
        return self._counts[channel]

    def commit(self, metadata: Mapping[str, Mapping[str, str]]) -> None:
        """Write everything added so far, and leave a complete file on disk.

        Parameters
        ----------
        metadata : mapping of str to mapping of str to str
            Metadata records by name; they replace those of the commit before.

        Raises
        ------
        BagError
            If the file cannot be written; its content is then that of the commit before.
        """
        body: bytes = self._definitions.end()
        if self._offsets:
            body += self._chunk(self._file.end + len(body))
        self._file.commit(body, self._tail(self._file.end + len(body), metadata))

    def close(self) -> None:
        """Close the file; its content is that of the last commit."""
        self._file.close()

    def _chunk(self, position: int) -> bytes:
        """Encode the pending messages for `position` of the file, and update the index."""
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
        index_offsets = {}
        for channel, entries in self._offsets.items():
            index_offsets[channel] = position + len(chunk) + len(indexes)
            indexes += _encode(MessageIndex(channel_id=channel, records=entries))
        self._chunk_indexes += _encode(
            ChunkIndex(
                chunk_length=len(chunk),
                chunk_start_offset=position,
                compression=_COMPRESSION,
                compressed_size=len(packed),
                message_end_time=max(stamps),
                message_index_length=len(indexes),
                message_index_offsets=index_offsets,
                message_start_time=min(stamps),
                uncompressed_size=len(raw),
            )
        )
        self._chunks += 1
        self._offsets = {}
        return chunk + indexes

    def _tail(self, position: int, metadata: Mapping[str, Mapping[str, str]]) -> bytes:
        """Encode metadata, index and footer for `position` of the file."""
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
        # The checksum covers the footer up to its own four bytes at the end.
        unsigned = _encode(Footer(start, offsets_at, 0))[:-4]
        footer = _encode(Footer(start, offsets_at, zlib.crc32(summary + unsigned)))
        return records + summary + footer + MCAP0_MAGIC
