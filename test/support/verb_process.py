# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Verbs of the command in child processes, which end with the test session."""

import re
from pathlib import Path

from sphere_nmpc.process.child import Child
from sphere_sim.ros.session.process_set import verb_command


def start(folder: Path, verb: str, *arguments: str) -> Child:
    """Start ``sphere_nmpc VERB ARGUMENTS`` with its output in ``VERB.log`` in a folder."""
    return Child(verb_command(verb, *arguments), verb, folder / f"{verb}.log").start()


def page_of(viewer: Child) -> str:
    """Return the address that a viewer has printed; empty before."""
    found = re.search(r"http://\S+", viewer.output)
    return found.group() if found else ""
