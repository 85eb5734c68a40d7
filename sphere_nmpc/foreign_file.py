# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Files that a user names: where they are, and their content, read in bounded time and memory."""

import os
import stat
import sys
from pathlib import Path

from sphere_nmpc.errors import InvalidValueError
from sphere_nmpc.foreign_text import Description

_KINDS = {
    stat.S_IFDIR: "a folder", stat.S_IFIFO: "a pipe", stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device", stat.S_IFBLK: "a device",
}


class InvalidFileError(InvalidValueError):
    """File that is none with a content of its own, such as a pipe, or is too large.

    What is `given` is described.
    """

    def __init__(self, name: str, given: str, expected: str) -> None:
        super().__init__(name, Description(given), expected)


def find_file(path: Path) -> Path:
    """Return the absolute path of a file that a user names; ``~`` is the user's home.

    A relative path is looked for in the working directory, then among the files that come with
    the package. `InvalidFileError` is raised if there is none, and says where was looked.
    """
    named = Path(os.path.expanduser(path))
    folders = [Path("/")] if named.is_absolute() else [Path.cwd(), *_package_folders()]
    places = list(dict.fromkeys(folder / named for folder in folders))
    for place in places:
        if place.exists():
            return place
    looked = " or ".join(str(place) for place in places)
    raise InvalidFileError(str(path), "no such file", f"an existing file at {looked}")


def _package_folders() -> list[Path]:
    """Return the folders with the files that come with the package: installed, and its source."""
    prefixes = [*os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep), sys.prefix]
    folders = [Path(prefix, "share", "sphere_nmpc") for prefix in prefixes if prefix]
    return [
        folder for folder in (*folders, Path(__file__).parents[1])
        if (folder / "package.xml").is_file()
    ]


def read_file(path: Path, most_bytes: int) -> bytes:
    """Return the content of a regular file of at most so many bytes.

    `InvalidFileError` is raised for any other file, and `OSError` where there is none that can be
    read.
    """
    # Before it is opened, which is an action for some devices ...
    _check(path, os.stat(path), most_bytes)
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    with open(descriptor, "rb") as file:
        # ... and afterwards, as it may be another one by now; without O_NONBLOCK, a pipe without
        # a writer could not be opened at all.
        _check(path, os.fstat(descriptor), most_bytes)
        content = file.read(most_bytes + 1)
    if len(content) > most_bytes:
        raise InvalidFileError(str(path), "a file that grows", f"at most {most_bytes} bytes")
    return content


def _check(path: Path, found: os.stat_result, most_bytes: int) -> None:
    if not stat.S_ISREG(found.st_mode):
        kind = _KINDS.get(stat.S_IFMT(found.st_mode), "something else")
        raise InvalidFileError(str(path), kind, "a regular file")
    if found.st_size > most_bytes:
        raise InvalidFileError(
            str(path), f"{found.st_size} bytes", f"at most {most_bytes} bytes"
        )
