# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Nodes as child processes: started together, watched, and all gone at the end."""

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from sphere_nmpc.errors import SphereNmpcError

_PATIENCE = ((signal.SIGINT, 6.0), (signal.SIGTERM, 3.0), (signal.SIGKILL, 2.0))
"""What to send to a process that should end, and how long to wait after it [s]."""
_LAST_LINES = 12


class ChildDiedError(SphereNmpcError):
    """A node ended before it was asked to.

    Parameters
    ----------
    name : str
        The verb that was run.
    code : int
        Its exit code.
    log : Path
        Where its output went.
    """

    def __init__(self, name: str, code: int, log: Path) -> None:
        ended = f"exit code {code}" if code >= 0 else f"signal {signal.Signals(-code).name}"
        lines = log.read_text(errors="replace").splitlines()[-_LAST_LINES:]
        told = "\n".join(f"  {line}" for line in lines) or "  (it said nothing)"
        super().__init__(f"the {name} ended early, {ended}; its last words:\n{told}")


@dataclass
class _Child:
    process: subprocess.Popen[bytes]
    log: Path


class Children:
    """Child processes, each in a session of its own with its output in a file.

    Their names are those of their verbs, unless others are given.

    Leaving the context ends them all: SIGINT first, then less politely. A terminal's Ctrl-C
    reaches the parent only, which decides in which order they end.

    Parameters
    ----------
    logs : Path
        Folder for their output.
    """

    def __init__(self, logs: Path) -> None:
        self._logs = logs
        self._children: dict[str, _Child] = {}

    def __enter__(self) -> "Children":
        return self

    def __exit__(self, *exception: object) -> None:
        with _deaf():
            self.stop(*self._children)

    def start(
        self, verb: str, arguments: Sequence[str], within: Sequence[str] = (), name: str = ""
    ) -> None:
        """Start ``sphere_nmpc VERB ARGUMENTS``, by a command such as ``nice`` where one is given.

        That command has to become the node, not to start it: who ends it ends the node. Several
        children of one verb need a name each.
        """
        name = name or verb
        log = self._logs / f"{name}.log"
        node = [sys.executable, "-m", "sphere_sim.cli.child", str(os.getpid()), verb]
        with log.open("wb") as output:
            process = subprocess.Popen(
                [*within, *node, *arguments],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
        self._children[name] = _Child(process, log)

    @property
    def pids(self) -> dict[str, int]:
        """The processes by name."""
        return {name: child.process.pid for name, child in self._children.items()}

    def check(self) -> None:
        """Raise if one has ended.

        Raises
        ------
        ChildDiedError
            With the last lines it wrote.
        """
        for name, child in self._children.items():
            code = child.process.poll()
            if code is not None:
                raise ChildDiedError(name, code, child.log)

    def stop(self, *names: str) -> None:
        """End some of them, at the same time, and wait until they are gone."""
        children = [self._children.pop(name) for name in names if name in self._children]
        for number, patience in _PATIENCE:
            alive = [child for child in children if child.process.poll() is None]
            for child in alive:
                # The group, for what the node itself may have started.
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(child.process.pid, number)
            end = time.monotonic() + patience
            for child in alive:
                with contextlib.suppress(subprocess.TimeoutExpired):
                    child.process.wait(max(0.0, end - time.monotonic()))


@contextlib.contextmanager
def _deaf() -> Iterator[None]:
    """Let no signal interrupt the end of the children: a second Ctrl-C would leave orphans."""
    numbers = (signal.SIGINT, signal.SIGTERM)
    earlier = [signal.signal(number, signal.SIG_IGN) for number in numbers]
    try:
        yield
    finally:
        for number, handler in zip(numbers, earlier, strict=True):
            signal.signal(number, handler)
