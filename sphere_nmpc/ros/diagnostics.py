# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Publisher of status and diagnostics in the layout of diagnostic_updater, which has no wheels."""

from collections.abc import Callable
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.qos import QoSProfile

from sphere_nmpc.reporting.conditions import Report, Severity
from sphere_nmpc.ros.guarded_node import GuardedNode
from sphere_nmpc.ros.messages import stamp_to_ros

_LEVELS: dict[Severity, bytes] = {
    level: getattr(DiagnosticStatus, level.name) for level in Severity
}
_TEXTS: dict[type, Callable[[Any], str]] = {
    float: "{:.6g}".format, np.float64: "{:.6g}".format, bool: ("false", "true").__getitem__,
}
"""Texts of values by their type, numbers with six digits; those of others are as Python has them.
"""
PERIOD = 0.5
"""Wall time between two messages of diagnostics [s], so that a killed node is noticed within two
seconds."""


class Diagnostics:
    """Publisher of the reports of a node's tasks on ``/diagnostics``, every `PERIOD` of wall time.

    `now` returns the stamp [ns] of a message. With a quality of service for it there is
    ``~/status``, too, on which the node publishes a `message`.
    """

    def __init__(
        self, node: GuardedNode, now: Callable[[], int], tasks: dict[str, Callable[[], Report]],
        status: QoSProfile | int | None = None,
    ) -> None:
        self._name = node.get_fully_qualified_name().lstrip("/")  # robots share /diagnostics
        self._now, self._tasks = now, tasks
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", 10)
        if status is not None:
            self.status = node.create_publisher(DiagnosticStatus, "~/status", status)
        self._timer = node.create_wall_timer(PERIOD, self._publish)

    def _publish(self) -> None:
        """Publish the reports of all tasks."""
        message = DiagnosticArray()
        message.header.stamp = stamp_to_ros(self._now())
        message.status = [
            self.message(report(), f": {task}") for task, report in self._tasks.items()
        ]
        self._publisher.publish(message)

    def message(self, report: Report, task: str = "") -> DiagnosticStatus:
        """Return a report as a message, of the node or of one of its tasks."""
        severity, message, values = report
        return DiagnosticStatus(
            level=_LEVELS[severity],
            name=self._name + task,
            message=message,
            hardware_id=self._name.rpartition("/")[0] or "sphere",
            values=[
                KeyValue(key=key, value=_TEXTS.get(type(value), str)(value))
                for key, value in values.items()
            ],
        )
