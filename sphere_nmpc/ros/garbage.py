# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Garbage collection at chosen intervals, rather than whenever enough objects have been made.

Almost everything is freed by its reference count; the collector only finds cycles. Left to
itself it looks at all objects made since the start every few seconds, in the middle of a sample,
for longer than a control period of 2 ms.
"""

import gc

_YOUNG_EVERY = 0.25
"""Time between two collections of new objects [s], each of which takes some 0.1 ms."""
_ALL_EVERY = 300.0
"""Time between two collections of all objects made since the start [s]."""
_MIDDLE, _OLDEST = 1, 2


class GarbageCollection:
    """Collector that runs when it is called and due, and not otherwise within its context.

    Parameters
    ----------
    now : float
        Steady clock at the start [s].
    """

    def __init__(self, now: float) -> None:
        self._young_at = self._all_at = now

    def __enter__(self) -> "GarbageCollection":
        # Objects that exist as long as the process are excluded: with them a full collection
        # takes tens of milliseconds.
        gc.collect()
        gc.freeze()
        gc.disable()
        return self

    def __exit__(self, *exception: object) -> None:
        gc.enable()
        gc.unfreeze()

    def collect_if_due(self, now: float) -> None:
        """Collect new objects or all, whatever is due at `now` [s, steady clock]."""
        if now < self._young_at + _YOUNG_EVERY:
            return
        self._young_at = now
        if now < self._all_at + _ALL_EVERY:
            gc.collect(_MIDDLE)
        else:
            self._all_at = now
            gc.collect(_OLDEST)
