# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Transport selection on a machine where several users run nodes.

Nodes of different users cannot open each other's shared memory. Fast DDS offers it all the same,
so that such nodes discover each other but exchange no messages. A node that offers UDP only
communicates with all of them.
"""

import os
import re
from collections.abc import MutableMapping
from pathlib import Path

from sphere_nmpc.ros.environment import domain_id
from sphere_nmpc.ros.loopback import (
    BUILTIN_TRANSPORTS,
    DISCOVERY_RANGE,
    TRANSPORT_VARIABLES,
    use_loopback_only,
)

_SEGMENTS = Path("/dev/shm")
_FIRST_PORT, _PORTS_PER_DOMAIN = 7400, 250
"""Port numbering of DDS: first port of domain 0, and distance to that of the next domain."""


def avoid_foreign_shared_memory(
    environment: MutableMapping[str, str] = os.environ, segments: Path = _SEGMENTS
) -> str:
    """Select UDP only where nodes of other users in this domain use shared memory.

    Parameters
    ----------
    environment : mapping, optional
        Environment of this process; unchanged where it selects transports itself.
    segments : Path, optional
        Folder in which the operating system keeps shared memory.

    Returns
    -------
    str
        Message about the change in one line; empty where nothing was changed.
    """
    if any(environment.get(name) for name in TRANSPORT_VARIABLES):
        return ""
    if environment.get("RMW_IMPLEMENTATION", "") not in ("", "rmw_fastrtps_cpp"):
        return ""
    others = _owners(segments, domain_id(environment) or 0) - {os.geteuid()}
    if not others:
        return ""
    if environment.get(DISCOVERY_RANGE, "").upper() == "LOCALHOST":
        # In this range ROS adds its own transports, among them shared memory.
        use_loopback_only(environment)
        replacement = "the loopback alone"
    else:
        environment[BUILTIN_TRANSPORTS] = "UDPv4"
        replacement = f"{BUILTIN_TRANSPORTS}=UDPv4"
    users = ", ".join(map(str, sorted(others)))
    return (
        f"shared memory: given segments of other users (uid {users}) in this domain, which this "
        f"user cannot open, expected only segments of this user; continuing with {replacement}"
    )


def _owners(segments: Path, domain: int) -> set[int]:
    """Return the user ids that own Fast DDS segments of a domain."""
    first = _FIRST_PORT + _PORTS_PER_DOMAIN * domain
    owners = set()
    try:
        for entry in os.scandir(segments):
            found = re.fullmatch(r"fastrtps_port([0-9]+)", entry.name)
            if found and first <= int(found[1]) < first + _PORTS_PER_DOMAIN:
                owners.add(entry.stat(follow_symlinks=False).st_uid)
    except OSError:  # another operating system, or a segment removed meanwhile
        pass
    return owners
