# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Several child processes that are checked and ended together."""

import signal
from collections.abc import Iterator, Sequence
from pathlib import Path

from sphere_nmpc.child import END_SIGNALS
from sphere_sim.ros.session.child_process import ChildProcess, stop_together, verb_command


class ProcessSet:
    """Child processes by name, all of which are ended when the context is left.

    A second Ctrl-C while they are being ended is ignored, as it would leave processes behind.
    Their output goes to the folder `logs`, a file ``NAME.log`` each.
    """

    def __init__(self, logs: Path) -> None:
        self._logs = logs
        self._processes: dict[str, ChildProcess] = {}

    def __enter__(self) -> "ProcessSet":
        return self

    def __exit__(self, *exception: object) -> None:
        earlier = {number: signal.signal(number, signal.SIG_IGN) for number in END_SIGNALS}
        try:
            self.stop()
        finally:
            for number, handler in earlier.items():
                signal.signal(number, handler)

    def __getitem__(self, name: str) -> ChildProcess:
        return self._processes[name]

    def __iter__(self) -> Iterator[ChildProcess]:
        return iter(self._processes.values())

    def add(self, name: str, command: Sequence[str], append: bool = False) -> ChildProcess:
        """Add a process, which is not started yet; see `ChildProcess` for the arguments."""
        process = ChildProcess(name, command, self._logs / f"{name}.log", append)
        self._processes[name] = process
        return process

    def start(
        self, verb: str, arguments: Sequence[str] = (), within: Sequence[str] = (), name: str = ""
    ) -> ChildProcess:
        """Start ``sphere_nmpc VERB ARGUMENTS``; its name is by default the verb.

        A command may be in front of it, such as ``nice``, that replaces itself by the verb: a
        signal to the one has to reach the other.
        """
        process = self.add(name or verb, [*within, *verb_command(verb, *arguments)])
        process.start()
        return process

    @property
    def pids(self) -> dict[str, int]:
        """The process ids by name."""
        return {process.name: process.pid for process in self}

    def check(self) -> None:
        """Raise `ChildEndedError` if one of them has ended."""
        for process in self:
            process.check()

    def stop(self, *names: str) -> None:
        """End the named processes, or all, at the same time, and remove them from the set."""
        ended = names or tuple(self._processes)
        stop_together([self._processes[name] for name in ended])
        # Not before: what an interrupt leaves running has to be ended when the context is left.
        for name in ended:
            del self._processes[name]
