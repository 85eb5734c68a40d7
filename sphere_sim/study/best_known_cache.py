# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Cache file of the best known times."""

import contextlib
import json
import logging
import math
from pathlib import Path
from typing import NamedTuple

_log = logging.getLogger("sphere_nmpc")


class BestKnownTimes(NamedTuple):
    """Times of the fastest motion that was found; nan if none.

    Attributes
    ----------
    duration : float
        Time from the start to rest at the goal [s].
    settling : float
        Time from the start on from which the error stays below `SETTLED_ERROR` [s], somewhat
        before the end of the motion: what the settling time of a run is compared with.
    """

    duration: float
    settling: float


class BestKnownCache:
    """Times found earlier, by key; a file that cannot be used is a warning and costs time only.

    Parameters
    ----------
    path : Path
        The file; created with the first times that are added. Of a key that is there several
        times the shortest motion counts; lines that are damaged are skipped.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._is_usable = True
        self.known: dict[str, BestKnownTimes] = {}
        """Times by key."""
        try:
            # Reading anything but a regular file might never end.
            if path.exists() and not path.is_file():
                raise OSError("not a file")
            text = path.read_bytes() if path.exists() else b""
        except OSError as error:
            self._warn("read", error)
            return
        # A crash may leave a line incomplete.
        for line in text.splitlines():
            with contextlib.suppress(ValueError, TypeError, RecursionError):
                key, *seconds = json.loads(line.decode())
                found = BestKnownTimes(*map(float, seconds))
                if any(time < 0.0 or math.isinf(time) for time in found):
                    continue
                if not self.known.get(str(key), found).duration < found.duration:
                    self.known[str(key)] = found

    def add(self, key: str, found: BestKnownTimes) -> None:
        """Keep times, also in the file where that is possible."""
        self.known[key] = found
        if not self._is_usable:
            return
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            with self._path.open("a", encoding="utf-8") as file:
                file.write(json.dumps([key, *found]) + "\n")
        except OSError as error:
            self._warn("written", error)

    def _warn(self, what: str, error: OSError) -> None:
        self._is_usable = False
        _log.warning(
            "sphere_nmpc study: %s cannot be %s (%s); best known times are not kept, and searched "
            "for again next time", self._path, what, error.strerror or error,
        )
