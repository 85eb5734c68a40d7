# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Progress bar of a study."""

import contextlib
from collections.abc import Iterator

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from sphere_sim.study.record import RunRecord


@contextlib.contextmanager
def shown(progress: Progress) -> Iterator[Progress]:
    """Show a progress bar; nothing is shown where no further thread can be started."""
    with contextlib.suppress(RuntimeError):
        progress.start()
    try:
        yield progress
    finally:
        progress.stop()


class StudyProgress:
    """Bar on standard error: runs made, runs settled, remaining time; it starts when entered."""

    def __init__(self, runs: int) -> None:
        self._done = self._settled = 0
        self._shown = contextlib.ExitStack()
        self._progress = Progress(
            TextColumn("runs"), BarColumn(), MofNCompleteColumn(),
            TextColumn("{task.fields[settled]}"), TimeElapsedColumn(), TextColumn("to go"),
            TimeRemainingColumn(), console=Console(stderr=True),
        )
        self._task = self._progress.add_task("runs", total=runs, settled="")

    def __enter__(self) -> "StudyProgress":
        self._shown.enter_context(shown(self._progress))
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        """Stop the bar, which stays visible; another one may follow."""
        self._shown.close()

    def count(self, record: RunRecord) -> None:
        """Count a run."""
        self._done += 1
        self._settled += bool(record.results["settled"])
        text = f"{self._settled} settled"
        if self._done > self._settled:
            text += f", {self._done - self._settled} not"
        self._progress.update(self._task, completed=self._done, settled=text)
