# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Folders for results, looked at before the work that fills them."""

import tempfile
from pathlib import Path

from sphere_nmpc.errors import SphereNmpcError


class PlaceError(SphereNmpcError):
    """A folder cannot take results.

    Parameters
    ----------
    folder : Path
        The folder.
    reason : str
        Why not, in words.
    """

    exit_code = 2

    def __init__(self, folder: Path, reason: str) -> None:
        super().__init__(f"{folder}: {reason}; choose a folder that can be written")


def prepare_folder(folder: Path) -> Path:
    """Make a folder if there is none, write a byte into it and return it.

    Raises
    ------
    PlaceError
        If that is not possible.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder) as probe:
            probe.write(b"0")
            probe.flush()
    except OSError as error:
        raise PlaceError(folder, (error.strerror or str(error)).lower()) from None
    return folder
