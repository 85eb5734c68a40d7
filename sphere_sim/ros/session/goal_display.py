# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Display of the way to goals: a bar with path and time left, or a line now and then."""

import math

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.progress_bar import ProgressBar
from rich.table import Table

from sphere_nmpc.control.goal_report import GoalReport
from sphere_nmpc.errors import printable_line
from sphere_sim.output.live_display import LiveDisplay

_WIDTH = 18
"""Width of the bar [characters]."""


class GoalDisplay(LiveDisplay):
    """Display of the progress that the controller reports, on standard error."""

    def __init__(self) -> None:
        super().__init__(Console(stderr=True))
        self._report = GoalReport()
        self._way = Way()
        self.largest_deviation = math.nan
        """Largest distance from a path in the reports [m], once the sphere has rolled there from
        beside it; nan where none was followed."""
        self._joins = True

    def update(self, report: GoalReport) -> None:
        """Show a report, unless it is about no goal."""
        if report.count:
            self._report = report
            self._way.add(report)
            off = abs(report.deviation)
            if self._joins and off < self.largest_deviation:
                self.largest_deviation = off
            else:
                self._joins = self._joins and not off > self.largest_deviation
                self.largest_deviation = np.fmax(self.largest_deviation, off)
            self.show(self._picture, self._line, report.is_at_goal)

    def _picture(self) -> Table:
        left, picture = _left(self._report), Table.grid(padding=(0, 2))
        for width in (_WIDTH, len(left), None):  # a narrow terminal cuts the last one
            picture.add_column(no_wrap=True, overflow="ellipsis", min_width=width)
        done = 1.0 if self._report.is_at_goal else self._way.share
        bar = ProgressBar(total=1.0, completed=done, width=_WIDTH)
        picture.add_row(bar, left, escape(self._mode))
        return picture

    def _line(self) -> str:
        return f"{_left(self._report)}, {self._mode}"

    @property
    def _mode(self) -> str:
        return printable_line(self._report.mode)


class Way:
    """Share of the way to several goals; the ways between them count equally."""

    def __init__(self) -> None:
        self._index = -1
        self._longest = 0.0
        self.share = 0.0
        """Share of the way that is behind, 0 to 1."""

    def add(self, progress: GoalReport) -> None:
        """Update the share by a report."""
        if progress.index != self._index:
            self._index, self._longest = progress.index, 0.0
        left = 1.0
        if math.isfinite(progress.distance_left):
            # A new plan may take a longer path.
            self._longest = max(self._longest, progress.distance_left)
            left = progress.distance_left / self._longest if self._longest > 0.0 else 0.0
        self.share = (progress.index + 1.0 - left) / max(1, progress.count)


def _left(progress: GoalReport) -> str:
    """Return what is left of way and time, and the deviation, in a text of constant length."""
    which = f"goal {progress.index + 1} of {progress.count}: " if progress.count > 1 else ""
    path, time = progress.distance_left, progress.time_left
    off = 1e3 * abs(progress.deviation)
    deviation = f", {_number(off, 5, 1)} mm off the path" if math.isfinite(off) else ""
    return f"{which}{_number(path, 6, 2)} m, {_number(time, 5, 1)} s left{deviation}"


def _number(value: float, width: int, digits: int) -> str:
    return f"{value:{width}.{digits}f}" if math.isfinite(value) else "–".rjust(width)
