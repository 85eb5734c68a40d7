# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""A ROS domain without other nodes of this package."""

import contextlib
import fcntl
import os
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

from sphere_nmpc.errors import SphereNmpcError
from sphere_nmpc.ros.network import DOMAIN, check_environment, domain_id, use_loopback_only
from sphere_sim.ros.session.other_publishers import DomainInUseError, find_publishers

_DOMAINS = range(101, 0, -1)
"""Ids above 101 reach into the ephemeral ports of Linux; other programs take small ones first."""
_TRIES = 5
"""Number of occupied domains after which the search is given up."""
_LOCK = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
"""Every user can write to the folder: no link is followed, and opening a pipe does not block."""


@contextlib.contextmanager
def own_domain(domains: Sequence[int] = _DOMAINS) -> Iterator[int]:
    """Set ``ROS_DOMAIN_ID`` to a free id, unless it is set, and yield it; stay on this machine.

    A lock, which the system releases when the process ends, keeps the id, the first free one of
    `domains`. The loopback alone is used, rather than the network that the environment selects.
    `DomainInUseError` is raised if others publish a clock, poses or rotor commands in the domain
    that is set, `RosEnvironmentError` for an environment that ROS refuses.
    """
    use_loopback_only()
    check_environment()
    given = domain_id()
    if given is not None:
        if others := find_publishers():
            raise DomainInUseError(others)
        yield given
        return
    lock = -1
    try:
        domain, lock = _take_free(domains)
        yield domain
    finally:
        os.environ.pop(DOMAIN, None)
        if lock >= 0:
            os.close(lock)


def _take_free(domains: Sequence[int]) -> tuple[int, int]:
    """Set the variable to the first domain that is neither locked nor in use.

    Returns the domain and the file descriptor of its lock.
    """
    others: list[str] = []
    occupied = 0
    for domain in domains:
        lock = _locked(domain)
        if lock is None:
            continue
        os.environ[DOMAIN] = str(domain)
        others = find_publishers()
        if not others:
            return domain, lock
        os.close(lock)
        occupied += 1
        if occupied == _TRIES:
            raise DomainInUseError(others)
    raise SphereNmpcError(
        f"{DOMAIN}: not given, and all of {min(domains)} to {max(domains)} are in use, "
        "expected a free one; set it, or remove the locks of processes that have ended, "
        f"{tempfile.gettempdir()}/sphere_nmpc_domain_*.lock"
    )


def _locked(domain: int) -> int | None:
    """Return the lock of a domain; None where another process holds it or it cannot be opened."""
    path = Path(tempfile.gettempdir()) / f"sphere_nmpc_domain_{domain}.lock"
    try:
        try:
            # The file of another user can be locked as well; creating it again is refused.
            lock = os.open(path, _LOCK)
        except FileNotFoundError:
            lock = os.open(path, _LOCK | os.O_CREAT | os.O_EXCL, 0o644)
    except OSError:
        return None
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(lock)
        return None
    return lock
