# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Worker that does each task at once, in the caller's process."""

from sphere_nmpc.worker.contract import Reply, Result, Store, Task


class InLine:
    """`Worker` whose replies are ready when `submit` returns."""

    available = True

    def __init__(self) -> None:
        self._store: Store = {}

    def submit(self, task: Task[Result]) -> Reply[Result]:
        """Do the task; an error in it is raised."""
        return Reply(task(self._store), ready=True)

    def poll(self) -> None:
        """Return at once, as nothing is on its way."""
