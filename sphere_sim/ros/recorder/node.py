# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Node ``recorder``: writes topics to a rosbag2 bag that survives whatever ends the process.

Subscribes to every topic that matches its parameter ``topics``, as it appears, with the quality
of service its publishers offer. Messages are stamped with their arrival: on the system's clock,
or with ``use_sim_time`` by the newest /clock that had arrived before them, which is then recorded
in any case.

Parameters: ``output``, ``topics``, ``record_on_start``, ``commit_period``.
Services: ``~/start``, ``~/stop``, ``~/is_recording`` (std_srvs/Trigger).
"""

import struct
import time
from collections import deque
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.executors import Executor
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.subscription import Subscription
from std_srvs.srv import Trigger

from sphere_nmpc.fault_log import FaultLog
from sphere_nmpc.ros.lifetime import LivingNode, run
from sphere_nmpc.ros.parameters import DeclaredSettings, warn_of_unknown
from sphere_nmpc.ros.watch import Watch
from sphere_sim.recording.bag_writer import BagWriter
from sphere_sim.recording.errors import BagError
from sphere_sim.recording.recorder_settings import RecorderSettings
from sphere_sim.recording.topics import (
    DEFAULT_TOPICS,
    KNOWN_TYPES,
    LATCHED,
    absolute,
    is_wanted,
)
from sphere_sim.ros.recorder.parameter_snapshots import ParameterSnapshots
from sphere_sim.ros.recorder.qos import fitting_qos, qos_for_bag, same_demand

_DISCOVERY_PERIOD = 0.2
"""Wall time between two looks at the graph [s]."""
_KEPT = 2
"""Messages of a topic that are kept until there is a time to stamp them with: a simulator sends
the state of the first step before the clock says that there was one."""
_CDR_HEADER = 4
"""Bytes before the first field of a serialised message; the second tells the byte order."""
_GATHERING = 5e-3
"""Wall time between two rounds of taking what has arrived [s]."""


class Listening(NamedTuple):
    """How a topic is listened to."""

    subscription: Subscription
    message_class: type
    qos: QoSProfile
    msgtype: str


class RecorderNode(LivingNode):
    """Record topics; see the module for its interface.

    Raises
    ------
    BagError
        If the bag to start with cannot be made.
    InvalidParameterError
        If a parameter is wrong.
    """

    def __init__(self) -> None:
        super().__init__("recorder", automatically_declare_parameters_from_overrides=True)
        declared = DeclaredSettings(self, RecorderSettings())
        self._settings = declared.settings
        self._clock_topic = self.resolve_topic_name("/clock")
        self._patterns = self._declare_topics()
        warn_of_unknown(self, [*declared.names, "topics"])
        self._watch = Watch(self, FaultLog(lambda line: self.get_logger().warning(line)))
        self._bag: BagWriter | None = None
        self._started = 0
        self._subscribed: dict[str, Listening] = {}
        self._inbox: list[tuple[int, str, bytes]] = []
        self._waiting: dict[str, deque[bytes]] = {}
        self._latched: dict[str, bytes] = {}
        self._refused: set[str] = set()
        self._heard: set[str] = set()
        self._snapshots = ParameterSnapshots(self)
        self._simulates = bool(self.get_parameter("use_sim_time").value)
        self._simulated = 0
        if self._simulates and not is_wanted(self._clock_topic, self._patterns):
            self._patterns.append(self._clock_topic)
        for name, msgtype in KNOWN_TYPES.items():
            topic = self._full_name(name)
            if is_wanted(topic, self._patterns):
                self._subscribe(topic, msgtype, fitting_qos((), name in LATCHED))
        if self._settings.record_on_start:
            self._start()
        # Discovery and disk must not stop when simulated time does.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(_DISCOVERY_PERIOD, self._discover, clock=steady)
        self.create_timer(self._settings.commit_period, self._commit, clock=steady)
        self.create_service(Trigger, "~/start", self._on_start)
        self.create_service(Trigger, "~/stop", self._on_stop)
        self.create_service(Trigger, "~/is_recording", self._on_is_recording)

    def finish(self) -> None:
        """Write what has arrived and close the bag."""
        self._drain()
        self._stop()

    def _declare_topics(self) -> list[str]:
        name, given = "topics", None
        if self.has_parameter(name):
            given = self.get_parameter(name).value
            self.undeclare_parameter(name)
        about = ParameterDescriptor(
            description="Topics to record; * stands for anything, names without a slash in "
            "front are in the node's namespace",
            read_only=True,
        )
        topics = [str(topic) for topic in given or DEFAULT_TOPICS]
        self.declare_parameter(name, topics, about, ignore_override=True)
        return [self._full_name(topic) for topic in topics]

    def _full_name(self, topic: str) -> str:
        """Return a topic or pattern as it is in the graph; a robot in a namespace has a clock."""
        return self._clock_topic if topic == "/clock" else absolute(topic, self.get_namespace())

    def _discover(self) -> None:
        """Subscribe to what is new and adapt to what the publishers offer."""
        own = self.get_fully_qualified_name()
        # With a second clock or pose a recording has no figures.
        self._watch.update(self._watch.rivals(clocked=self._simulates))
        for topic, msgtypes in self.get_topic_names_and_types():
            if not is_wanted(topic, self._patterns):
                continue
            publishers = self.get_publishers_info_by_topic(topic)
            if not publishers:
                continue
            msgtype = publishers[0].topic_type if len(msgtypes) > 1 else msgtypes[0]
            offered = [publisher.qos_profile for publisher in publishers]
            self._subscribe(topic, msgtype, fitting_qos(offered))
            self._announce(topic)
            for publisher in publishers:
                node = f"{publisher.node_namespace.rstrip('/')}/{publisher.node_name}"
                if node != own:
                    self._snapshots.ask(node)
        if self._bag is not None:
            self._bag.custom_data.update(self._snapshots.as_text())

    def _subscribe(self, topic: str, msgtype: str, qos: QoSProfile) -> None:
        there = self._subscribed.get(topic)
        same = there is not None and there.msgtype == msgtype and same_demand(there.qos, qos)
        if same or topic in self._refused:
            return
        package, _, name = msgtype.split("/")
        try:
            message_class = getattr(import_module(f"{package}.msg"), name)
        except (ImportError, AttributeError):
            self._refuse(topic, f"message type {msgtype} is not installed")
            return
        if there is not None:
            self.destroy_subscription(there.subscription)

        def take(data: bytes, about: Any) -> None:
            self._inbox.append((about["received_timestamp"], topic, bytes(data)))

        # rclpy hands information about a message to callbacks of two arguments, untyped.
        callback: Any = take
        subscription = self.create_subscription(message_class, topic, callback, qos, raw=True)
        self._subscribed[topic] = Listening(subscription, message_class, qos, msgtype)

    def _refuse(self, topic: str, reason: str) -> None:
        self._refused.add(topic)
        self.get_logger().warning(f"{topic} is not recorded: {reason}")

    def work(self, executor: Executor) -> None:
        """Serve timers, services and whatever has arrived on the topics."""
        executor.spin_once()
        self._drain()
        # A round of the executor costs some 0.3 ms however little it finds: let messages gather.
        time.sleep(_GATHERING)

    def _drain(self) -> None:
        """Write everything that has arrived, in order of its arrival."""
        for topic, listening in self._subscribed.items():
            handle = listening.subscription.handle
            with handle:
                while (taken := handle.take_message(listening.message_class, True)) is not None:
                    self._inbox.append((taken[1]["received_timestamp"], topic, bytes(taken[0])))
        inbox, self._inbox = self._inbox, []
        for arrival, topic, message in sorted(inbox, key=lambda entry: entry[0]):
            if topic == self._clock_topic:
                self._simulated = stamp_in_clock(message)
            self._write(topic, message, self._simulated if self._simulates else arrival)

    def _write(self, topic: str, message: bytes, stamp: int) -> None:
        """Write a message; before the clock runs, keep the newest few of each topic instead."""
        self._heard.add(topic)
        if self._subscribed[topic].qos.durability is DurabilityPolicy.TRANSIENT_LOCAL:
            self._latched[topic] = message
        if self._bag is None:
            return
        if stamp <= 0:
            self._waiting.setdefault(topic, deque(maxlen=_KEPT)).append(message)
            return
        waiting, self._waiting = self._waiting, {}
        try:
            for name, several in (*waiting.items(), (topic, (message,))):
                for data in several if self._announce(name) else ():
                    self._bag.write(name, stamp, data)
        except BagError as error:
            self._give_up(error)

    def _announce(self, topic: str) -> bool:
        """Enter a topic in the bag with what its publishers offer; False if that cannot be."""
        bag, known = self._bag, self._subscribed.get(topic)
        if bag is None or known is None or topic in self._refused:
            return False
        if topic not in bag.topics:
            if not bag.knows(known.msgtype):
                self._refuse(topic, f"the definition of {known.msgtype} is not known")
                return False
            publishers = self.get_publishers_info_by_topic(topic)
            offered = [qos_for_bag(publisher.qos_profile) for publisher in publishers]
            bag.add_topic(topic, known.msgtype, offered)
        return True

    def _commit(self) -> None:
        if self._bag is not None:
            try:
                self._bag.commit()
            except BagError as error:
                self._give_up(error)

    def _give_up(self, error: BagError) -> None:
        """Say once that the disk takes no more; what is there stays readable."""
        if self._bag is not None:
            self._bag.abandon()
            self._bag = None
            self.get_logger().error(
                f"recording stopped, {error}; what was recorded before is complete"
            )

    def _start(self) -> str:
        """Start a new bag and return its folder."""
        self._bag = BagWriter(self._folder())
        self._started += 1
        self._waiting = {topic: deque((data,)) for topic, data in self._latched.items()}
        self._bag.custom_data.update(self._snapshots.as_text())
        self.get_logger().info(f"recording to {self._bag.folder}")
        return str(self._bag.folder)

    def _folder(self) -> Path:
        given = self._settings.output or time.strftime("runs/%Y-%m-%d_%H-%M-%S")
        folder = Path(given).expanduser().absolute()
        return folder.with_name(f"{folder.name}_{self._started}") if self._started else folder

    def _stop(self) -> str:
        bag, self._bag = self._bag, None
        if bag is None:
            return "was not recording"
        try:
            bag.close()
        except BagError as error:
            self.get_logger().error(f"the last moments are lost: {error}")
        told = f"{bag.message_count} messages on {len(bag.topics)} topics in {bag.folder}"
        self.get_logger().info(f"recorded {told}")
        return told

    def _on_start(self, request: Trigger.Request, answer: Trigger.Response) -> Trigger.Response:
        if self._bag is not None:
            answer.message = f"already recording to {self._bag.folder}"
            return answer
        try:
            answer.message = self._start()
            answer.success = True
        except BagError as error:
            answer.message = str(error)
        return answer

    def _on_stop(self, request: Trigger.Request, answer: Trigger.Response) -> Trigger.Response:
        answer.success = self._bag is not None
        answer.message = self._stop()
        return answer

    def _on_is_recording(
        self, request: Trigger.Request, answer: Trigger.Response
    ) -> Trigger.Response:
        """Answer with the folder, then for each topic whether it was heard or awaits a message."""
        answer.success = self._bag is not None
        folder = "not recording" if self._bag is None else str(self._bag.folder)
        matched = [
            topic for topic, listening in self._subscribed.items()
            if topic not in self._heard and listening.subscription.get_publisher_count() > 0
        ]
        lines = [*(f"heard {t}" for t in self._heard), *(f"matched {t}" for t in matched)]
        answer.message = "\n".join((folder, *sorted(lines)))
        return answer


def stamp_in_clock(message: bytes) -> int:
    """Return the time [ns] in a serialised rosgraph_msgs/Clock."""
    order = "<" if message[1] & 1 else ">"
    seconds, nanoseconds = struct.unpack_from(f"{order}iI", message, _CDR_HEADER)
    return int(seconds) * 1_000_000_000 + int(nanoseconds)


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; see the module."""
    return run(RecorderNode, args, __doc__ or "")
