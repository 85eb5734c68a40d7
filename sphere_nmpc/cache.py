# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Folders for files that are kept between runs, and the check of code that is loaded from them."""

import atexit
import os
import shutil
import stat
import tempfile
from functools import cache
from pathlib import Path

CACHE_VARIABLE = "SPHERE_NMPC_CACHE"
"""Environment variable that names another cache folder than the user's."""

_NOWHERE = Path(os.devnull) / "sphere_nmpc"
"""Every use of this path fails with an OSError that names it."""


def cache_folder() -> Path:
    """Return the folder that keeps files between runs; it may not exist yet. Never raises."""
    chosen = os.environ.get(CACHE_VARIABLE)
    if chosen:
        return Path(chosen)
    base = os.environ.get("XDG_CACHE_HOME")
    try:
        return (Path(base) if base else Path.home() / ".cache") / "sphere_nmpc"
    except RuntimeError:
        # Neither HOME nor an entry in the list of users, as of a bare user id in a container.
        return temporary_folder()


@cache
def temporary_folder() -> Path:
    """Return a private folder of this user below the system's temporary one. Never raises.

    It is the same in every process of the user, so that they share what is kept there. Where
    another user has created a folder of that name, it is a new one for this process alone.
    """
    try:
        folder = temporary_path()
        make_private(folder)
        if folder.is_symlink() or distrust(folder) is not None:
            folder = Path(tempfile.mkdtemp(prefix="sphere_nmpc-", dir=folder.parent))
            atexit.register(shutil.rmtree, folder, ignore_errors=True)
        return folder
    except OSError:
        return _NOWHERE


def temporary_path() -> Path:
    """Return the path of `temporary_folder` unless another user has created a folder there."""
    try:
        base = Path(tempfile.gettempdir())
    except OSError:
        return _NOWHERE
    # Elsewhere than on POSIX the temporary folder is the user's own.
    return base / f"sphere_nmpc-{os.geteuid() if hasattr(os, 'geteuid') else 'user'}"


def make_private(folder: Path) -> None:
    """Create a folder that only its owner may enter, with its parents, unless it exists.

    Every writer to the cache folder creates it by this function: with a umask that lets a group
    write, a folder made by `Path.mkdir` would not pass `distrust`.

    Raises
    ------
    OSError
        If it cannot be created.
    """
    # `Path.mkdir` applies its mode to the last folder alone.
    for missing in [p for p in reversed((folder, *folder.parents)) if not p.exists()]:
        missing.mkdir(mode=0o700, exist_ok=True)
    folder.mkdir(exist_ok=True)


def distrust(path: Path) -> str | None:
    """Return why code at a path must not be loaded, None where it may.

    A path is trusted if it belongs to this user or to root and no other user can write to it.

    Raises
    ------
    OSError
        If the path does not exist or its owner cannot be read.
    """
    if not hasattr(os, "geteuid"):
        return None
    found = path.stat()
    if found.st_uid not in (os.geteuid(), 0):
        return f"{path} belongs to another user ({found.st_uid})"
    if found.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        return f"others can write to {path} (chmod go-w {path})"
    return None
