# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Folders for results, checked before the work whose results go there."""

import tempfile
from pathlib import Path

from sphere_nmpc.errors import SphereNmpcError
from sphere_nmpc.foreign_text import printable_line


class ResultFolderError(SphereNmpcError):
    """A folder cannot take results; nothing in it was changed.

    Parameters
    ----------
    folder : Path
        The folder.
    reason : str
        Why not.
    """

    exit_code = 2

    def __init__(self, folder: Path, reason: str) -> None:
        super().__init__(f"{folder}: {printable_line(reason)}")


def prepare_folder(folder: Path) -> Path:
    """Create a folder unless it exists, write a byte into it and return it.

    Raises
    ------
    ResultFolderError
        If that is not possible.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder) as probe:
            probe.write(b"0")
            probe.flush()
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise ResultFolderError(
            folder, f"{reason}; choose a folder that can be written"
        ) from None
    return folder
