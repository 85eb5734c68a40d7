# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Network reach of the nodes of this process, and its restriction to the loopback interface.

A node follows the ROS environment variables. ``ROS_LOCALHOST_ONLY=1`` is applied strictly: ROS
itself reads it as the discovery range ``LOCALHOST``, with which Fast DDS discovers nodes on this
machine only, but still opens its ports on all interfaces, where any machine can send to them.
"""

import os
import re
from collections.abc import Mapping, MutableMapping
from pathlib import Path

DISCOVERY_RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
LOCALHOST_ONLY = "ROS_LOCALHOST_ONLY"
PROFILE_VARIABLES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
"""Variables that name the XML profiles of Fast DDS, up to version 2 and from version 3 on."""
BUILTIN_TRANSPORTS = "FASTDDS_BUILTIN_TRANSPORTS"
_STATIC_PEERS, _DISCOVERY_SERVER = "ROS_STATIC_PEERS", "ROS_DISCOVERY_SERVER"
TRANSPORT_VARIABLES = (_STATIC_PEERS, _DISCOVERY_SERVER, BUILTIN_TRANSPORTS, *PROFILE_VARIABLES)
"""Variables with which users choose discovery or transports themselves."""
_PROFILES = Path(__file__).with_name("loopback.xml")
"""Profiles that restrict Fast DDS to the loopback interface."""
_FAST_DDS = ("", "rmw_fastrtps_cpp", "rmw_fastrtps_dynamic_cpp")
_OWN = re.compile(r"localhost|(?<![\w.])127\.")
"""Names of this machine in lists of hosts."""
_REACH = {
    "SUBNET": f"from every machine of the network; {LOCALHOST_ONLY}=1 keeps it on this machine",
    "LOCALHOST": "from this machine only; its ports are open on all interfaces, "
    f"{LOCALHOST_ONLY}=1 closes them",
    "OFF": "from this process only",
    "SYSTEM_DEFAULT": "as the middleware is configured",
}


def use_loopback_only(environment: MutableMapping[str, str] = os.environ) -> None:
    """Restrict nodes that start from now on to the loopback interface.

    Parameters
    ----------
    environment : mapping, optional
        Environment of this process; unchanged where it sets discovery or transports, or a
        discovery range other than this machine.
    """
    if any(environment.get(name) for name in TRANSPORT_VARIABLES):
        return
    if environment.get(DISCOVERY_RANGE, "LOCALHOST").upper() != "LOCALHOST":
        return
    # With this variable set, ROS would add its own transports to those of the profiles.
    environment.pop(LOCALHOST_ONLY, None)
    if environment.get("RMW_IMPLEMENTATION", "") not in _FAST_DDS:
        environment[DISCOVERY_RANGE] = "LOCALHOST"
        return
    # ROS adds transports in every other discovery range too.
    environment[DISCOVERY_RANGE] = "SYSTEM_DEFAULT"
    for name in PROFILE_VARIABLES:
        environment[name] = str(_PROFILES)


def apply_localhost_only(environment: MutableMapping[str, str] = os.environ) -> bool:
    """Apply ``ROS_LOCALHOST_ONLY=1``; return whether nodes use the loopback interface only."""
    if environment.get(LOCALHOST_ONLY) == "1":
        environment.pop(DISCOVERY_RANGE, None)  # in ROS too, LOCALHOST_ONLY overrides the range
        use_loopback_only(environment)
    return _uses_loopback_only(environment)


def network_reach(environment: Mapping[str, str] = os.environ) -> str:
    """Return one line that says from where nodes with this environment can be reached."""
    if _uses_loopback_only(environment):
        source = "from this machine only, over the loopback"
    elif server := environment.get(_DISCOVERY_SERVER):
        source = f"from the nodes of the discovery server {server}"
    else:
        # ROS treats an unknown range as LOCALHOST.
        source = _REACH.get(_range(environment), _REACH["LOCALHOST"])
        if profiles := _profiles(environment):
            source += f"; transports as in {profiles}"
        if peers := environment.get(_STATIC_PEERS):
            source += f"; also from {peers}"
    if environment.get("ROS_SECURITY_ENABLE") == "true":
        source += "; SROS 2 is on"
    return f"ROS domain {environment.get('ROS_DOMAIN_ID') or '0'}: reachable {source}"


def other_machines(environment: Mapping[str, str] = os.environ) -> str:
    """Return the variable that names other machines to be discovered; empty without any."""
    reach = _range(environment)
    peers = "" if reach in ("OFF", "SYSTEM_DEFAULT") else environment.get(_STATIC_PEERS, "")
    named = {_STATIC_PEERS: peers, _DISCOVERY_SERVER: environment.get(_DISCOVERY_SERVER, "")}
    for variable, hosts in named.items():
        if any(host and not _OWN.search(host) for host in hosts.split(";")):
            return variable
    return ""


def reaches_other_machines(environment: Mapping[str, str] = os.environ) -> bool:
    """Return whether nodes with this environment are to be found by those of other machines."""
    wide = _range(environment) in ("SUBNET", "SYSTEM_DEFAULT")
    return bool(other_machines(environment)) or (wide and not _uses_loopback_only(environment))


def _range(environment: Mapping[str, str]) -> str:
    """Return the discovery range in force, as ROS reads it."""
    if environment.get(LOCALHOST_ONLY) == "1":
        return "LOCALHOST"
    return environment.get(DISCOVERY_RANGE, "").upper() or "SUBNET"


def _uses_loopback_only(environment: Mapping[str, str]) -> bool:
    reach = environment.get(DISCOVERY_RANGE, "").upper()
    return _profiles(environment) == str(_PROFILES) and reach == "SYSTEM_DEFAULT"


def _profiles(environment: Mapping[str, str]) -> str:
    """Return the path of the Fast DDS profiles in use; empty without any."""
    return next(filter(None, map(environment.get, PROFILE_VARIABLES)), "")
