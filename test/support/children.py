# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Processes that tests start, which end with the test session however it ends."""

import os
import subprocess
from collections.abc import Callable
from typing import Any

from sphere_nmpc.child import end_with_parent


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
