# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Verbs of the command in child processes, which end with the test session."""

import signal
import subprocess
from collections.abc import Iterable
from pathlib import Path

from sphere_sim.ros.session.child_process import verb_command


def start(folder: Path, verb: str, *arguments: str) -> subprocess.Popen:
    """Start ``sphere_nmpc VERB ARGUMENTS`` with its output in ``VERB.log`` in a folder."""
    with (folder / f"{verb}.log").open("wb") as log:
        return subprocess.Popen(verb_command(verb, *arguments), stdout=log, stderr=log)


def stop(processes: Iterable[subprocess.Popen]) -> None:
    """Interrupt all processes, then wait for their end; kill those that do not end."""
    interrupted = list(processes)
    for process in interrupted:
        process.send_signal(signal.SIGINT)
    for process in interrupted:
        try:
            process.wait(8.0)
        except subprocess.TimeoutExpired:
            process.kill()
