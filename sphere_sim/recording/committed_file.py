# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""File whose end is replaced at every commit, so that it is complete at any moment."""

import contextlib
import os
from pathlib import Path

from sphere_sim.recording.errors import BagError


class CommittedFile:
    """New file of a body that grows and a tail that every commit replaces.

    A commit writes new body and tail with one system call, over the tail of the commit before.
    The file is therefore complete on disk at any moment except during that call.

    Parameters
    ----------
    path : Path
        File to create; must not exist.
    header : bytes
        First bytes of the body.

    Raises
    ------
    BagError
        If the file cannot be created or written.
    """

    def __init__(self, path: Path, header: bytes) -> None:
        self._path = path
        self.end = 0
        """Size of the body, at which the next commit begins to write [bytes]."""
        self._tail = b""
        try:
            self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
        except OSError as error:
            raise BagError(path, f"cannot be created: {error.strerror}") from error
        try:
            self.commit(header, b"")
        except BagError:
            self.close()
            raise

    def commit(self, body: bytes, tail: bytes) -> None:
        """Append to the body and replace the tail.

        Raises
        ------
        BagError
            If the disk is full or fails; the file then has the content of the commit before.
        """
        try:
            self._write(body + tail)
        except OSError as error:
            # The blocks of the old tail are still allocated, so that a full disk has space for
            # it; a device that fails or was removed accepts nothing.
            with contextlib.suppress(OSError):
                os.ftruncate(self._file, self.end + len(self._tail))
                os.pwrite(self._file, self._tail, self.end)
            raise BagError(self._path, f"cannot be written: {error.strerror}") from error
        self.end += len(body)
        self._tail = tail

    def close(self) -> None:
        """Close the file; its content is that of the last commit."""
        os.close(self._file)

    def _write(self, data: bytes) -> None:
        """Write `data` behind the body, with one call unless the disk accepts less."""
        position, rest = self.end, memoryview(data)
        while rest:
            written = os.pwrite(self._file, rest, position)
            position += written
            rest = rest[written:]
