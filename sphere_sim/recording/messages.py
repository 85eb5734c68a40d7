# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Decoded messages of a bag: MCAP or SQLite, split, compressed, complete or truncated."""

import struct
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import zstandard
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_typestore

from sphere_sim.recording.bag_files import BagFiles, find_files
from sphere_sim.recording.errors import BagError
from sphere_sim.recording.storage import Storage, TopicFilter, read_storage


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
    if not bag.described:
        _refuse_overlap(path, bag, storages)
    _decode(messages, storages)
    return messages


def _read(path: Path, file: Path, selects: TopicFilter) -> Storage:
    try:
        return read_storage(file, selects)
    except OSError as error:
        raise BagError(path, f"{file.name} cannot be read: {error.strerror or error}") from error


def _refuse_overlap(path: Path, bag: BagFiles, storages: list[Storage]) -> None:
    """Raise if two files were recorded at the same time, so not by one recorder."""
    last = float("-inf")
    for file, storage in zip(bag.files, storages, strict=True):
        if storage.messages:
            # A few messages are late, or repeated for the new file; most are in order.
            early, middle = np.percentile([stamp for _, stamp, _ in storage.messages], (10, 50))
            if early < last:
                raise BagError(
                    path, f"{file.name} and the file before it were recorded at the same time, so "
                    "they are of different bags, and no metadata.yaml lists the files of one; "
                    "give one of the files"
                )
            last = float(middle)


def _decode(messages: Messages, storages: list[Storage]) -> None:
    """Decode the selected messages in order of log time."""
    decoder = _Decoder()
    raw = [entry for storage in storages for entry in storage.messages]
    # Recorders that compress messages in several threads write them in any order.
    for topic, stamp, data in sorted(raw, key=lambda entry: entry[1]):
        message = decoder.decode(data, messages.types[topic])
        if message is not None:
            messages.decoded.setdefault(topic, []).append((stamp, message))
    messages.notes.extend(decoder.notes())


class _Decoder:
    """Decoder that counts the messages it cannot decode."""

    def __init__(self) -> None:
        self._store = get_typestore(Stores.ROS2_JAZZY)
        self._zstd = zstandard.ZstdDecompressor()
        self._invalid: Counter[str] = Counter()

    def decode(self, data: bytes, msgtype: str) -> Any:
        """Return a message; None if it is invalid."""
        try:
            if data.startswith(zstandard.FRAME_HEADER):
                # The bag compresses each message; CDR data never begins with these bytes.
                data = self._zstd.decompressobj().decompress(data)
            return self._store.deserialize_cdr(data, msgtype)
        except (SerdeError, zstandard.ZstdError, ValueError, IndexError, KeyError, struct.error):
            self._invalid[msgtype] += 1
            return None

    def notes(self) -> list[str]:
        """Return one note for each message type with invalid messages."""
        return [f"{n} messages of type {name} are invalid" for name, n in self._invalid.items()]
