# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Processes that tests start, which end with the test session however it ends."""

import os
import subprocess
from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

from patience import until

from sphere_nmpc.child import end_with_parent


def wait_for_end(pids: Iterable[int]) -> None:
    """Wait until processes have ended, whoever has started them."""
    for pid in pids:
        until(partial(_has_ended, pid))


def _has_ended(pid: int) -> bool:
    import psutil  # which a session without tests of processes does not need

    try:
        return bool(psutil.Process(pid).status() == psutil.STATUS_ZOMBIE)
    except psutil.NoSuchProcess:
        return True


def end_with_this_process() -> None:
    """Let all processes that are started from now on end when this one is killed.

    On Linux they then receive SIGTERM, also when the thread ends that has started them.
    """
    begin = subprocess.Popen.__init__

    def begin_bound(
        self: subprocess.Popen, *arguments: Any, preexec_fn: Callable[[], object] | None = None,
        **options: Any,
    ) -> None:
        parent = os.getpid()

        def prepare() -> None:
            end_with_parent(parent)
            if preexec_fn is not None:
                preexec_fn()

        begin(self, *arguments, preexec_fn=prepare, **options)

    subprocess.Popen.__init__ = begin_bound  # type: ignore[method-assign]
