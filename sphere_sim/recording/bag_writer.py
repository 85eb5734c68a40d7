# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Writer of rosbag2 folders (metadata.yaml of version 9, one MCAP file) that survive a crash."""

import errno
import io
import shutil
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rosbags.interfaces import Qos
from rosbags.rosbag2.metadata import dump_qos_v9
from rosbags.typesys import Stores, get_typestore
from ruamel.yaml import YAML

from sphere_nmpc import __version__
from sphere_sim.output.files import replacing
from sphere_sim.recording.bag_files import METADATA, BagError
from sphere_sim.recording.mcap_writer import McapWriter

_LIBRARY = f"sphere_nmpc {__version__}"
_LARGEST_CHUNK = 1 << 20
"""Size from which on pending messages are committed immediately [bytes]."""


def _dump_yaml(value: Any) -> str:
    """Return `value` as YAML in the block style of rosbag2."""
    yaml = YAML(typ="safe")
    yaml.default_flow_style = False
    yaml.width = 4096
    stream = io.StringIO()
    yaml.dump(value, stream)
    return stream.getvalue().strip()


class BagWriter:
    """New bag in a new folder that takes serialised messages and is complete after every commit.

    Raises
    ------
    BagError
        If the folder exists or cannot be written.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.custom_data: dict[str, str] = {"sphere_nmpc_version": __version__}
        """Custom data that every commit stores."""
        self._typestore = get_typestore(Stores.ROS2_JAZZY)
        # Entry of each topic in metadata.yaml as text: it never changes and is slow to dump.
        self._topics: dict[str, str] = {}
        self._channels: dict[str, int] = {}
        try:
            folder.mkdir(parents=True)
        except OSError as error:
            reason = "exists already and is not overwritten; choose another folder"
            if error.errno != errno.EEXIST:
                reason = f"cannot be created: {error.strerror}"
            raise BagError(folder, reason) from error
        try:
            self._file = McapWriter(folder / f"{folder.name}_0.mcap", _LIBRARY)
            try:
                self.commit()
            except BagError:
                self._file.close()
                raise
        except BagError:
            # A folder that is left behind would block the next recording.
            shutil.rmtree(folder, ignore_errors=True)
            raise

    @property
    def topics(self) -> tuple[str, ...]:
        """Names of the topics of the bag."""
        return tuple(self._channels)

    @property
    def message_count(self) -> int:
        """Number of messages written, committed or not."""
        return int(self._file.statistics.message_count)

    def supports(self, msgtype: str) -> bool:
        """Return whether the definition of a message type is known, as a bag needs it."""
        return msgtype in self._typestore.types

    def add_topic(self, name: str, msgtype: str, offered_qos: Sequence[Qos] = ()) -> None:
        """Add a topic of a type that is supported; without effect if the bag has it already.

        It has a full name, with the leading slash, a type as in ``geometry_msgs/msg/PoseStamped``
        and the quality of service that its publishers offer.
        """
        if name in self._channels:
            return
        definition, _ = self._typestore.generate_msgdef(msgtype, ros_version=2)
        digest = self._typestore.hash_rihs01(msgtype)
        qos = dump_qos_v9(list(offered_qos))
        about = {
            "name": name,
            "type": msgtype,
            "serialization_format": "cdr",
            "offered_qos_profiles": qos,
            "type_description_hash": digest,
        }
        self._topics[name] = textwrap.indent(_dump_yaml(about), "    ")
        self._channels[name] = self._file.add_channel(
            name, msgtype, definition,
            {"offered_qos_profiles": _dump_yaml(qos), "topic_type_hash": digest},
        )

    def write(self, topic: str, stamp: int, data: bytes) -> None:
        """Add a message in CDR, with its log time [ns], on a topic that was added before.

        Raises as `commit`, which may be due.
        """
        self._file.add_message(self._channels[topic], stamp, data)
        if self._file.pending > _LARGEST_CHUNK:
            self.commit()

    def commit(self) -> None:
        """Write all messages so far to disk; to be called about every second.

        Raises
        ------
        BagError
            If the disk is full or fails; the bag then has the content of the commit before.
        """
        information = self._information()
        text = f"rosbag2_bagfile_information:\n{textwrap.indent(information, '  ')}\n"
        try:
            # Both or neither: on a full disk there may be space for one of them alone.
            with replacing(self.folder / METADATA, text):
                self._file.commit(information)
        except OSError as error:
            raise BagError(self.folder, f"cannot be written: {error.strerror}") from error

    def close(self) -> None:
        """Commit and close the bag; it is closed also where that raises."""
        try:
            self.commit()
        finally:
            self._file.close()

    def abandon(self) -> None:
        """Close the file without a commit."""
        self._file.close()

    def _information(self) -> str:
        """Return the content of metadata.yaml as rosbag2 structures it."""
        total, name = self._file.statistics, f"{self.folder.name}_0.mcap"
        start = {"nanoseconds_since_epoch": total.message_start_time}
        duration = {"nanoseconds": total.message_end_time - total.message_start_time}
        head = _dump_yaml({
            "version": 9,
            "storage_identifier": "mcap",
            "relative_file_paths": [name],
            "duration": duration,
            "starting_time": start,
            "message_count": total.message_count,
            "compression_format": "",
            "compression_mode": "",
            "files": [{
                "path": name, "starting_time": dict(start), "duration": dict(duration),
                "message_count": total.message_count,
            }],
            "custom_data": dict(self.custom_data),
            "ros_distro": "jazzy",
        })
        if not self._topics:
            return f"{head}\ntopics_with_message_count: []"
        entries = (
            f"- message_count: {total.channel_message_counts[self._channels[topic]]}\n"
            f"  topic_metadata:\n{about}"
            for topic, about in self._topics.items()
        )
        return "\n".join((head, "topics_with_message_count:", *entries))
