# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""End of all processes of a test run when the run has ended, for whatever reason."""

import os
import subprocess
import sys

import psutil

_MARK = "SPHERE_NMPC_TEST_RUN"
"""Environment variable that all processes of a run inherit: the process id of the run."""


def end_with_this_process() -> None:
    """Let all that this process starts from now on be killed when it ends, for whatever reason.

    Processes in between that end earlier, such as shells, change nothing. A worker of a run, which
    inherits the variable, leaves it to the run.
    """
    if _MARK in os.environ:
        return
    os.environ[_MARK] = run = str(os.getpid())
    reading, _ = os.pipe()  # the other end is closed with this process, and is not inherited
    # A session of its own: no signal to the group of the run ends it.
    subprocess.Popen([sys.executable, __file__, run], stdin=reading, start_new_session=True)
    os.close(reading)


def _processes(run: str) -> list[psutil.Process]:
    """Return the processes of a run other than this one, also those whose parent has ended."""
    found = []
    for process in psutil.process_iter():
        try:
            if process.pid != os.getpid() and process.environ().get(_MARK) == run:
                found.append(process)
        except psutil.Error:  # it has ended, or is of another user
            continue
    return found


if __name__ == "__main__":
    sys.stdin.read()  # until the run has ended, and with it the other end of the pipe
    while left := _processes(sys.argv[1]):  # again, as they may have started others
        for process in left:
            process.kill()
        psutil.wait_procs(left, 1.0)
