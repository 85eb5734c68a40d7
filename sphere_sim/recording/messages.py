# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Messages of a bag of whatever kind: MCAP or SQLite, split, compressed, whole or broken off."""

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
from sphere_sim.recording.storage import Storage, Wanted, read_storage


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
    broken : bool
        Whether there may be less than was recorded.
    """

    types: dict[str, str] = field(default_factory=dict)
    taken: dict[str, list[tuple[int, Any]]] = field(default_factory=dict)
    custom_data: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    broken: bool = False


def read_messages(path: Path, wanted: Wanted) -> Messages:
    """Read a bag.

    Parameters
    ----------
    path : Path
        Folder with or without ``metadata.yaml``, or a single ``.mcap`` or ``.db3`` file, each of
        them also with ``.zstd`` behind.
    wanted : callable
        Tells from topic and message type whether to decode the messages.

    Returns
    -------
    Messages

    Raises
    ------
    BagError
        If there is no bag, nothing in it can be read, or it is several.
    """
    bag = find_files(path)
    messages = Messages(notes=bag.notes)
    storages = [_read(path, file, wanted) for file in bag.files]
    for file, storage in zip(bag.files, storages, strict=True):
        if storage.problem:
            read = f"; {storage.count} messages before that were read" if storage.count else ""
            messages.notes.append(f"{file.name} {storage.problem}{read}")
        messages.broken |= bool(storage.problem)
        messages.types.update(storage.types)
        messages.custom_data.update(storage.custom_data)
    messages.custom_data.update(bag.custom_data)
    if messages.broken and not messages.types:
        problems = "; ".join(messages.notes)
        raise BagError(path, f"nothing can be read of it: {problems}")
    if not bag.described:
        _refuse_overlap(path, bag, storages)
    _decode(messages, storages)
    return messages


def _read(path: Path, file: Path, wanted: Wanted) -> Storage:
    try:
        return read_storage(file, wanted)
    except OSError as error:
        raise BagError(path, f"{file.name} cannot be read: {error.strerror or error}") from error


def _refuse_overlap(path: Path, bag: BagFiles, storages: list[Storage]) -> None:
    """Refuse files that were not written one after the other, so not by one recorder."""
    last = float("-inf")
    for file, storage in zip(bag.files, storages, strict=True):
        if storage.messages:
            # Some messages are late, or repeated for the new file; most of them are in order.
            early, middle = np.percentile([stamp for _, stamp, _ in storage.messages], (10, 50))
            if early < last:
                raise BagError(
                    path, f"{file.name} and the file before it were recorded at the same time, so "
                    "are of different bags, and no metadata.yaml tells which; give one of them"
                )
            last = float(middle)


def _decode(messages: Messages, storages: list[Storage]) -> None:
    """Decode what was taken, in order of log time."""
    decode = _Decoder()
    raw = [entry for storage in storages for entry in storage.messages]
    # Recorders that compress messages in several threads write them in any order.
    for topic, stamp, data in sorted(raw, key=lambda entry: entry[1]):
        decoded = decode(data, messages.types[topic])
        if decoded is not None:
            messages.taken.setdefault(topic, []).append((stamp, decoded))
    messages.notes.extend(decode.notes())


class _Decoder:
    """Decodes messages, and counts those it cannot."""

    def __init__(self) -> None:
        self._store = get_typestore(Stores.ROS2_JAZZY)
        self._zstd = zstandard.ZstdDecompressor()
        self._broken: Counter[str] = Counter()

    def __call__(self, data: bytes, msgtype: str) -> Any:
        """Return a message, None if it is broken."""
        try:
            if data.startswith(zstandard.FRAME_HEADER):
                # The bag compresses messages one by one; CDR begins with other bytes.
                data = self._zstd.decompressobj().decompress(data)
            return self._store.deserialize_cdr(data, msgtype)
        except (SerdeError, zstandard.ZstdError, ValueError, IndexError, KeyError, struct.error):
            self._broken[msgtype] += 1
            return None

    def notes(self) -> list[str]:
        """Say what could not be decoded."""
        return [f"{n} messages of type {name} are broken" for name, n in self._broken.items()]
