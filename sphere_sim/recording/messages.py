# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Decoded messages of a bag: MCAP or SQLite, split, compressed, complete or truncated."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from sphere_nmpc.errors import cut, shown
from sphere_nmpc.foreign.file import InvalidFileError
from sphere_sim.recording.bag_files import METADATA, OF_ROS_1, BagError, find_files
from sphere_sim.recording.storage_reader import StorageReader

TopicFilter = Callable[[str, str], bool]
"""Returns from topic and message type whether its messages are selected."""


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
    unread : str
        How many topics have messages in an encoding that is not read; empty where none has.
    truncated : bool
        Whether more may have been recorded than can be read.
    """

    path: Path
    types: dict[str, str] = field(default_factory=dict)
    decoded: dict[str, list[tuple[int, Any]]] = field(default_factory=dict)
    custom_data: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    unread: str = ""
    truncated: bool = False

    def recorded(self, msgtype: str) -> list[str]:
        """Return the topics with messages of a type, in alphabetical order."""
        return sorted(topic for topic in self.decoded if self.types[topic] == msgtype)

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
    reader = StorageReader(bag.files, selects)
    messages = Messages(path, reader.types, reader.decoded, reader.custom_data, bag.notes)
    for file in bag.files:
        before = reader.count
        try:
            problem = reader.read(file)
        except OSError as error:
            reason = f"{file.name} cannot be read: {error.strerror or error}"
            raise BagError(path, reason) from error
        except InvalidFileError as error:
            reason = f"{file.name} is {error.given}, expected {error.expected}"
            raise BagError(path, reason) from None
        if problem:
            count = reader.count - before
            read = f"; {count} messages before that were read" if count else ""
            messages.notes.append(f"{file.name} {problem}{read}")
            messages.truncated = True
    messages.custom_data.update(bag.custom_data)
    if not messages.truncated and bag.message_count not in ("", str(reader.count)):
        # As after a full disk; tools that show metadata.yaml alone do not know.
        messages.notes.append(
            f"{METADATA} counts {cut(bag.message_count, 20)} messages, the storage has "
            f"{reader.count}: all of these are read"
        )
    if messages.truncated and not messages.types:
        problems = "; ".join(messages.notes)
        raise BagError(path, f"nothing can be read of it: {problems}")
    if reader.unread:
        listed = ", ".join(f"{count} in {shown(name)}" for name, count in reader.unread.items())
        messages.unread = f"topics encoded otherwise than by ROS 2 (CDR): {listed}"
        if "ros1" in reader.unread:
            messages.unread += f"; {OF_ROS_1}"
        messages.notes.append(f"not read are {messages.unread}")
    messages.notes += [
        f"{number} messages of type {name} are invalid" for name, number in reader.invalid.items()
    ]
    for entries in messages.decoded.values():
        # Recorders that compress messages in several threads write them in any order.
        entries.sort(key=lambda entry: entry[0])
    return messages
