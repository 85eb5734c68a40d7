# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Several child processes that are checked and ended together."""

import signal
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from sphere_nmpc.process.child import END_SIGNALS, Child, python_command, stop_together


def verb_command(verb: str, *arguments: str) -> list[str]:
    """Return the command line of ``sphere_nmpc VERB ARGUMENTS`` as a child of this process."""
    return python_command(
        "from sphere_sim.cli.main import main; sys.exit(main())", verb, *arguments
    )


def parameter_options(parameters: Mapping[str, object]) -> list[str]:
    """Return the ROS arguments ``-p NAME:=VALUE`` of parameters."""
    texts = {
        name: str(value).lower() if isinstance(value, bool) else str(value)
        for name, value in parameters.items()
    }
    return [part for name, text in texts.items() for part in ("-p", f"{name}:={text}")]


class ProcessSet:
    """Child processes by name, all of which are ended when the context is left.

    A second Ctrl-C while they are being ended is ignored, as it would leave processes behind.
    Their output goes to the folder `logs`, a file ``NAME.log`` each.
    """

    def __init__(self, logs: Path) -> None:
        self._logs = logs
        self._processes: dict[str, Child] = {}

    def __enter__(self) -> "ProcessSet":
        return self

    def __exit__(self, *exception: object) -> None:
        earlier = {number: signal.signal(number, signal.SIG_IGN) for number in END_SIGNALS}
        try:
            self.stop()
        finally:
            for number, handler in earlier.items():
                signal.signal(number, handler)

    def __getitem__(self, name: str) -> Child:
        return self._processes[name]

    def __iter__(self) -> Iterator[Child]:
        return iter(self._processes.values())

    def add(self, name: str, command: Sequence[str], append: bool = False) -> Child:
        """Add a process, which is not started yet; see `Child` for the arguments."""
        process = Child(command, name, self._logs / f"{name}.log", append)
        self._processes[name] = process
        return process

    def start(
        self, verb: str, arguments: Sequence[str] = (), within: Sequence[str] = (), name: str = ""
    ) -> Child:
        """Start ``sphere_nmpc VERB ARGUMENTS``; its name is by default the verb.

        A command may be in front of it, such as ``nice``, that replaces itself by the verb: a
        signal to the one has to reach the other.
        """
        return self.add(name or verb, [*within, *verb_command(verb, *arguments)]).start()

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
