# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""What a status of the controller says about its goals, and when one of them is given up."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

from sphere_nmpc.errors import InvalidInputError
from sphere_nmpc.quantities import known
from sphere_nmpc.reporting.conditions import Kind

_PURSUED = {mode.value for mode in (Kind.TRACKING, Kind.AT_GOAL, Kind.NO_GOAL)}
"""Modes in which nothing keeps the controller from its goal."""
ERROR_CODES = {kind.value: kind.code for kind in Kind if kind.code}
"""Codes of Nav2 for causes."""
OF_THE_WAY = {
    kind.value for kind in Kind if kind is Kind.NO_PROGRESS or kind.is_unreachable
}
"""Causes that concern the way to a goal, so that another one may be reached."""
_OF_THE_GOAL = {Kind.GOAL_OUTSIDE.value, Kind.GOAL_OCCUPIED.value}
"""Causes that are known before the sphere moves, wherever it is."""
_KEYS = "goal_stamp", "goal_index", "mode", "plans", "total_time_left_s", "total_distance_left_m"


@dataclass(frozen=True)
class GoalReport:
    """What a status of the controller says about its goals."""

    stamp: str = ""
    """Stamp of the message that brought the goals in force; empty without any."""
    index: int = 0
    """Which of the goals is aimed at, from 0 on."""
    count: int = 0
    """Number of the goals; 0 where it is not known."""
    mode: str = ""
    """Value of the `Kind` that is the controller's mode."""
    at_rest: bool = False
    """Whether no rotor moves any more."""
    plans: int = 0
    """Number of new plans since the controller was started."""
    time: float = math.nan
    """Control time [s]."""
    time_left: float = math.nan
    """Time to the goal aimed at [s]; nan where it is not known."""
    distance_left: float = math.nan
    """Path to the goal aimed at [m]; nan where it is not known."""
    total_time_left: float = math.nan
    """Time to the last of the goals [s]."""
    total_distance_left: float = math.nan
    """Path to the last of the goals [m]."""
    unreachable: str = ""
    """Value of the `Kind` of unreachable goals, empty where the goal may be reached."""
    obstacle: str = ""
    """What keeps the sphere from its goal; empty where that is said by the mode."""
    deviation: float = math.nan
    heading_error: float = math.nan
    speed: float = math.nan
    """Deviation, heading error and speed as in `Tracking` [m, rad, m/s]; nan without a path."""

    @classmethod
    def of(cls, values: Mapping[str, str]) -> "GoalReport":
        """Return the report of a status with these values; the only place that knows their keys.

        Before its first sampling instant a controller reports nothing of plans and commands.
        `InvalidInputError` is raised for values that are no status of a controller.
        """
        given_up = values.get("giving_up", "")

        def number(key: str, missing: float = math.nan) -> float:
            return known(float(values.get(key, missing)))

        try:
            return cls(
                values["goal_stamp"], int(number("goal_index")), int(number("goal_count", 0)),
                values["mode"], values.get("at_rest") == "true", int(number("plans", 0)),
                number("time_s"), number("time_left_s"), number("distance_left_m"),
                number("total_time_left_s"), number("total_distance_left_m"),
                values.get("unreachable", ""),
                values.get("no_progress") or (given_up and f"the strategy gives up {given_up}"),
                number("path_deviation_m"), number("path_heading_error_rad"),
                number("path_speed_m_s"),
            )
        except (KeyError, ValueError) as error:
            raise InvalidInputError(
                "values of controller/status", str(error), ", ".join(_KEYS)
            ) from None

    @property
    def is_at_goal(self) -> bool:
        """Whether the sphere is at the last of the goals."""
        return self.mode == Kind.AT_GOAL.value

    @property
    def cause(self) -> str:
        """What keeps the sphere from its goal, in words that do not change."""
        return self.unreachable or self.mode


class Patience:
    """Decides when a goal is given up that the controller does not pursue.

    At once where it is disabled, and where the goal is unreachable whatever moves on the floor:
    one outside or in what is occupied without further ado, another one as soon as the sphere
    stands. Otherwise after the time `longest` [s], in which poses may return, an area may move on,
    a blocked sphere may be freed, or a search may find a plan.
    """

    def __init__(self, longest: float) -> None:
        self._longest = longest
        self._since: float | None = None

    def exhausted(self, report: GoalReport, now: float) -> str:
        """Return why the goals of a report are given up at `now` [s]; empty while they are not."""
        mode, reason = report.mode, f": {report.obstacle}" if report.obstacle else ""
        if report.stamp and report.unreachable in _OF_THE_GOAL:
            return report.cause + reason
        if mode in _PURSUED:
            self._since = None
            return ""
        if self._since is None:
            self._since = now
        is_final = mode == Kind.DISABLED.value or (
            mode == Kind.NO_PROGRESS.value and report.unreachable
        )
        if report.stamp and is_final:
            return mode + reason
        is_over = now - self._since > self._longest
        return f"{mode}{reason}, for {self._longest:g} s" if is_over else ""
