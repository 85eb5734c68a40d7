# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Waiting for a condition while a node is served."""

import time
from collections.abc import Callable


def serve_until(
    spin: Callable[[], object], condition: Callable[[], object], timeout: float
) -> bool:
    """Serve a node by `spin` until a condition holds; return whether it holds.

    The condition is looked at before the node is first served, and each time after that, for
    `timeout` [s, wall time].
    """
    end = time.monotonic() + timeout
    while not condition():
        if time.monotonic() > end:
            return False
        spin()
    return True
