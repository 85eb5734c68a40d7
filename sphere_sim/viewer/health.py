# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""When silence is worth telling; all moments are on one steady clock [s]."""

from dataclasses import dataclass

POSE_SILENCE = 0.5
"""A simulator that stands still repeats its pose five times a second [s]."""
CONTROLLER_SILENCE = 0.8
"""The controller reports to diagnostics twice a second, whatever the clock does [s]."""


@dataclass
class Health:
    """What was heard last, and what follows from that.

    Attributes
    ----------
    pose_at, controller_at : float or None
        When a pose, and when anything from the controller, was heard last.
    controllers : int
        How many publishers of the controller's status the graph knows of.
    refused : str
        Why the newest pose was not taken; empty if it was.
    """

    pose_at: float | None = None
    controller_at: float | None = None
    controllers: int = 0
    refused: str = ""

    def alerts(self, now: float) -> tuple[str, ...]:
        """Return what is amiss, in words."""
        return tuple(filter(None, (self._pose(now), self._controller(now))))

    def _pose(self, now: float) -> str:
        if self.refused:
            return f"pose refused: {self.refused}"
        if self.pose_at is None:
            return "no pose yet"
        silence = now - self.pose_at
        return f"no pose for {silence:.1f} s" if silence > POSE_SILENCE else ""

    def _controller(self, now: float) -> str:
        if self.controller_at is None:
            return "no controller yet"
        silence = now - self.controller_at
        if silence <= CONTROLLER_SILENCE:
            # One that ended in good order has left the graph at once.
            return "" if self.controllers or silence < POSE_SILENCE else "controller gone"
        return f"controller silent for {silence:.1f} s"
