# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Cache file of the best known times."""

import contextlib
import json
import logging
import math
from pathlib import Path

import numpy as np

from sphere_nmpc.cache import make_private

_log = logging.getLogger("sphere_nmpc")


class BestKnownCache:
    """Times found earlier, by key; a file that cannot be used is a warning and costs time only.

    Parameters
    ----------
    path : Path
        The file; created with the first time that is added. Of a key that is there several times
        the shortest time counts; lines that are damaged are skipped.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._is_usable = True
        self.known: dict[str, float] = {}
        """Times [s] by key; nan where a search found no motion."""
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
                key, seconds = json.loads(line.decode())
                if not (float(seconds) < 0.0 or math.isinf(seconds)):
                    self.known[str(key)] = float(np.fmin(self.known.get(key, np.nan), seconds))

    def add(self, key: str, seconds: float) -> None:
        """Keep a time [s], also in the file where that is possible."""
        self.known[key] = seconds
        if not self._is_usable:
            return
        try:
            make_private(self._path.parent)
            with self._path.open("a", encoding="utf-8") as file:
                file.write(json.dumps([key, seconds]) + "\n")
        except OSError as error:
            self._warn("written", error)

    def _warn(self, what: str, error: OSError) -> None:
        self._is_usable = False
        _log.warning(
            "sphere_nmpc study: %s cannot be %s (%s); best known times are not kept, and searched "
            "for again next time", self._path, what, error.strerror or error,
        )
