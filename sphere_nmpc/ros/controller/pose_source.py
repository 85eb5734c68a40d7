# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Status of the node that publishes the poses, read only while there are none."""

from collections.abc import Sequence

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.subscription import Subscription

from sphere_nmpc.errors import printable_line
from sphere_nmpc.ros.graph_monitor import INVALID, NO_EVENTS, UNKNOWN, publishers_of
from sphere_nmpc.ros.guarded_node import LATCHED, GuardedNode


class PoseSource:
    """Subscriber of ``~/status`` of the one node that publishes poses, while these are missing.

    An odometry publishes none while it is calibrated, or the position is not known.
    """

    def __init__(self, node: GuardedNode) -> None:
        self._node = node
        self._subscription: Subscription | None = None
        self._reported = ""

    def reported_by(self, senders: Sequence[str]) -> str:
        """Return for what the one of `senders` may have no poses, with its name; else "".

        Its status is read from the first call with it on, up to the first without.
        """
        # One that was killed is counted beside the one that takes its place.
        name = senders[0] if len(set(senders)) == 1 else UNKNOWN
        topic = "" if name in (UNKNOWN, INVALID) else f"{name}/status"
        held = self._subscription
        if held is not None and held.topic_name != topic:
            self._node.destroy_subscription(held)
            self._subscription, self._reported = None, ""
        if topic and self._subscription is None and (
            publishers_of(self._node, topic, DiagnosticStatus)
        ):
            self._subscription = self._node.create_subscription(
                DiagnosticStatus, topic, lambda status: self._receive(name, status), LATCHED,
                event_callbacks=NO_EVENTS, largest=(100_000, "a status"),
            )
        return self._reported

    def _receive(self, name: str, status: DiagnosticStatus) -> None:
        has_poses = status.level in (DiagnosticStatus.OK, DiagnosticStatus.WARN)
        self._reported = "" if has_poses else f"{name} reports {printable_line(status.message)}"
