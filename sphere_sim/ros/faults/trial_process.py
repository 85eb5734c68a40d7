# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""A process that runs trials in nodes and a ROS domain of its own."""

import contextlib
import itertools
import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NoReturn

from sphere_nmpc.child_command import module_command
from sphere_nmpc.end_signals import TERMINAL_SIGNALS
from sphere_nmpc.errors import SphereNmpcError
from sphere_nmpc.worker.channel import Channel, encoded
from sphere_sim.faults.catalogue import Fault
from sphere_sim.faults.outcome import Outcome
from sphere_sim.ros.faults.fault_session import SessionSettings, fault_session
from sphere_sim.ros.faults.trial import Trial
from sphere_sim.ros.session.domain import own_domain
from sphere_sim.ros.session.parent import end_with_parent

_ENDED_WITHIN = 30.0
"""Longest wait for a process that ends its nodes [s]."""


class TrialsError(SphereNmpcError):
    """The nodes cannot be started, or a process of the campaign has ended."""


@dataclass(frozen=True)
class TrialPlan:
    """A trial that is to be run.

    Attributes
    ----------
    faults : tuple of Fault
        What is caused at the same time.
    repetition : int
        Number among the trials of the same faults; it determines the random numbers.
    """

    faults: tuple[Fault, ...]
    repetition: int = 0


class TrialProcess:
    """Process that runs one trial after another; it starts with the first.

    Parameters
    ----------
    settings : SessionSettings
        Settings of its sessions; each has a folder of its own in the given one.
    """

    def __init__(self, settings: SessionSettings) -> None:
        self.link, theirs = Channel.pair()
        with contextlib.closing(theirs):
            self._process = subprocess.Popen(
                module_command(__name__, str(theirs.fileno()), str(os.getpid())),
                stdin=subprocess.DEVNULL, pass_fds=[theirs.fileno()],
            )
        self._send(settings)

    def begin(self, plan: TrialPlan | None) -> None:
        """Begin a trial, or end the process with None."""
        self._send(plan)

    def outcome(self) -> tuple[Outcome, tuple[Path, ...]]:
        """Wait for the outcome of the trial and return it with the bags that are to be judged.

        Raises
        ------
        TrialsError
            If the nodes cannot be started, or the process has ended.
        """
        try:
            received = self.link.receive()
        except (EOFError, OSError):
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(_ENDED_WITHIN)
            raise TrialsError(
                f"a process of the campaign ended, exit code {self._process.returncode}"
            ) from None
        if isinstance(received, str):
            raise TrialsError(received)
        outcome, bags = received
        return outcome, bags

    def close(self) -> None:
        """End process and nodes, also during a trial."""
        self._process.terminate()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(_ENDED_WITHIN)
        self._process.kill()
        self._process.wait()
        self.link.close()

    def _send(self, message: SessionSettings | TrialPlan | None) -> None:
        with contextlib.suppress(BrokenPipeError):  # `outcome` reports why it has ended
            self.link.send(encoded(message))


def main(argv: Sequence[str]) -> int:
    """Run trials until None is received; after one that was not survived nodes are restarted.

    The arguments are the file descriptor of the channel and the id of the parent.
    """
    for number in TERMINAL_SIGNALS:
        signal.signal(number, signal.SIG_IGN)  # the parent decides
    signal.signal(signal.SIGTERM, _end)
    end_with_parent(int(argv[1]))
    link = Channel.inherited(int(argv[0]))
    settings: SessionSettings = link.receive()
    folders = (settings.folder / f"session_{i}" for i in itertools.count(1))
    try:
        with own_domain():
            plan = link.receive()
            while plan is not None:
                folder = next(folder for folder in folders if not folder.exists())
                with fault_session(replace(settings, folder=folder)) as session:
                    while plan is not None:
                        trial = Trial(session, plan.faults, plan.repetition)
                        outcome = trial.run()
                        link.send(encoded((outcome, trial.bags)))
                        plan = link.receive()
                        if not outcome.survived:
                            break
    except SphereNmpcError as error:
        link.send(encoded(str(error)))
    except EOFError:  # the parent has ended
        pass
    return 0


def _end(*_: object) -> NoReturn:
    sys.exit(1)
