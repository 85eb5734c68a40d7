# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Waiting for the arrival against statuses that are written out here."""

from types import SimpleNamespace

import pytest

from sphere_nmpc.conditions import Kind
from sphere_sim.ros.session.goal_wait import NotReachedError, wait_until_reached


class Status(SimpleNamespace):
    """Statuses of a controller, one more at each spin, whose last mode lasts."""

    def __init__(self, *modes: Kind, **values: str) -> None:
        super().__init__(count=1, topic="/controller/status", progress=SimpleNamespace(stamp="1"))
        self._modes, self._values = iter(modes), values
        self.mode = Kind.TRACKING.value

    @property
    def values(self) -> dict[str, str]:
        known = {"time_s": f"{self.count}", "goal_stamp": "1", "goal_index": "0"}
        return known | {"mode": self.mode} | self._values

    def obstacle(self) -> str:
        return "told"

    def spin(self) -> None:
        self.count += 1
        self.mode = next(self._modes, Kind(self.mode)).value


def took(status: Status) -> float:
    sender = SimpleNamespace(status=status, is_in_force=True)
    return wait_until_reached(sender, status.spin, lambda: None)


def test_arrival_after_what_was_in_the_way_has_moved() -> None:
    assert took(Status(Kind.TRACKING, Kind.NO_PROGRESS, Kind.TRACKING, Kind.AT_GOAL)) == 3.0


@pytest.mark.parametrize(("status", "how"), [
    (Status(Kind.TRACKING, Kind.NO_PROGRESS, unreachable="goal outside"), "at once"),
    (Status(Kind.DISABLED), "at once"),
    (Status(Kind.TRACKING, Kind.NO_PROGRESS), "late"),
    (Status(Kind.NO_FRESH_POSE), "late"),
])
def test_goal_that_is_not_pursued_ends_the_wait_with_the_reason(status, how, monkeypatch) -> None:
    # A clock on which seconds pass from one status to the next.
    monkeypatch.setattr("time.monotonic", lambda: float(status.count))
    with pytest.raises(NotReachedError, match="the controller does not pursue it: told"):
        took(status)
    assert (status.count < 5) is (how == "at once")
