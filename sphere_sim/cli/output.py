# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Standard output and standard error whose loss does not end the command.

A pipe whose reader has ended (``| head -1``) or a full disk makes a write fail. The command then
continues, so that its results are kept, and further output is discarded.
"""

import errno
import io
import os
import sys
from typing import Any, TextIO


class LossyFile(io.FileIO):
    """An open file descriptor whose writes never fail.

    Parameters
    ----------
    descriptor : int
        Stays open.
    """

    def __init__(self, descriptor: int) -> None:
        super().__init__(descriptor, "w", closefd=False)
        self.failure: OSError | None = None
        """The error of the first write that failed; None before."""

    def write(self, data: Any, /) -> int:
        """Write all of the data, or discard the rest if that is not possible."""
        rest = memoryview(data).cast("B")
        size = rest.nbytes
        try:
            while rest:
                rest = rest[super().write(rest) :]
        except OSError as error:
            self.failure = self.failure or error
        return size


class Output:
    """The standard streams of a command's process."""

    def __init__(self) -> None:
        self._files: list[LossyFile] = []

    def install(self) -> None:
        """Replace ``sys.stdout`` and ``sys.stderr``.

        Characters that the encoding of the terminal lacks are written as backslash escapes.
        """
        sys.stdout = self._lossy(sys.stdout, 1)
        sys.stderr = self._lossy(sys.stderr, 2)

    def failure(self) -> str:
        """Return why standard output was lost; empty if it was not, or if its reader has ended."""
        sys.stdout.flush()
        error = self._files[0].failure if self._files else None
        if error is None or error.errno == errno.EPIPE:
            return ""
        return f"standard output: {error.strerror}"

    def _lossy(self, stream: TextIO | None, descriptor: int) -> TextIO:
        if stream is None:
            # Closed by the caller: the next file that is opened would get its descriptor.
            descriptor = os.open(os.devnull, os.O_WRONLY)
        file = LossyFile(descriptor)
        self._files.append(file)
        # As with PYTHONUNBUFFERED, where output is not buffered up to the end of a line.
        unbuffered = bool(getattr(stream, "write_through", False))
        return io.TextIOWrapper(
            file if unbuffered else io.BufferedWriter(file),
            encoding=getattr(stream, "encoding", "utf-8"),
            errors="backslashreplace",
            line_buffering=bool(getattr(stream, "line_buffering", False)),
            write_through=unbuffered,
        )
