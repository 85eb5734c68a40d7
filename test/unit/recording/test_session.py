# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Bags as they are written: at any moment readable, in sessions, and on a disk that is full."""

import contextlib
import resource
from collections.abc import Iterator
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from sphere_nmpc.reporting.fault_log import FaultLog
from sphere_nmpc.ros.cdr_messages import clock_message
from sphere_sim.recording.bag_files import BagError
from sphere_sim.recording.bag_writer import BagWriter
from sphere_sim.recording.session import RecordingSession

CLOCK, CLOCK_TYPE = "/clock", "rosgraph_msgs/msg/Clock"
FLAG, FLAG_TYPE = "/flag", "std_msgs/msg/Bool"
TRUE = b"\x00\x01\x00\x00\x01"
S = 1_000_000_000


@contextlib.contextmanager
def full_disk(size: int) -> Iterator[None]:
    """Let no file grow beyond a size [bytes]."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


class Recorded:
    """Session in a folder, with the lines it reports."""

    def __init__(self, folder: Path, clock_topic: str = "") -> None:
        self.warnings: list[str] = []
        self.failures: list[str] = []
        self.session = RecordingSession(
            str(folder), clock_topic, lambda topic: (), FaultLog(self.warnings.append),
            self.failures.append,
        )
        self.session.set_topic(CLOCK, CLOCK_TYPE, latched=False)
        self.session.set_topic(FLAG, FLAG_TYPE, latched=False)


def stamps(folder: Path, topic: str = FLAG) -> list[int]:
    """Return the log times of a topic [ns]."""
    with Reader(folder) as reader:
        return [stamp for it, stamp, _ in reader.messages() if it.topic == topic]


@pytest.fixture
def bag(tmp_path) -> Path:
    return tmp_path / "bag"


def test_log_time_is_simulated_and_that_of_the_last_two_before_it_is_its_first(bag) -> None:
    recorded = Recorded(bag, CLOCK)
    session = recorded.session
    session.start()
    session.write([(i, FLAG, TRUE) for i in range(5)])
    session.write([(6, CLOCK, clock_message(0))])
    session.commit()
    assert stamps(bag) == []
    session.write([(7, CLOCK, clock_message(4 * S)), (8, CLOCK, clock_message(5 * S))])
    # Neither of these is a time: it stays.
    session.write([(9, CLOCK, b"\x00\x01\x00\x00"), (10, CLOCK, clock_message(-5 * S))])
    session.write([(11, FLAG, TRUE)])
    session.stop()
    assert stamps(bag) == [4 * S, 4 * S, 5 * S] and stamps(bag, CLOCK)[-1] == 5 * S
    assert len(recorded.warnings) == 1
    assert recorded.warnings[0].startswith("/clock refused: Clock: given b'")


def test_latched_messages_are_repeated_in_a_later_bag_and_others_are_in_none(bag) -> None:
    session = Recorded(bag).session
    session.set_topic("/goal", FLAG_TYPE, latched=True)
    session.start()
    session.write([(2 * S, FLAG, TRUE), (1 * S, "/goal", TRUE)])
    assert session.stop() == f"2 messages on 2 topics in {bag}"
    session.write([(3 * S, FLAG, TRUE)])
    second = session.start()
    session.write([(5 * S, FLAG, TRUE), (4 * S, FLAG, TRUE)])
    session.stop()
    assert second == bag.with_name("bag_1")
    assert stamps(second, "/goal") == [4 * S] and stamps(second) == [4 * S, 5 * S]


def test_unknown_message_type_is_reported_once_and_the_rest_recorded(bag) -> None:
    recorded = Recorded(bag)
    recorded.session.set_topic("/odd", "odd_msgs/msg/Odd", latched=False)
    recorded.session.start()
    assert not recorded.session.add_to_bag("/odd")
    recorded.session.write([(1, "/odd", TRUE), (2, FLAG, TRUE), (3, "/odd", TRUE)])
    recorded.session.stop()
    assert recorded.warnings == [
        "'/odd' is not recorded: the definition of 'odd_msgs/msg/Odd' is not known"
    ]
    assert recorded.session.refused == {"/odd"} and stamps(bag) == [2]


def test_full_disk_ends_the_recording_with_one_line_and_a_readable_bag(bag) -> None:
    recorded = Recorded(bag)
    recorded.session.start()
    recorded.session.write([(1, FLAG, TRUE)])
    recorded.session.commit()
    size = next(bag.glob("*.mcap")).stat().st_size
    with full_disk(size + 300):
        recorded.session.write([(i * i * 7919, FLAG, TRUE) for i in range(2, 5000)])
        recorded.session.commit()
        recorded.session.commit()
    assert len(recorded.failures) == 1
    assert recorded.failures[0].startswith("recording stopped, bag ")
    assert recorded.session.folder is None and stamps(bag) == [1]
    restarted = recorded.session.start()
    recorded.session.write([(2, FLAG, TRUE)])
    recorded.session.stop()
    assert stamps(restarted) == [2]


@pytest.mark.parametrize("end", ["commit", "stop"])
def test_metadata_that_cannot_be_written_leaves_the_messages_that_it_counts(bag, end) -> None:
    recorded = Recorded(bag)
    recorded.session.start()
    recorded.session.write([(1, FLAG, TRUE)])
    recorded.session.commit()
    (bag / ".metadata.part.yaml").mkdir()
    recorded.session.write([(2, FLAG, TRUE)])
    getattr(recorded.session, end)()
    assert len(recorded.failures) == 1 and "cannot be written" in recorded.failures[0]
    with Reader(bag) as reader:
        assert reader.message_count == len(stamps(bag)) == 1


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
    writer.add_topic(FLAG, FLAG_TYPE)
    for i in range(1, 101):
        writer.write(FLAG, i, TRUE)
        writer.commit()
        if i in (1, 2, 100):
            assert counts(tmp_path / "bag") == (i, i)
    # Index and footer are rewritten each time: appended copies would add up quadratically.
    assert next((tmp_path / "bag").glob("*.mcap")).stat().st_size < 100 * 400
    writer.close()


def test_folder_that_cannot_be_used_is_refused_and_none_is_left_on_a_full_disk(tmp_path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(BagError, match="cannot be created: Not a directory"):
        BagWriter(tmp_path / "file" / "bag")
    with pytest.raises(BagError, match="exists already and is not overwritten"):
        BagWriter(tmp_path)
    with full_disk(300), pytest.raises(BagError, match="cannot be written: File too large"):
        BagWriter(tmp_path / "bag")
    assert not (tmp_path / "bag").exists()
