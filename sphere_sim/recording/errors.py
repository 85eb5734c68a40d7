# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Errors of recordings."""

from pathlib import Path

from sphere_nmpc.errors import SphereNmpcError
from sphere_nmpc.foreign_text import printable_line


class BagError(SphereNmpcError):
    """Bag that cannot be written or read; the message names the bag and the reason.

    Parameters
    ----------
    path : Path
        The bag.
    reason : str
        Description of what is wrong with it.
    """

    def __init__(self, path: Path, reason: str) -> None:
        super().__init__(f"bag {path}: {printable_line(reason)}")


def one_line_reason(error: Exception) -> str:
    """Return the message of an error in one line; its type where it has no message."""
    return " ".join(str(error).split()).rstrip(".") or type(error).__name__
