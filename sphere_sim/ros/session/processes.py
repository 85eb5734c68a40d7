# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Nodes as processes that can be killed, held and started again."""

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

_PATIENCE = ((signal.SIGINT, 6.0), (signal.SIGKILL, 2.0))
"""What to send to a process that should end, and how long to wait after it [s]."""


class NodeProcess:
    """A process with its output in a file, which each life of it continues.

    Parameters
    ----------
    name : str
        For people and for the file.
    command : sequence of str
        Module and its arguments, after ``python -m``.
    logs : Path
        Folder of the file.
    """

    def __init__(self, name: str, command: Sequence[str], logs: Path) -> None:
        self.name = name
        self.command = list(command)
        self.log = logs / f"{name}.log"
        self._process: subprocess.Popen[bytes] | None = None

    @property
    def pid(self) -> int:
        """Its process id; 0 while there is none."""
        return 0 if self._process is None else self._process.pid

    @property
    def code(self) -> int | None:
        """Its exit code, None while it runs or before it ran."""
        return None if self._process is None else self._process.poll()

    def start(self, extra: Sequence[str] = ()) -> None:
        """Start it, with further arguments; one that still runs is ended first."""
        self.stop()
        with self.log.open("ab") as output:
            self._process = subprocess.Popen(
                [sys.executable, "-m", *self.command, *extra], stdin=subprocess.DEVNULL,
                stdout=output, stderr=subprocess.STDOUT, start_new_session=True,
            )

    def send(self, number: signal.Signals) -> None:
        """Send a signal to it and what it started."""
        if self._process is not None and self._process.poll() is None:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self._process.pid, number)

    def kill(self) -> str:
        """End it as ``kill -9`` does and return how it ended."""
        self.send(signal.SIGKILL)
        return self.wait(5.0)

    def wait(self, timeout: float) -> str:
        """Wait for its end and return how it ended, in words."""
        if self._process is None:
            return f"{self.name} was never started"
        code = self._process.wait(timeout)
        told = signal.Signals(-code).name if code < 0 else f"exit code {code}"
        return f"{self.name} ended, {told}"

    def stop(self) -> None:
        """End it politely, then less so."""
        self.send(signal.SIGCONT)
        for number, patience in _PATIENCE:
            if self._process is None or self._process.poll() is not None:
                return
            self.send(number)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(patience)

    def tracebacks(self) -> int:
        """Return how many errors nobody caught it has printed in all its lives."""
        return self.log.read_text(errors="replace").count("Traceback (most recent call last)")


def stop_together(processes: Sequence[NodeProcess]) -> None:
    """End several processes without waiting for one after the other."""
    for process in processes:
        process.send(signal.SIGCONT)
        process.send(signal.SIGINT)
    end = time.monotonic() + _PATIENCE[0][1]
    while time.monotonic() < end and any(p.pid and p.code is None for p in processes):
        time.sleep(0.02)
    for process in processes:
        process.stop()
