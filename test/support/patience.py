# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""How long a test waits for what has to happen in the end."""

import time
from collections.abc import Callable
from typing import Any

PATIENCE = 600.0
"""Time-out [s]: thirty times what an idle machine takes; only failing tests wait that long."""
LOCKSTEP = {"lockstep": True, "lockstep_timeout": PATIENCE}
"""Parameters of a simulator whose clock waits as long, also for a controller that a busy machine
holds up."""


def until(condition: Callable[[], Any], every: float = 0.02) -> None:
    """Wait until a condition holds, which is asked at intervals [s]; fail after `PATIENCE`."""
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end, "time-out"
        time.sleep(every)
