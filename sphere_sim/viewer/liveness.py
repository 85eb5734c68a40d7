# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Alerts about missing messages of simulator and controller; times on one steady clock [s]."""

from dataclasses import dataclass

POSE_TIMEOUT = 0.5
"""Age from which on a pose is missed [s]; a paused simulator repeats its pose at 5 Hz."""
CONTROLLER_TIMEOUT = 0.8
"""Age from which on the controller is missed [s]; it always publishes diagnostics at 2 Hz."""


@dataclass
class Liveness:
    """Times of the newest messages, and the alerts that follow from them.

    Attributes
    ----------
    pose_at, controller_at : float or None
        Arrival of the newest pose, and of the newest message of the controller.
    controllers : int
        Number of publishers of the controller's status in the graph.
    refused : str
        Reason for which the newest pose is invalid; empty if it is valid.
    """

    pose_at: float | None = None
    controller_at: float | None = None
    controllers: int = 0
    refused: str = ""

    def alerts(self, now: float) -> tuple[str, ...]:
        """Return the alerts at a time [s]."""
        return tuple(filter(None, (self._pose_alert(now), self._controller_alert(now))))

    def _pose_alert(self, now: float) -> str:
        if self.refused:
            return f"pose refused: {self.refused}"
        if self.pose_at is None:
            return "no pose yet"
        age = now - self.pose_at
        return f"no pose for {age:.1f} s" if age > POSE_TIMEOUT else ""

    def _controller_alert(self, now: float) -> str:
        if self.controller_at is None:
            return "no controller yet"
        age = now - self.controller_at
        if age <= CONTROLLER_TIMEOUT:
            # A node that ends normally leaves the graph immediately.
            return "" if self.controllers or age < POSE_TIMEOUT else "controller gone"
        return f"controller silent for {age:.1f} s"
