# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Bags open in independent readers at any moment, however their writer ended."""

import resource
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from sphere_sim.recording.bag_files import BagError
from sphere_sim.recording.bag_writer import BagWriter

TOPIC, KIND = "/flag", "std_msgs/msg/Bool"
TRUE = b"\x00\x01\x00\x00\x01"

def counts(folder: Path) -> tuple[int, int]:
    """Return the numbers of messages that two independent readers decode, with checksums."""
    with AnyReader([folder], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        of_rosbags = sum(
            reader.deserialize(raw, connection.msgtype).data
            for connection, _, raw in reader.messages()
        )
    with next(folder.glob("*.mcap")).open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        of_mcap = sum(message.data for *_, message in reader.iter_decoded_messages())
    return of_rosbags, of_mcap


def test_bag_is_complete_after_every_commit_and_grows_linearly(tmp_path) -> None:
    writer = BagWriter(tmp_path / "bag")
    writer.add_topic(TOPIC, KIND)
    for i in range(1, 101):
        writer.write(TOPIC, i, TRUE)
        writer.commit()
        if i in (1, 2, 100):
            assert counts(tmp_path / "bag") == (i, i)
    # Index and footer are rewritten each time: appended copies would add up quadratically.
    assert next((tmp_path / "bag").glob("*.mcap")).stat().st_size < 100 * 400
    writer.close()


def test_folder_that_exists_or_cannot_be_created_is_refused(tmp_path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(BagError, match="cannot be created: Not a directory"):
        BagWriter(tmp_path / "file" / "bag")
    with pytest.raises(BagError, match="exists already and is not overwritten"):
        BagWriter(tmp_path)


def test_disk_full_at_the_start_leaves_no_folder(tmp_path) -> None:
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (300, before[1]))
    try:
        with pytest.raises(BagError, match="cannot be written: File too large"):
            BagWriter(tmp_path / "bag")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert not (tmp_path / "bag").exists()
