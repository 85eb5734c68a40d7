# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Atomic replacement of files."""

import contextlib
import os
from pathlib import Path


def write_atomically(path: Path, content: bytes | memoryview | str) -> None:
    """Write a file, text as UTF-8; after a failure the previous file is unchanged.

    The complete content is needed in memory: libraries that write a file themselves leave an
    incomplete one on a full disk, and raise errors that do not name it.

    Raises
    ------
    OSError
        If the file cannot be written; the error names the file and the reason.
    """
    data = content.encode() if isinstance(content, str) else content
    temporary = path.with_name(f".{path.stem}.part{path.suffix}")
    try:
        temporary.write_bytes(data)
        os.replace(temporary, path)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from None
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)
