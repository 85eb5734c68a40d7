# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""A ROS domain in which nobody else drives a sphere."""

import contextlib
import fcntl
import os
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

from sphere_nmpc.errors import SphereNmpcError
from sphere_nmpc.ros.environment import DOMAIN, check_environment, domain_id
from sphere_nmpc.ros.loopback import use_loopback_only
from sphere_sim.ros.session.domain_guests import DomainTakenError, look_for_guests

_DOMAINS = range(101, 0, -1)
"""Ids above 101 reach into the ephemeral ports of Linux; everybody else begins below."""
_TRIES = 5
"""Domains with guests that are passed over before giving up."""
_LOCK = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
"""The folder is everybody's: no link is followed there, and no pipe waited for."""


@contextlib.contextmanager
def own_domain(loopback: bool = True, domains: Sequence[int] = _DOMAINS) -> Iterator[int]:
    """Set ``ROS_DOMAIN_ID`` to a free id, unless it is set, and stay on this machine.

    The id is held by a lock that goes with the process, however it ends.

    Parameters
    ----------
    loopback : bool, optional
        Whether to use the loopback alone, rather than what the environment says.
    domains : sequence of int, optional
        What to choose from where it is not set, in this order.

    Yields
    ------
    int
        The domain.

    Raises
    ------
    RosEnvironmentError
        If the environment is not what ROS can use.
    DomainTakenError
        If others publish a clock, poses or rotor commands in the domain that is set.
    """
    if loopback:
        use_loopback_only()
    check_environment()
    given = domain_id()
    if given is not None:
        if who := look_for_guests():
            raise DomainTakenError(who)
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
    """Set the variable to the first domain without lock and guests; return it and its lock."""
    who: list[str] = []
    occupied = 0
    for domain in domains:
        lock = _locked(domain)
        if lock is None:
            continue
        os.environ[DOMAIN] = str(domain)
        who = look_for_guests()
        if not who:
            return domain, lock
        os.close(lock)
        occupied += 1
        if occupied == _TRIES:
            raise DomainTakenError(who)
    raise SphereNmpcError(
        f"{DOMAIN}: not given, and all of {min(domains)} to {max(domains)} are in use, "
        "expected a free one; set it, or remove what is left of others, "
        f"{tempfile.gettempdir()}/sphere_nmpc_domain_*.lock"
    )


def _locked(domain: int) -> int | None:
    """Return the lock of a domain; None where somebody holds it or it cannot be had."""
    path = Path(tempfile.gettempdir()) / f"sphere_nmpc_domain_{domain}.lock"
    try:
        try:
            # A lock of another user's file is as good; only making it anew is refused.
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
