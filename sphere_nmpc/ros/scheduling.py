# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Scheduling of a node's process: real-time priority if wanted, niceness for viewers."""

import contextlib
import os
from pathlib import Path

_NICENESS = 5
"""Niceness of a process that only displays."""
_TASKS = Path("/proc/self/task")
_OF_SESSION = Path("/proc/self/autogroup")


def schedule(priority: int) -> bool:
    """Schedule all threads of this process with a real-time priority, or ordinarily.

    It needs Linux and root, CAP_SYS_NICE or `rtprio` in limits.conf; otherwise nothing changes.

    Parameters
    ----------
    priority : int
        Of SCHED_FIFO, 1 to 99; 0 is ordinary scheduling.

    Returns
    -------
    bool
        Whether it was allowed.
    """
    try:
        policy = os.SCHED_FIFO if priority else os.SCHED_OTHER
        wanted = os.sched_param(priority)
        # Each thread has its own policy, and the middleware has started some.
        for task in _TASKS.iterdir():
            os.sched_setscheduler(int(task.name), policy, wanted)
    except (OSError, AttributeError):
        return False
    return True


def refused_message(priority: int) -> str:
    """Return the warning about a priority that the system does not allow."""
    return (
        f"thread_priority: given {priority}, but this user may not schedule in real time, "
        "expected root, CAP_SYS_NICE or rtprio in /etc/security/limits.conf; continuing with "
        "ordinary scheduling"
    )


def lower_priority() -> None:
    """Give this process a lower priority than the nodes in the control loop.

    Within a session the niceness of the process decides; between sessions Linux divides processor
    time by the niceness of the session.
    """
    os.nice(_NICENESS)
    with contextlib.suppress(OSError):
        if os.getsid(0) == os.getpid():
            _OF_SESSION.write_text(str(_NICENESS))
