# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""A ROS domain that nobody else on this machine uses."""

import contextlib
import fcntl
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

from sphere_nmpc.errors import SphereNmpcError
from sphere_nmpc.ros.loopback import stay_on_this_machine

_HIGHEST = 101
"""Ids above this reach into the ephemeral ports of Linux."""


@contextlib.contextmanager
def own_domain(loopback: bool = True) -> Iterator[int]:
    """Set ``ROS_DOMAIN_ID`` to a free id, unless it is set, and stay on this machine.

    The id is held by a lock that goes with the process, however it ends.

    Parameters
    ----------
    loopback : bool, optional
        Whether to use the loopback alone, rather than what the environment says.

    Yields
    ------
    int
        The domain.
    """
    if loopback:
        stay_on_this_machine()
    if os.environ.get("ROS_DOMAIN_ID"):
        yield int(os.environ["ROS_DOMAIN_ID"])
        return
    domain, lock = _take_free()
    os.environ["ROS_DOMAIN_ID"] = str(domain)
    try:
        yield domain
    finally:
        del os.environ["ROS_DOMAIN_ID"]
        os.close(lock)


def _take_free() -> tuple[int, int]:
    folder = Path(tempfile.gettempdir())
    for domain in range(_HIGHEST, 0, -1):
        try:
            lock = os.open(folder / f"sphere_nmpc_domain_{domain}.lock", os.O_CREAT | os.O_RDWR)
        except OSError:  # another user's
            continue
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:  # in use
            os.close(lock)
            continue
        return domain, lock
    raise SphereNmpcError(f"all ROS domain ids up to {_HIGHEST} are in use; set ROS_DOMAIN_ID")
