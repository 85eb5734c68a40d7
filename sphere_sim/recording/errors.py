# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""What can go wrong with a recording."""

from pathlib import Path

from sphere_nmpc.errors import SphereNmpcError


class BagError(SphereNmpcError):
    """A recording cannot be written or read; the message says which and why.

    Parameters
    ----------
    path : Path
        The bag.
    reason : str
        What is wrong with it, in words.
    """

    def __init__(self, path: Path, reason: str) -> None:
        super().__init__(f"bag {path}: {reason}")
        self.path = path
        self.reason = reason
