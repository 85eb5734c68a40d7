# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Wait for the end of processes, whoever has started them."""

from collections.abc import Iterable
from functools import partial

from patience import until


def wait_for_end(pids: Iterable[int]) -> None:
    """Wait until the processes of these numbers have ended."""
    for pid in pids:
        until(partial(_has_ended, pid))


def _has_ended(pid: int) -> bool:
    import psutil  # which a session without tests of processes does not need

    try:
        return bool(psutil.Process(pid).status() == psutil.STATUS_ZOMBIE)
    except psutil.NoSuchProcess:
        return True
