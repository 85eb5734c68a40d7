# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""File names as text that can be encoded."""

import os


def printable(path: str | os.PathLike[str]) -> str:
    """Return a file name or path as text that every Unicode encoding accepts.

    Python represents bytes of a name that the locale cannot decode by lone surrogates, which
    cannot be encoded as UTF-8.
    """
    return os.fsencode(path).decode("utf-8", errors="replace")
