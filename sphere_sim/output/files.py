# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Files and folders of results."""

import contextlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

from sphere_nmpc.errors import SphereNmpcError, printable_line


class ResultFolderError(SphereNmpcError):
    """A folder cannot take results, for a reason; nothing in it was changed."""

    exit_code = 2

    def __init__(self, folder: Path, reason: str) -> None:
        super().__init__(f"{folder}: {printable_line(reason)}")


def prepare_folder(folder: Path) -> Path:
    """Create a folder unless it exists, write a byte into it and return it."""
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


def write_atomically(path: Path, content: bytes | memoryview | str) -> None:
    """Write a file, text as UTF-8; after a failure the previous file is unchanged.

    The complete content is needed in memory: libraries that write a file themselves leave an
    incomplete one on a full disk, and raise errors that do not name it, as OSError here does.
    """
    with replacing(path, content):
        pass


@contextlib.contextmanager
def replacing(path: Path, content: bytes | memoryview | str) -> Iterator[None]:
    """Write a file beside its previous version, which it replaces unless the block raises.

    What cannot be written is known before the block begins; errors are those of OSError.
    """
    data = content.encode() if isinstance(content, str) else content
    temporary = path.with_name(f".{path.stem}.part{path.suffix}")
    try:
        temporary.write_bytes(data)
        yield
        os.replace(temporary, path)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from None
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


def printable(path: str | os.PathLike[str]) -> str:
    """Return a file name or path as text that every Unicode encoding accepts.

    Python represents bytes of a name that the locale cannot decode by lone surrogates, which
    cannot be encoded as UTF-8.
    """
    return os.fsencode(path).decode("utf-8", errors="replace")
