# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Faults of the process that searches and learns beside the control loop."""

import contextlib
import os
import signal
from pathlib import Path

from sphere_sim.ros.faults.action import Action
from sphere_sim.ros.faults.fault_session import READY, FaultSession

_PROCESSES = Path("/proc")
_PROGRAM = b"sphere_nmpc.worker.serve"


class SignalWorker(Action):
    """A signal that ends or stops the controller's worker, and SIGCONT at the end.

    Parameters
    ----------
    signal : str
        SIGKILL or SIGSTOP.
    """

    def __init__(self, signal: str) -> None:
        self._signal = signal
        self._pid = 0

    def begin(self, session: FaultSession) -> None:
        """Send the signal; one that was just replaced may not be there yet."""
        controller = session.processes["controller"].pid
        session.wait(lambda: worker_of(controller), READY, "the worker of the controller")
        self._pid = worker_of(controller)
        self._send(signal.Signals[self._signal])

    def end(self, session: FaultSession) -> None:
        """Continue it, unless it has been replaced."""
        self._send(signal.SIGCONT)

    def _send(self, number: signal.Signals) -> None:
        with contextlib.suppress(ProcessLookupError):
            if self._pid:
                os.kill(self._pid, number)


def worker_of(controller: int) -> int:
    """Return the process id of the worker that a process has started; 0 if there is none."""
    for entry in _PROCESSES.iterdir():
        if not entry.name.isdigit():
            continue
        # A process may end while it is looked at.
        with contextlib.suppress(OSError):
            state, parent = (entry / "stat").read_text().rpartition(")")[2].split()[:2]
            if int(parent) == controller and state != "Z" and \
                    _PROGRAM in (entry / "cmdline").read_bytes():
                return int(entry.name)
    return 0
