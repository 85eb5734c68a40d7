# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Folders of this user alone, for files that are kept between runs."""

import contextlib
import os
import stat
import tempfile
from pathlib import Path


def has_home() -> bool:
    """Return whether this user has a home folder.

    A bare user id in a container has none, and that of a system user, such as /nonexistent, does
    not exist and is not to be made, not even by root.
    """
    return os.path.isdir(os.path.expanduser("~"))


def cache_folder() -> Path:
    """Return the user's folder for files that are kept between runs; see `own_folder`."""
    base = os.environ.get("XDG_CACHE_HOME") or (has_home() and os.path.expanduser("~/.cache"))
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
