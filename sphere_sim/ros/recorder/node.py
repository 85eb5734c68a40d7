# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Node ``recorder``: writes topics to a rosbag2 bag that is readable however the process ends.

Subscribes to every topic that matches its parameter ``topics`` as soon as it has a publisher, with
a quality of service that fits all publishers. The log time of a message is its time of arrival:
on the system clock, or with ``use_sim_time`` the newest /clock that arrived before it, which is
then always recorded. Where the messages of /tf are not installed, so that no node can publish it,
the recorder makes the transforms itself, see `frames`.

Parameters: ``output``, ``topics``, ``record_on_start``, ``commit_period``.
Services: ``~/start``, ``~/stop``, ``~/is_recording`` (std_srvs/Trigger).
"""

import json
import time
from collections.abc import Sequence
from importlib import import_module
from importlib.machinery import PathFinder
from importlib.util import find_spec
from typing import Any, NamedTuple

from rclpy.exceptions import NameValidationException
from rclpy.executors import Executor
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rosbags.interfaces import Qos
from std_srvs.srv import Trigger

from sphere_nmpc.errors import InvalidInputError, shown
from sphere_nmpc.ros.cdr import Status, read
from sphere_nmpc.ros.graph_monitor import (
    INVALID,
    UNKNOWN,
    GraphMonitor,
    full_name,
    other_types,
    publishers_of,
)
from sphere_nmpc.ros.guarded_node import GuardedNode
from sphere_nmpc.ros.lifetime import run
from sphere_nmpc.ros.pose_publisher import frame_prefix
from sphere_sim.recording.bag_files import TOPICS_PREFIX, BagError
from sphere_sim.recording.message_fields import POSE_TOPIC
from sphere_sim.recording.recorder_settings import (
    KNOWN_TYPES,
    LATCHED,
    RecorderSettings,
    matches_any,
)
from sphere_sim.recording.session import RecordingSession
from sphere_sim.ros.recorder.frames import MOVING, STATIC, TRANSFORMS, Frames
from sphere_sim.ros.recorder.surroundings import (
    MissingTopics,
    ParameterSnapshots,
    compatible_qos,
    full_name_of_topic,
    is_latched,
    qos_for_bag,
)

_DISCOVERY_PERIOD = 0.2
"""Wall time between two inspections of the graph [s]."""
_BATCH_PERIOD = 5e-3
"""Wall time between two rounds of taking the messages that have arrived [s]."""


class TopicSubscription(NamedTuple):
    """Subscription to a topic, and what it was created with."""

    subscription: Subscription
    message_class: type
    made_for: tuple[str, ReliabilityPolicy, DurabilityPolicy]


class RecorderNode(GuardedNode):
    """Recorder of topics; see the module for its interface, and `SimulatorNode` for the argument.

    Raises
    ------
    BagError
        If the first bag cannot be created.
    """

    def __init__(self, parameter_overrides: list[Parameter] | None = None) -> None:
        super().__init__("recorder", parameter_overrides)
        settings = self.parameters.declare(RecorderSettings()).settings
        self._clock_topic = self.resolve_topic_name("/clock")
        self._patterns = [full_name_of_topic(self, topic) for topic in settings.topics]
        self.parameters.warn_of_unknown()
        self._monitor = GraphMonitor(self, self._fault_log)
        self._missing = MissingTopics(self, settings.topics)
        self._uses_sim_time = bool(self.get_parameter("use_sim_time").value)
        self._subscriptions_by_topic: dict[str, TopicSubscription] = {}
        self._inbox: list[tuple[int, str, bytes]] = []
        self._named: dict[str, str] = {}
        self._status = b""
        self._snapshots = ParameterSnapshots(self)
        self._session = RecordingSession(
            settings.output,
            self._clock_topic if self._uses_sim_time else "",
            self._offered_qos,
            self._fault_log,
            lambda line: self.get_logger().error(line),
        )
        if self._uses_sim_time and not matches_any(self._clock_topic, self._patterns):
            self._patterns.append(self._clock_topic)
        for name, msgtype in KNOWN_TYPES.items():
            topic = full_name_of_topic(self, name)
            if matches_any(topic, self._patterns):
                self._named[name] = topic
                self._subscribe(topic, msgtype, compatible_qos((), name in LATCHED))
        self._frames = None if _message_class(TRANSFORMS) else Frames(frame_prefix(self, ""))
        for topic in (MOVING, STATIC):
            if self._frames is not None and matches_any(topic, self._patterns):
                self._session.set_topic(topic, TRANSFORMS, topic == STATIC)
        if settings.record_on_start:
            self._start()
        self.create_wall_timer(_DISCOVERY_PERIOD, self._discover)
        self.create_wall_timer(settings.commit_period, self._session.commit)
        self.create_service(Trigger, "~/start", self._on_start)
        self.create_service(Trigger, "~/stop", self._on_stop)
        self.create_service(Trigger, "~/is_recording", self._on_is_recording)

    def work(self, executor: Executor) -> None:
        """Serve timers and services, and record the messages that have arrived."""
        executor.spin_once()
        self._record_arrived()
        # A round of the executor costs about 0.3 ms for any number of messages: collect some.
        time.sleep(_BATCH_PERIOD)

    def finish(self) -> None:
        """Record the messages that have arrived and close the bag."""
        self._record_arrived()
        self._stop()

    def _offered_qos(self, topic: str) -> list[Qos]:
        entry = self._subscriptions_by_topic.get(topic)
        if entry is None:  # transforms that are made here
            return [qos_for_bag(compatible_qos((), latched=True))] if topic == STATIC else []
        return [qos_for_bag(it.qos_profile)
                for it in publishers_of(self, topic, entry.message_class)]

    def _custom_data(self) -> dict[str, str]:
        """Return what the bag says of the run: parameters of nodes, and its topics by name."""
        key = f"{TOPICS_PREFIX}{self.get_namespace()}"
        return {**self._snapshots.custom_data(), key: json.dumps(self._named)}

    def _follow_controller(self) -> None:
        """Record the poses that the controller says it receives, where it has them remapped."""
        status, self._status = self._status, b""
        if not status or "pose" not in self._named:
            return
        try:
            topic = read(status, Status).values.get(POSE_TOPIC, "")
        except InvalidInputError:
            return  # it is recorded all the same
        if topic not in ("", self._named["pose"]):
            self._named["pose"] = topic
            self._patterns.append(topic)
            self._subscribe(topic, KNOWN_TYPES["pose"], compatible_qos(()))

    def _discover(self) -> None:
        """Subscribe to new topics, and adapt subscriptions to what the publishers offer."""
        own = self.get_fully_qualified_name()
        self._follow_controller()
        # A recording with a second clock or pose publisher has no meaningful metrics.
        further = self._monitor.further_publishers(clocked=self._uses_sim_time)
        for topic, msgtypes in self.get_topic_names_and_types():
            if not matches_any(topic, self._patterns):
                continue
            publishers = self.get_publishers_info_by_topic(topic)
            if not publishers:
                continue
            entry = self._subscriptions_by_topic.get(topic)
            # It stays, as a bag has one type of a topic.
            msgtype = entry.made_for[0] if entry else next(filter(_message_class, msgtypes), "")
            further += other_types(topic, msgtype or msgtypes[0], publishers)
            offered = [it.qos_profile for it in publishers if it.topic_type == msgtype]
            if not offered and entry:
                continue
            self._subscribe(topic, msgtype or msgtypes[0], compatible_qos(offered))
            self._session.add_to_bag(topic)
            for publisher in publishers:
                node = full_name(publisher)
                if node not in (own, UNKNOWN, INVALID):
                    self._snapshots.request(node)
        self._monitor.update(self._missing.faults() + further)
        self._session.add_custom_data(self._custom_data())

    def _subscribe(self, topic: str, msgtype: str, qos: QoSProfile) -> None:
        existing = self._subscriptions_by_topic.get(topic)
        wanted = (msgtype, qos.reliability, qos.durability)
        if topic in self._session.refused or (existing and existing.made_for == wanted):
            return
        message_class = _message_class(msgtype)
        if message_class is None:
            self._session.refuse(topic, f"message type {shown(msgtype)} is not installed")
            return
        if existing is not None:
            self.destroy_subscription(existing.subscription)

        def take(data: bytes, about: Any) -> None:
            self._inbox.append((about["received_timestamp"], topic, bytes(data)))

        # rclpy passes message information to callbacks of two arguments, which it does not type.
        callback: Any = take
        try:
            subscription = self.create_subscription(message_class, topic, callback, qos, raw=True)
        except NameValidationException:
            self._session.refuse(topic, "expected a valid name of a topic")
            return
        self._subscriptions_by_topic[topic] = TopicSubscription(
            subscription, message_class, wanted
        )
        self._session.set_topic(topic, msgtype, is_latched(qos))

    def _record_arrived(self) -> None:
        """Take all messages that have arrived, and write them."""
        for topic, entry in self._subscriptions_by_topic.items():
            handle = entry.subscription.handle
            with handle:
                while (taken := handle.take_message(entry.message_class, True)) is not None:
                    self._inbox.append((taken[1]["received_timestamp"], topic, bytes(taken[0])))
        inbox, self._inbox = self._inbox, []
        status = self._named.get("controller/status")
        self._status = next((it for *_, topic, it in inbox if topic == status), self._status)
        made = self._frames.transforms(inbox, self._named) if self._frames else []
        self._session.write([*inbox, *made])

    def _start(self) -> str:
        folder = self._session.start()
        self._session.add_custom_data(self._custom_data())
        self.get_logger().info(f"recording to {folder}")
        return str(folder)

    def _stop(self) -> str:
        summary = self._session.stop()
        if summary:
            self.get_logger().info(f"recorded {summary}")
        return summary or "was not recording"

    def _on_start(self, request: Trigger.Request, answer: Trigger.Response) -> Trigger.Response:
        if self._session.folder is not None:
            answer.message = f"already recording to {self._session.folder}"
            return answer
        try:
            answer.message = self._start()
            answer.success = True
        except BagError as error:
            answer.message = str(error)
        return answer

    def _on_stop(self, request: Trigger.Request, answer: Trigger.Response) -> Trigger.Response:
        answer.success = self._session.folder is not None
        answer.message = self._stop()
        return answer

    def _on_is_recording(
        self, request: Trigger.Request, answer: Trigger.Response
    ) -> Trigger.Response:
        """Answer with the folder, then the topics that have a message, or only a publisher."""
        folder, received = self._session.folder, self._session.received
        answer.success = folder is not None
        matched = [
            topic for topic, entry in self._subscriptions_by_topic.items()
            if topic not in received and entry.subscription.get_publisher_count() > 0
        ]
        lines = [*(f"received {t}" for t in received), *(f"matched {t}" for t in matched)]
        answer.message = "\n".join((str(folder or "not recording"), *sorted(lines)))
        return answer


def _message_class(msgtype: str) -> Any:
    """Return the class of a message type, None where it is not installed.

    Any participant can announce any type: a package is loaded only if it has messages.
    """
    package, _, name = msgtype.partition("/msg/")
    found = find_spec(package) if package.isidentifier() else None
    if found is None or PathFinder.find_spec("msg", found.submodule_search_locations) is None:
        return None
    found_class = getattr(import_module(f"{package}.msg"), name, None)
    return found_class if hasattr(found_class, "_fields_and_field_types") else None


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; see the module."""
    return run(RecorderNode, args, __doc__ or "")
