# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Files that a user names: where they are, and their content, read in bounded time and memory."""

import os
import stat
import sys
from pathlib import Path
from typing import Any, BinaryIO

from sphere_nmpc.errors import Description, InvalidValueError

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
        folder for folder in (*folders, Path(__file__).parents[2])
        if (folder / "package.xml").is_file()
    ]


def open_file(path: Path, most_bytes: float = float("inf")) -> BinaryIO:
    """Open a regular file of at most so many bytes to be read.

    `InvalidFileError` is raised for any other file, and `OSError` where there is none that can be
    read.
    """
    if "\0" in str(path):
        raise InvalidFileError(str(path), "a name with a NUL", "the name of a file")
    # Before it is opened, which is an action for some devices ...
    _check(path, os.stat(path), most_bytes)
    # ... and afterwards, as it may be another one by now; without O_NONBLOCK, a pipe without a
    # writer could not be opened at all.
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    file = open(descriptor, "rb")  # noqa: SIM115
    try:
        _check(path, os.fstat(descriptor), most_bytes)
    except InvalidFileError:
        file.close()
        raise
    return file


def read_file(path: Path, most_bytes: int) -> bytes:
    """Return the content of a regular file of at most so many bytes; raises as `open_file`."""
    with open_file(path, most_bytes) as file:
        content = file.read(most_bytes + 1)
    if len(content) > most_bytes:
        raise InvalidFileError(str(path), "a file that grows", f"at most {most_bytes} bytes")
    return content


def yaml_texts(text: str | bytes, deepest: int) -> Any:
    """Return a YAML document as mappings and lists of texts, whatever types YAML gives these.

    Of several entries of one name the first is in force. `InvalidFileError` is raised for aliases
    and for more than `deepest` levels of lists and mappings; the parser raises many kinds.
    """
    import yaml

    values: list[Any] = []
    open_values = [values]  # keys and values in turn of those that are mappings
    for event in yaml.parse(text, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader)):
        if isinstance(event, yaml.ScalarEvent):
            open_values[-1].append(event.value)
        elif isinstance(event, yaml.CollectionStartEvent):
            # The parser takes minutes for thousands of brackets.
            if len(open_values) > deepest:
                raise InvalidFileError("YAML", "lists in lists", f"at most {deepest} levels")
            open_values.append([])
        elif isinstance(event, yaml.CollectionEndEvent):
            inner: Any = open_values.pop()
            if isinstance(event, yaml.MappingEndEvent):
                pairs = list(zip(inner[::2], inner[1::2], strict=True))
                inner = {key: value for key, value in reversed(pairs) if isinstance(key, str)}
            open_values[-1].append(inner)
        elif isinstance(event, yaml.AliasEvent):
            # A few lines of aliases of aliases are a value that no memory can hold.
            raise InvalidFileError("YAML", "an alias", "each value written out")
        elif isinstance(event, yaml.DocumentEndEvent):
            break
    return values[0] if values else None


def _check(path: Path, found: os.stat_result, most_bytes: float) -> None:
    if not stat.S_ISREG(found.st_mode):
        kind = _KINDS.get(stat.S_IFMT(found.st_mode), "something else")
        raise InvalidFileError(str(path), kind, "a regular file")
    if found.st_size > most_bytes:
        raise InvalidFileError(
            str(path), f"{found.st_size} bytes", f"at most {most_bytes} bytes"
        )
