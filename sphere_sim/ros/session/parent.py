# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""End of a process when its parent process ends, for whatever reason; Linux only."""

import ctypes
import os
import signal
import sys

_SET_PARENT_DEATH_SIGNAL = 1


def end_with_parent(parent: int) -> None:
    """Let Linux send SIGTERM to this process when its parent ends, for whatever reason.

    Parameters
    ----------
    parent : int
        Process that started this one; if it has ended already, this one ends immediately.
    """
    if not sys.platform.startswith("linux"):
        return
    ctypes.CDLL(None).prctl(_SET_PARENT_DEATH_SIGNAL, signal.SIGTERM)
    if os.getppid() != parent:
        sys.exit(1)
