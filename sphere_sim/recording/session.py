# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Recording session: the consecutive bags of one recorder, and the log times of their messages."""

import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

from rosbags.interfaces import Qos

from sphere_nmpc.errors import InvalidInputError, shown
from sphere_nmpc.reporting.fault_log import FaultLog
from sphere_nmpc.ros.cdr import clock_stamp
from sphere_sim.recording.bag_files import BagError
from sphere_sim.recording.bag_writer import BagWriter

_KEPT = 2
"""Messages of a topic that are kept until the clock has a time for them: a simulator publishes the
state of its first step before the clock reports that step."""


class RecordingSession:
    """Bags that are started and stopped, and messages that are written into the one in progress.

    `output` is the folder of the first bag, see `RecorderSettings`; later ones have a number
    appended. The newest value of `clock_topic` is the log time of all messages; where it is empty,
    they have their times of arrival. `offered_qos` returns the quality of service that the
    publishers of a topic offer, `fault_log` gets what cannot be recorded, and `fail` is called
    with one line about a failed recording.
    """

    def __init__(
        self, output: str, clock_topic: str, offered_qos: Callable[[str], Sequence[Qos]],
        fault_log: FaultLog, fail: Callable[[str], object],
    ) -> None:
        self.received: set[str] = set()
        """Topics with at least one message."""
        self.refused: set[str] = set()
        """Topics that cannot be recorded."""
        self._output = output
        self._clock_topic = clock_topic
        self._offered_qos = offered_qos
        self._fault_log = fault_log
        self._fail = fail
        self._bag: BagWriter | None = None
        self._started = 0
        self._types: dict[str, str] = {}
        self._latched: dict[str, bytes | None] = {}
        self._early: dict[str, deque[bytes]] = {}
        self._simulated_time = 0

    @property
    def folder(self) -> Path | None:
        """Folder of the bag in progress; None while nothing is recorded."""
        return None if self._bag is None else self._bag.folder

    def set_topic(self, topic: str, msgtype: str, latched: bool) -> None:
        """Register the message type of a topic, and whether its publishers keep messages.

        The last message of a latched topic is written into each bag that is started later.
        """
        self._types[topic] = msgtype
        if latched:
            self._latched.setdefault(topic, None)
        else:
            self._latched.pop(topic, None)

    def refuse(self, topic: str, reason: str) -> None:
        """Record no messages of a topic."""
        self.refused.add(topic)
        self._fault_log.report(f"{shown(topic)} is not recorded", reason)

    def add_to_bag(self, topic: str) -> bool:
        """Add a registered topic to the bag in progress; return whether the bag has it."""
        bag, msgtype = self._bag, self._types.get(topic)
        if bag is None or msgtype is None or topic in self.refused:
            return False
        if topic not in bag.topics:
            if not bag.supports(msgtype):
                self.refuse(topic, f"the definition of {shown(msgtype)} is not known")
                return False
            bag.add_topic(topic, msgtype, self._offered_qos(topic))
        return True

    def write(self, messages: Iterable[tuple[int, str, bytes]]) -> None:
        """Write messages of registered topics in order of arrival.

        Each has a time of arrival [ns; system clock], a topic, and the message in CDR.
        """
        for arrival, topic, message in sorted(messages, key=lambda entry: entry[0]):
            if topic == self._clock_topic:
                try:
                    self._simulated_time = clock_stamp(message)
                except InvalidInputError as error:
                    self._fault_log.report(f"{topic} refused", str(error))
                    continue
            self._write(topic, message, self._simulated_time if self._clock_topic else arrival)

    def commit(self) -> None:
        """Write all messages so far to disk."""
        if self._bag is not None:
            try:
                self._bag.commit()
            except BagError as error:
                self._abort(error)

    def start(self) -> Path:
        """Start a new bag and return its folder; raises as `BagWriter`."""
        output = self._output or time.strftime("runs/%Y-%m-%d_%H-%M-%S")
        folder = Path(output).expanduser().absolute()
        if self._started:
            folder = folder.with_name(f"{folder.name}_{self._started}")
        self._bag = BagWriter(folder)
        self._started += 1
        self._early = {
            topic: deque((message,), _KEPT)
            for topic, message in self._latched.items() if message is not None
        }
        return self._bag.folder

    def stop(self) -> str:
        """Close the bag in progress; return a summary of it, empty if there is none."""
        bag, self._bag = self._bag, None
        if bag is None:
            return ""
        try:
            bag.close()
        except BagError as error:
            self._fail(f"the last messages are lost: {error}")
        return f"{bag.message_count} messages on {len(bag.topics)} topics in {bag.folder}"

    def add_custom_data(self, values: Mapping[str, str]) -> None:
        """Add custom data to the bag in progress."""
        if self._bag is not None:
            self._bag.custom_data.update(values)

    def _write(self, topic: str, message: bytes, stamp: int) -> None:
        """Write a message; before the clock runs, keep the newest few of each topic instead."""
        self.received.add(topic)
        if topic in self._latched:
            self._latched[topic] = message
        if self._bag is None:
            return
        if stamp <= 0:
            self._early.setdefault(topic, deque(maxlen=_KEPT)).append(message)
            return
        early, self._early = self._early, {}
        try:
            for name, messages in (*early.items(), (topic, (message,))):
                for data in messages if self.add_to_bag(name) else ():
                    self._bag.write(name, stamp, data)
        except BagError as error:
            self._abort(error)

    def _abort(self, error: BagError) -> None:
        """Close a bag that can no longer be written; its last commit stays readable."""
        if self._bag is not None:
            self._bag.abandon()
            self._bag = None
            self._fail(f"recording stopped, {error}; what was recorded before is complete")
