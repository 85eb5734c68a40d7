# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Errors of a study."""

from pathlib import Path

from sphere_nmpc.errors import SphereNmpcError


class NotWrittenError(SphereNmpcError):
    """A file of results cannot be written; its previous content is kept.

    Parameters
    ----------
    path : Path
        The file.
    error : OSError
        Why not.
    """

    def __init__(self, path: Path, error: OSError) -> None:
        reason = (error.strerror or str(error)).lower()
        super().__init__(
            f"{path}: cannot be written: {reason}; the same command continues from the runs made"
        )


class WorkersError(SphereNmpcError):
    """Processes or cluster cannot be started or reached, or a worker process ended."""
