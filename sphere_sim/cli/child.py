# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Program of a child process: a verb of ``sphere_nmpc`` that ends with its parent process."""

import sys
from collections.abc import Sequence

from sphere_sim.cli.main import main as run_verb
from sphere_sim.ros.session.parent import end_with_parent


def main(arguments: Sequence[str]) -> int:
    """Run the verb that follows the id of the parent; return its exit code."""
    parent, *sys.argv[1:] = arguments
    end_with_parent(int(parent))
    return run_verb()
