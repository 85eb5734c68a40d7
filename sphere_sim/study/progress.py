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


class StudyProgress(contextlib.ExitStack):
    """Bar on standard error: runs made, runs settled, remaining time.

    Once it is closed it stays visible, and another one may follow.
    """

    def __init__(self, runs: int) -> None:
        super().__init__()
        self._done = self._settled = 0
        self._progress = self.enter_context(shown(Progress(
            TextColumn("runs"), BarColumn(), MofNCompleteColumn(),
            TextColumn("{task.fields[settled]}"), TimeElapsedColumn(), TextColumn("to go"),
            TimeRemainingColumn(), console=Console(stderr=True),
        )))
        self._task = self._progress.add_task("runs", total=runs, settled="")

    def count(self, record: RunRecord) -> None:
        """Count a run."""
        self._done += 1
        self._settled += bool(record.results["settled"])
        text = f"{self._settled} settled"
        if self._done > self._settled:
            text += f", {self._done - self._settled} not"
        self._progress.update(self._task, completed=self._done, settled=text)
