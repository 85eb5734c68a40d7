# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Where files are kept between runs, and whether code that lies there may be loaded."""

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
    """Return a folder of this user alone under the system's temporary one. Never raises.

    The same in every process of the user, so that what one keeps there the others find. Where the
    name is taken by somebody else, it is a new one that only this process knows.
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
    """Return what `temporary_folder` is called unless somebody else has taken the name."""
    try:
        base = Path(tempfile.gettempdir())
    except OSError:
        return _NOWHERE
    # Elsewhere than on POSIX the temporary folder is the user's own.
    return base / f"sphere_nmpc-{os.geteuid() if hasattr(os, 'geteuid') else 'user'}"


def make_private(folder: Path) -> None:
    """Create a folder that only its owner may enter, unless it is there already.

    Raises
    ------
    OSError
        If it cannot be created.
    """
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)


def distrust(path: Path) -> str | None:
    """Return why code at a path must not be loaded, None where it may.

    Trusted is what belongs to this user or to the administrator and nobody else can write to.

    Raises
    ------
    OSError
        If the path cannot be looked at.
    """
    if not hasattr(os, "geteuid"):
        return None
    found = path.stat()
    if found.st_uid not in (os.geteuid(), 0):
        return f"{path} belongs to another user ({found.st_uid})"
    if found.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        return f"others can write to {path} (chmod go-w {path})"
    return None
