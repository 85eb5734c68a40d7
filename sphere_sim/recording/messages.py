# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Messages of a bag of whatever kind: MCAP or SQLite, whole or broken off."""

import struct
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mcap.records import Channel, Message, Schema
from mcap.stream_reader import StreamReader
from rosbags.interfaces import MessageDefinitionFormat
from rosbags.rosbag2 import Reader
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore

from sphere_sim.recording.errors import BagError

_SUFFIXES = (".mcap", ".db3")


@dataclass
class Messages:
    """The messages of a bag, decoded.

    Attributes
    ----------
    types : dict of str to str
        Message type of each topic that the bag announces.
    taken : dict of str to list of (int, Any)
        For each topic that was asked for and has any: time of reception [ns] and message, in
        order of time.
    custom_data : dict of str to str
        What the recorder said about the run.
    notes : list of str
        What is amiss with the bag, for people.
    """

    types: dict[str, str] = field(default_factory=dict)
    taken: dict[str, list[tuple[int, Any]]] = field(default_factory=dict)
    custom_data: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


def read_messages(path: Path, wanted: Callable[[str, str], bool]) -> Messages:
    """Read a bag.

    Parameters
    ----------
    path : Path
        Folder with or without ``metadata.yaml``, or a single ``.mcap`` or ``.db3`` file.
    wanted : callable
        Tells from topic and message type whether to decode the messages.

    Returns
    -------
    Messages

    Raises
    ------
    BagError
        If there is no bag or nothing in it can be read.
    """
    if not path.exists():
        raise BagError(path, "there is no such file or folder")
    messages = Messages()
    files = _storage_files(path)
    whole = path.is_dir() and (path / "metadata.yaml").exists()
    if whole and _read_whole(path, messages, wanted, note=True):
        return _in_order(messages)
    if path.is_dir() and not whole:
        messages.notes.append("metadata.yaml is missing, the storage was read without it")
    for file in files:
        if not _read_whole(file, messages, wanted, note=False):
            if file.suffix != ".mcap":
                raise BagError(path, f"{file.name} cannot be read as a database")
            _salvage(path, file, messages, wanted)
    return _in_order(messages)


def _storage_files(path: Path) -> list[Path]:
    if path.is_file():
        if path.suffix not in _SUFFIXES:
            raise BagError(path, "is no bag: expected a folder, a .mcap or a .db3 file")
        return [path]
    files = sorted(file for file in path.iterdir() if file.suffix in _SUFFIXES)
    if not files:
        raise BagError(path, "is no bag: the folder holds no .mcap or .db3 file")
    return files


def _read_whole(
    path: Path, messages: Messages, wanted: Callable[[str, str], bool], *, note: bool
) -> bool:
    """Read a folder or file with its index; False, and nothing taken, if it has none."""
    try:
        with Reader(path) as reader:
            decode = _Decoder()
            connections = [
                connection
                for connection in reader.connections
                if wanted(connection.topic, connection.msgtype)
            ]
            for connection in connections:
                if connection.msgdef.format is MessageDefinitionFormat.MSG:
                    decode.learn(connection.msgtype, connection.msgdef.data)
            types = {connection.topic: connection.msgtype for connection in reader.connections}
            taken: list[tuple[str, int, Any]] = []
            # An empty selection would mean every connection.
            for connection, stamp, raw in reader.messages(connections) if connections else ():
                taken.append((connection.topic, stamp, decode(raw, connection.msgtype)))
            custom = getattr(reader.storage.metadata, "custom", None) or {}
    except Exception as error:
        # A damaged length or name makes the reader raise anything, from MemoryError to what a
        # decompressor has of its own; what it means is always the same.
        if note:
            reason = str(error).rstrip(".") or type(error).__name__
            messages.notes.append(f"not closed properly ({reason})")
        return False
    messages.types.update(types)
    messages.custom_data.update({str(key): str(value) for key, value in custom.items()})
    messages.notes.extend(decode.notes())
    for topic, stamp, decoded in taken:
        if decoded is not None:
            messages.taken.setdefault(topic, []).append((stamp, decoded))
    return True


def _salvage(
    path: Path, file: Path, messages: Messages, wanted: Callable[[str, str], bool]
) -> None:
    """Read what there is of an MCAP file that breaks off."""
    decode = _Decoder()
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    count = 0
    with file.open("rb") as stream:
        for record in _records(stream):
            if isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel) and record.schema_id in schemas:
                schema = schemas[record.schema_id]
                channels[record.id] = record
                messages.types[record.topic] = schema.name
                if wanted(record.topic, schema.name) and schema.encoding == "ros2msg":
                    decode.learn(schema.name, schema.data.decode(errors="replace"))
            elif isinstance(record, Message) and record.channel_id in channels:
                count += 1
                channel = channels[record.channel_id]
                msgtype = schemas[channel.schema_id].name
                if wanted(channel.topic, msgtype):
                    decoded = decode(record.data, msgtype)
                    if decoded is not None:
                        entry = (record.log_time, decoded)
                        messages.taken.setdefault(channel.topic, []).append(entry)
    if not channels:
        raise BagError(path, f"{file.name} is empty or broken before the first message")
    messages.notes.extend(decode.notes())
    messages.notes.append(f"{file.name} breaks off; {count} messages before that were read")


def _records(stream: Any) -> Iterator[Any]:
    """Yield the records of an MCAP stream up to where it breaks off."""
    try:
        yield from StreamReader(stream).records
    except Exception:
        # What a decompressor raises about half a chunk is its own affair.
        return


class _Decoder:
    """Decodes messages with the definitions that came with them, and counts those it cannot."""

    def __init__(self) -> None:
        self._store = get_typestore(Stores.ROS2_JAZZY)
        self._broken: Counter[str] = Counter()

    def learn(self, msgtype: str, definition: str) -> None:
        """Take in a message type that is not known yet."""
        known = self._store.types
        if msgtype in known:
            return
        try:
            fresh = get_types_from_msg(definition, msgtype)
            self._store.register({name: it for name, it in fresh.items() if name not in known})
        except (TypesysError, ValueError):
            self._broken[msgtype] += 1

    def __call__(self, data: bytes, msgtype: str) -> Any:
        """Return a message, None if it is broken."""
        try:
            return self._store.deserialize_cdr(data, msgtype)
        except (SerdeError, ValueError, IndexError, KeyError, struct.error):
            self._broken[msgtype] += 1
            return None

    def notes(self) -> list[str]:
        """Say what could not be decoded."""
        return [f"{n} messages of type {name} are broken" for name, n in self._broken.items()]


def _in_order(messages: Messages) -> Messages:
    for entries in messages.taken.values():
        entries.sort(key=lambda entry: entry[0])
    return messages
