# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The demo's progress: updated in place on a terminal, otherwise a line every two seconds."""

import math
import time

from rich.console import Console, Group
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table

from sphere_sim.demo.plan import DemoPlan
from sphere_sim.ros.session.demo_session import Progress

_LINE_EVERY = 2.0
"""Wall time between two lines where there is no terminal [s]."""


class ProgressDisplay:
    """Display of the newest values of a run.

    Parameters
    ----------
    console : Console
        Terminal or file.
    plan : DemoPlan
        The run.
    """

    def __init__(self, console: Console, plan: DemoPlan) -> None:
        self._console = console
        self._plan = plan
        self._live = Live(console=console, auto_refresh=False) if console.is_terminal else None
        self._printed_at = -math.inf
        self._first: float | None = None

    def __enter__(self) -> "ProgressDisplay":
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(self, *exception: object) -> None:
        if self._live is not None:
            self._live.stop()

    def show(self, progress: Progress) -> None:
        """Show the newest values."""
        if self._live is not None:
            self._live.update(Group(self._table(progress), self._bar(progress)), refresh=True)
        elif time.monotonic() >= self._printed_at + _LINE_EVERY:
            self._printed_at = time.monotonic()
            self._console.print(_line(progress), highlight=False, soft_wrap=True)

    def _table(self, progress: Progress) -> Table:
        table = Table.grid(padding=(0, 3))
        speeds = "  ".join(f"{speed:7.1f}" for speed in progress.rotor_speeds)
        for name, value in (
            ("time", f"{progress.time:8.2f} s"),
            ("distance", f"{progress.position_error:8.4f} m"),
            ("angle", f"{math.degrees(progress.angle_error):8.3f} deg"),
            ("rotor speeds", f"{speeds} rad/s"),
            ("solve time", f"{1e3 * progress.solve_time:8.2f} ms"),
        ):
            table.add_row(f"[dim]{name}[/dim]", value)
        return table

    def _bar(self, progress: Progress) -> ProgressBar:
        """Return a bar of the error between start and tolerance, on a logarithmic scale."""
        error = max(progress.error, 1e-12)
        if self._first is None and math.isfinite(error):
            self._first = max(error, 2.0 * self._plan.tolerance)
        if self._first is None:
            return ProgressBar(total=1.0, completed=0.0, width=50)
        way = math.log(self._first / error) / math.log(self._first / self._plan.tolerance)
        return ProgressBar(total=1.0, completed=min(max(way, 0.0), 1.0), width=50)


def _line(progress: Progress) -> str:
    speeds = ", ".join(f"{speed:.1f}" for speed in progress.rotor_speeds)
    return (
        f"t {progress.time:6.2f} s  distance {progress.position_error:.4f} m  "
        f"angle {math.degrees(progress.angle_error):.3f} deg  rotors {speeds} rad/s  "
        f"solve {1e3 * progress.solve_time:.2f} ms"
    )
