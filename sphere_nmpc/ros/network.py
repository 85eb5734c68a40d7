# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Addresses of this machine that Fast DDS announces to nodes on other machines.

A node announces the addresses that interfaces in operation have when it starts, 127.0.0.1 where
there are none, and keeps to them as long as it runs. Nodes on other machines that hear 127.0.0.1
answer to themselves, and neither side ever discovers the other.
"""

import os
import socket
import struct
import sys
import time
from collections.abc import Callable, Mapping

from sphere_nmpc.ros.loopback import other_machines

NETWORK_TIMEOUT = 10.0
"""Longest wait for an interface where the environment names other machines [s]."""
_POLL = 0.05
"""Interval between two looks at the interfaces [s]."""
_GET_FLAGS, _GET_ADDRESS = 0x8913, 0x8915
"""Requests SIOCGIFFLAGS and SIOCGIFADDR of netdevice(7)."""
_LOOPBACK, _RUNNING = 0x8, 0x40
"""Flags of an interface; one that is switched on is in operation (running) only with a carrier."""


def network_addresses() -> frozenset[str]:
    """Return the first IPv4 address of each interface in operation, without the loopback.

    Always empty on systems other than Linux; see `wait_for_network`.
    """
    if not sys.platform.startswith("linux"):
        return frozenset()
    import fcntl

    found = set()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as control:
        for _, name in socket.if_nameindex():
            request = struct.pack("16s24x", name.encode())
            try:
                (flags,) = struct.unpack_from("H", fcntl.ioctl(control, _GET_FLAGS, request), 16)
                address = fcntl.ioctl(control, _GET_ADDRESS, request)[20:24]
            except OSError:  # without an IPv4 address, or removed meanwhile
                continue
            if flags & _RUNNING and not flags & _LOOPBACK:
                found.add(socket.inet_ntoa(address))
    return frozenset(found)


def wait_for_network(
    environment: Mapping[str, str] = os.environ,
    addresses: Callable[[], frozenset[str]] = network_addresses,
    timeout: float = NETWORK_TIMEOUT,
) -> str:
    """Wait until an interface is in operation, where the environment names other machines.

    Parameters
    ----------
    environment : mapping, optional
        Environment of this process.
    addresses : callable, optional
        Returns the addresses of this machine.
    timeout : float, optional
        Longest wait [s].

    Returns
    -------
    str
        Message in one line if there is none after that time; empty otherwise.
    """
    variable = other_machines(environment)
    if not variable or not sys.platform.startswith("linux"):
        return ""
    give_up = time.monotonic() + timeout
    while not addresses():
        if time.monotonic() >= give_up:
            return (
                f"network: given {variable} and no network interface in operation for "
                f"{timeout:g} s, expected one; continuing, but nodes on other machines will not "
                "find this one: restart it when the network is there"
            )
        time.sleep(_POLL)
    return ""
