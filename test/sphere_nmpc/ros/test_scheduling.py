# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Priorities are set where the system allows it, and nothing fails where it does not."""

import os
import subprocess
import sys

import pytest

if not hasattr(os, "sched_getscheduler"):
    pytest.skip("scheduling policies are Linux' own", allow_module_level=True)

CODE = """
import os, threading
from sphere_nmpc.ros.scheduling import refused_message, schedule, lower_priority
{first}
idle = threading.Event()
threading.Thread(target=idle.wait, daemon=True).start()
policies = lambda: {{os.sched_getscheduler(int(task)) for task in os.listdir("/proc/self/task")}}
usual = os.sched_getscheduler(0)
allowed = schedule(7)
assert not allowed or os.sched_getparam(0).sched_priority == 7
assert policies() == {{os.SCHED_FIFO if allowed else usual}}, policies()
schedule(0)
assert policies() == {{os.SCHED_OTHER if allowed else usual}}, policies()
before = os.nice(0)
lower_priority()
assert os.nice(0) == min(19, before + 5)
assert "given 7" in refused_message(7)
print(allowed)
"""


def outcome(first: str = "") -> str:
    command = [sys.executable, "-c", CODE.format(first=first)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_priority_is_that_of_all_threads_or_of_none() -> None:
    assert outcome() in ("True", "False")


@pytest.mark.skipif(os.geteuid() != 0, reason="somebody without privileges has none to drop")
def test_without_permission_nothing_changes() -> None:
    assert outcome("os.setgid(65534); os.setuid(65534)") == "False"
