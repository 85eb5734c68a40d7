# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Nodes of several users on one machine: they cannot use each other's shared memory.

Fast DDS offers shared memory all the same, so that such nodes find each other and no message
passes. One that offers UDP alone is heard by, and hears, the others.
"""

import os
import re
from collections.abc import MutableMapping
from pathlib import Path

from sphere_nmpc.ros.environment import domain_of
from sphere_nmpc.ros.loopback import CHOICES, RANGE, stay_on_this_machine

TRANSPORTS = "FASTDDS_BUILTIN_TRANSPORTS"
_SEGMENTS = Path("/dev/shm")
_FIRST_PORT, _PORTS_OF_DOMAIN = 7400, 250
"""Where the ports of domain 0 begin, and those of the next one."""


def leave_to_others(
    environment: MutableMapping[str, str] = os.environ, segments: Path = _SEGMENTS
) -> str:
    """Use UDP alone where other users' nodes of this domain use shared memory.

    Parameters
    ----------
    environment : mapping, optional
        Of this process; left as it is where it chooses transports.
    segments : Path, optional
        Where the system keeps shared memory.

    Returns
    -------
    str
        One line that tells of it; empty where nothing was changed.
    """
    if any(environment.get(name) for name in CHOICES):
        return ""
    if environment.get("RMW_IMPLEMENTATION", "") not in ("", "rmw_fastrtps_cpp"):
        return ""
    begin = _FIRST_PORT + _PORTS_OF_DOMAIN * (domain_of(environment) or 0)
    others = set()
    try:
        for entry in os.scandir(segments):
            found = re.fullmatch(r"fastrtps_port([0-9]+)", entry.name)
            if found and begin <= int(found[1]) < begin + _PORTS_OF_DOMAIN:
                others.add(entry.stat(follow_symlinks=False).st_uid)
    except OSError:  # another system, or a node that has just ended
        pass
    others.discard(os.geteuid())
    if not others:
        return ""
    if environment.get(RANGE, "").upper() == "LOCALHOST":
        # There ROS sets up transports itself, shared memory among them.
        stay_on_this_machine(environment)
        instead = "the loopback alone"
    else:
        environment[TRANSPORTS] = "UDPv4"
        instead = f"{TRANSPORTS}=UDPv4"
    users = ", ".join(map(str, sorted(others)))
    return (
        f"shared memory: given segments of other users (uid {users}) in this domain, which cannot "
        f"be shared, expected one's own alone; going on with {instead}"
    )
