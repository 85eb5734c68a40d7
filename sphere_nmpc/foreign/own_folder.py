# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Folders of this user alone, and files in them that a run keeps for the next one."""

import contextlib
import json
import os
import stat
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Generic, TypeVar

from sphere_nmpc.foreign.file import read_file

T = TypeVar("T")
_MAX_BYTES = 1_000_000
"""Size of a kept file: several times that of the longest list of goals."""


def cache_folder() -> Path:
    """Return the user's folder for files that are kept between runs; see `own_folder`.

    A bare user id in a container has no home, and that of a system user, such as /nonexistent,
    does not exist and is not to be made, not even by root.
    """
    home = os.path.expanduser("~")
    base = os.environ.get("XDG_CACHE_HOME") or (os.path.isdir(home) and f"{home}/.cache")
    if not base or not os.path.isabs(base):
        return Path(tempfile.gettempdir(), f"sphere_nmpc-{os.getuid()}")
    return Path(base, "sphere_nmpc")


def own_folder(folder: Path) -> Path:
    """Return a folder that nobody else can read or write, after making it where there is none.

    Call it before anything in it is read or written: somebody else may have made it, above all in
    the system's temporary folder. OSError is raised, with the remedy, for a folder of another
    user, one that others can write, and a link.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    with contextlib.suppress(FileExistsError):
        folder.mkdir(mode=0o700)
    found = folder.lstat()
    if not stat.S_ISDIR(found.st_mode):
        given = "a link" if stat.S_ISLNK(found.st_mode) else "no folder"
    elif found.st_uid != os.geteuid():
        given = f"a folder of user {found.st_uid}"
    elif found.st_mode & 0o022:
        given = f"a folder that others can write, mode {stat.S_IMODE(found.st_mode):o}"
    else:
        if found.st_mode & 0o077:
            folder.chmod(0o700)
        return folder
    raise OSError(
        f"{folder}: given {given}, expected one of user {os.geteuid()} with mode 700; remove it"
    )


class KeptFile(Generic[T]):
    """File with what a run knew last, and when; the next one takes it up.

    It does so only if it begins soon after the end of that run and on the same clock, which must
    not have been set back: a simulation that starts again has no past.

    Parameters
    ----------
    path : Path
        The file, in a folder of this user alone, see `own_folder`.
    keep : float
        Time after the end of a run within which it is taken up [s, wall].
    content_of, read : callable
        Return what is written of a value, and the value of what was read, whatever that is;
        errors of `read` of the kinds of Python's own lookups and conversions count as no value.
    """

    def __init__(
        self, path: Path, keep: float, content_of: Callable[[T], Mapping[str, Any]],
        read: Callable[[Any], T],
    ) -> None:
        self._path, self._keep = path, keep
        self._content_of, self._read = content_of, read

    def save(self, value: T | None, stamp: int, simulated: bool) -> None:
        """Write what is known at `stamp` [ns]; without anything delete the last.

        `simulated` says whether the stamp is of simulated time or of the system clock.

        Raises
        ------
        OSError
            If the file cannot be written.
        """
        own_folder(self._path.parent)
        if value is None:
            self._path.unlink(missing_ok=True)
            return
        # A process that is killed while it writes must leave the old file or the new one intact.
        fresh = self._path.with_suffix(f".{os.getpid()}")
        content = {**self._content_of(value), "stamp": stamp, "simulated": simulated}
        fresh.write_text(json.dumps(content), encoding="ascii")
        fresh.replace(self._path)

    def recall(self, stamp: int, simulated: bool) -> tuple[T, float] | None:
        """Return what a run that ended recently knew, and the time since [s, wall].

        None if there is nothing, if it ended too long ago, or if the clock, which now shows
        `stamp` [ns], is another one or has been set back. OSError is raised if the folder may
        contain files of others.
        """
        own_folder(self._path.parent)
        try:
            age = max(0.0, time.time() - self._path.stat().st_mtime)
            content = json.loads(read_file(self._path, _MAX_BYTES))
            value, then = self._read(content), int(content["stamp"])
        except (OSError, ValueError, KeyError, IndexError, TypeError, OverflowError):
            return None
        is_same_clock = content.get("simulated") is simulated and then <= stamp
        return (value, age) if is_same_clock and age <= self._keep else None
