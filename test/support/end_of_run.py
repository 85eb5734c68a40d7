# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""End of all processes of a test run when the run has ended, for whatever reason."""

import os
import select
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import psutil

_MARK = "SPHERE_NMPC_TEST_RUN"
"""Environment variable that all processes of a run inherit: the process ids of the run and of the
worker, each behind a slash."""
_MAKE_LEVEL = "MAKELEVEL"
"""Environment variable that make raises for what it starts."""
_PERIOD = 0.5
"""Time between two looks at whether make is asked to end [s]."""


def end_with_this_process() -> None:
    """Let all that this process starts from now on be killed when it ends, for whatever reason.

    Processes in between that end earlier, such as shells, change nothing. A worker of a run does
    so for what it has started; it also ends with the run. Where make has started this process, it
    is killed when make ends, which leaves alone what it has started.
    """
    os.environ[_MARK] = part = f"{os.environ.get(_MARK, '')}/{os.getpid()}"
    ends_with = [os.getpid(), *_up_to_make()]
    # A session of its own: no signal to the group of the run ends it.
    subprocess.Popen([sys.executable, __file__, part, *map(str, ends_with)],
                     stdin=subprocess.DEVNULL, start_new_session=True)


def _up_to_make() -> list[int]:
    """Return the processes from the parent of this one up to the make that has started it."""
    found: list[int] = []
    level = os.environ.get(_MAKE_LEVEL)
    with suppress(psutil.Error):  # of another user
        for process in psutil.Process().parents():
            found.append(process.pid)
            if process.environ().get(_MAKE_LEVEL) != level:
                return found
    return []


def _processes(part: str) -> list[psutil.Process]:
    """Return the processes that a part of a run has started, also those whose parent has ended."""
    found = []
    for process in psutil.process_iter():
        # It has ended, or is of another user.
        with suppress(psutil.Error):
            mark = process.environ().get(_MARK, "")
            if process.pid != os.getpid() and f"{mark}/".startswith(f"{part}/"):
                found.append(process)
    return found


def _handled(pids: list[int]) -> list[str]:
    """Return the signals for which processes that have not ended have handlers."""
    found = []
    for pid in pids:
        with suppress(OSError):
            status = Path(f"/proc/{pid}/status").read_text()
            found.append(status.partition("SigCgt:")[2].partition("\n")[0])
    return found


def _wait_for_end_of_one(own: int, others: list[int]) -> None:
    """Wait until one of the processes has ended, or the last of the others, make, is asked to.

    Make sets that signal to its default and then waits for what it has started, as a terminal
    would have sent the signal to all.
    """
    make = others[-1:]
    handled = _handled(make)
    with suppress(ProcessLookupError):  # it has ended already
        ends = [os.pidfd_open(pid) for pid in (own, *others)]
        while not select.select(ends, [], [], _PERIOD)[0] and _handled(make) == handled:
            pass


def main(part: str, own: str, *others: str) -> None:
    """Kill a process and what it has started as soon as one of the processes has ended."""
    with suppress(psutil.NoSuchProcess):
        process = psutil.Process(int(own))
        _wait_for_end_of_one(process.pid, [int(other) for other in others])
        process.kill()
    while left := _processes(part):  # again, as they may have started others
        for process in left:
            with suppress(psutil.NoSuchProcess):
                process.kill()
        psutil.wait_procs(left, 1.0)


if __name__ == "__main__":
    main(*sys.argv[1:])
