# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""What can go wrong with a study."""

from pathlib import Path

from sphere_nmpc.errors import SphereNmpcError


class StudyFolderError(SphereNmpcError):
    """A folder cannot take the results of a study; nothing in it was changed.

    Parameters
    ----------
    folder : Path
        The folder.
    reason : str
        Why not, in words.
    """

    exit_code = 2

    def __init__(self, folder: Path, reason: str) -> None:
        super().__init__(f"{folder}: {reason}")
        self.folder = folder
        self.reason = reason


class NotWrittenError(StudyFolderError):
    """A file of results cannot be written; what was there before it is kept.

    Parameters
    ----------
    path : Path
        The file.
    error : OSError
        Why not.
    """

    exit_code = 1

    def __init__(self, path: Path, error: OSError) -> None:
        reason = (error.strerror or str(error)).lower()
        super().__init__(
            path, f"cannot be written: {reason}; the same command goes on from the runs made"
        )


class WorkersError(SphereNmpcError):
    """The processes that should run the scenarios cannot be reached, or died."""
