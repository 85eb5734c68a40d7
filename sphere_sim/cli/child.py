# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Program of a child process: a verb of ``sphere_nmpc`` that ends with its parent process."""

import signal
import sys
from collections.abc import Sequence

from sphere_nmpc.child import END_SIGNALS, end_with_parent
from sphere_sim.cli.main import main as run_verb


def main(arguments: Sequence[str]) -> int:
    """Run the verb that follows the id of the parent; return its exit code."""
    parent, *sys.argv[1:] = arguments
    for number in END_SIGNALS:
        # A parent in the background of a script ignores some, and its children inherit that.
        if signal.getsignal(number) is signal.SIG_IGN:
            signal.signal(number, signal.SIG_DFL)
    end_with_parent(int(parent))
    return run_verb()
