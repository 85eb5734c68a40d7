# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Waiting for a condition while a node is served."""

import time
from collections.abc import Callable


def serve_until(
    spin: Callable[[], object], condition: Callable[[], object], timeout: float
) -> bool:
    """Serve a node until a condition holds.

    Parameters
    ----------
    spin : callable
        Serves the node for a moment.
    condition : callable
        Returns whether the condition holds; called before the node is first served, and each time
        after that.
    timeout : float
        Wall time after which the wait is given up [s].

    Returns
    -------
    bool
        Whether the condition holds.
    """
    end = time.monotonic() + timeout
    while not condition():
        if time.monotonic() > end:
            return False
        spin()
    return True
