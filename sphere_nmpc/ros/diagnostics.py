# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Publisher of diagnostics in the layout of diagnostic_updater, which ROS wheels do not have."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

from sphere_nmpc.reporting.conditions import Severity
from sphere_nmpc.ros.guarded_node import GuardedNode
from sphere_nmpc.ros.messages import stamp_to_ros

_LEVELS: dict[Severity, bytes] = {
    level: getattr(DiagnosticStatus, level.name) for level in Severity
}
_TEXTS: dict[type, Callable[[Any], str]] = {
    float: "{:.6g}".format, np.float64: "{:.6g}".format, bool: ("false", "true").__getitem__,
}
"""Texts of values by their type; those of others are as Python has them."""


def status_name(node: Node) -> str:
    """Return the name of a node in statuses: with its namespace, as robots share /diagnostics."""
    return node.get_fully_qualified_name().lstrip("/")


def status(
    name: str, level: Severity, message: str, values: Mapping[str, Any]
) -> DiagnosticStatus:
    """Return the status of the node `name`; numbers are written with six digits."""
    return DiagnosticStatus(
        level=_LEVELS[level],
        name=name,
        message=message,
        hardware_id=name.rpartition("/")[0] or "sphere",
        values=[
            KeyValue(key=key, value=_TEXTS.get(type(value), str)(value))
            for key, value in values.items()
        ],
    )


PERIOD = 0.5
"""Wall time between two reports [s], so that a killed node is noticed within two seconds."""


class Diagnostics:
    """Publisher of the reports of a node's tasks on ``/diagnostics``, every `PERIOD` of wall time.

    `now` returns the stamp [ns] of a message, each task its level, message and values.
    """

    def __init__(
        self,
        node: GuardedNode,
        now: Callable[[], int],
        tasks: dict[str, Callable[[], tuple[Severity, str, Mapping[str, Any]]]],
    ) -> None:
        self._name = status_name(node)
        self._now = now
        self._tasks = tasks
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._timer = node.create_wall_timer(PERIOD, self.publish)

    def publish(self) -> None:
        """Publish the reports of all tasks."""
        message = DiagnosticArray()
        message.header.stamp = stamp_to_ros(self._now())
        message.status = [
            status(f"{self._name}: {task}", *report()) for task, report in self._tasks.items()
        ]
        self._publisher.publish(message)
