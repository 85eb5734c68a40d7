# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Files that are there whole or not at all, and names that any text may hold."""

import contextlib
import os
from pathlib import Path


def write_whole(path: Path, content: bytes | memoryview | str) -> None:
    """Write a file, text as UTF-8; where that fails, what was there before is there still.

    The content is made in memory first: libraries that fill a file leave half of it on a full
    disk, and do not say which.

    Raises
    ------
    OSError
        Naming the file and the reason.
    """
    data = content.encode() if isinstance(content, str) else content
    fresh = path.with_name(f".{path.stem}.part{path.suffix}")
    try:
        fresh.write_bytes(data)
        os.replace(fresh, path)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from None
    finally:
        with contextlib.suppress(OSError):
            fresh.unlink(missing_ok=True)


def as_text(name: str) -> str:
    """Return a file name as text that can be drawn and written.

    Names that the locale cannot decode hold their bytes in another form, which no encoding takes.
    """
    return os.fsencode(name).decode("utf-8", errors="replace")
