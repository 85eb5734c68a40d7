# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Who goes first where processors are few: what is controlled before what is seen."""

import contextlib
import os
from pathlib import Path

REAL_TIME_PRIORITY = 1
"""The lowest there is: ahead of everything that has no deadlines, behind all else that has."""
_COURTESY = 5
"""Niceness of what may stutter."""
_TASKS = Path("/proc/self/task")
_OF_SESSION = Path("/proc/self/autogroup")


def schedule(in_real_time: bool) -> bool:
    """Schedule this process in real time (SCHED_FIFO) where the system allows that, or as usual.

    It takes Linux and root, CAP_SYS_NICE or `rtprio` in limits.conf; without, all stays as it is.

    Returns
    -------
    bool
        Whether it was allowed.
    """
    try:
        policy = os.SCHED_FIFO if in_real_time else os.SCHED_OTHER
        priority = os.sched_param(REAL_TIME_PRIORITY if in_real_time else 0)
        # Each thread has its own, and the middleware has begun some.
        for task in _TASKS.iterdir():
            os.sched_setscheduler(int(task.name), policy, priority)
    except (OSError, AttributeError):
        return False
    return True


def stand_back() -> None:
    """Let this process run behind the nodes.

    What is seen may stutter sooner than what is controlled. Within a session that is what niceness
    does; between sessions Linux shares processors out by that of the session.
    """
    os.nice(_COURTESY)
    with contextlib.suppress(OSError):
        if os.getsid(0) == os.getpid():
            _OF_SESSION.write_text(str(_COURTESY))
