# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Who can hear a node: what the environment of ROS says, and how to stay on the loopback.

A node does what its environment says. ``ROS_LOCALHOST_ONLY=1`` is taken at its word: ROS itself
reads it as the discovery range ``LOCALHOST``, with which Fast DDS looks for nodes on this machine
only but still opens its ports on all interfaces, for everybody to send to.
"""

import os
from collections.abc import Mapping, MutableMapping
from pathlib import Path

RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
SWITCH = "ROS_LOCALHOST_ONLY"
PROFILES = Path(__file__).with_name("loopback.xml")
"""Settings of Fast DDS with which it uses the loopback alone."""
PROFILE_VARIABLES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
"""Where Fast DDS looks for its settings, up to version 2 and from 3 on."""
_PEERS, _SERVER = "ROS_STATIC_PEERS", "ROS_DISCOVERY_SERVER"
CHOICES = (_PEERS, _SERVER, "FASTDDS_BUILTIN_TRANSPORTS", *PROFILE_VARIABLES)
"""With one of these set, the user has chosen who is to be heard."""
_FAST_DDS = ("", "rmw_fastrtps_cpp", "rmw_fastrtps_dynamic_cpp")
_REACH = {
    "SUBNET": f"by every machine of the network; {SWITCH}=1 keeps it on this machine",
    "LOCALHOST": f"on this machine only; its ports are open on all interfaces, {SWITCH}=1 "
    "closes them",
    "OFF": "by nobody but this process",
    "SYSTEM_DEFAULT": "as the middleware is set up",
}


def stay_on_this_machine(environment: MutableMapping[str, str] = os.environ) -> None:
    """Let nodes that start from now on use the loopback alone.

    Parameters
    ----------
    environment : mapping, optional
        Of this process; left as it is where it asks for more than this machine.
    """
    if any(environment.get(name) for name in CHOICES):
        return
    if environment.get(RANGE, "LOCALHOST").upper() != "LOCALHOST":
        return
    # With it set, ROS adds transports of its own beside those of the file.
    environment.pop(SWITCH, None)
    if environment.get("RMW_IMPLEMENTATION", "") not in _FAST_DDS:
        environment[RANGE] = "LOCALHOST"
        return
    # So it does in any other range.
    environment[RANGE] = "SYSTEM_DEFAULT"
    for name in PROFILE_VARIABLES:
        environment[name] = str(PROFILES)


def heed_localhost_only(environment: MutableMapping[str, str] = os.environ) -> bool:
    """Stay on the loopback if ``ROS_LOCALHOST_ONLY`` is 1; return whether that is the case."""
    if environment.get(SWITCH) == "1":
        environment.pop(RANGE, None)  # as in ROS, where the switch goes before the range
        stay_on_this_machine(environment)
    return _is_on_loopback(environment)


def _is_on_loopback(environment: Mapping[str, str]) -> bool:
    given = next((environment[name] for name in PROFILE_VARIABLES if environment.get(name)), "")
    reach = environment.get(RANGE, "").upper()
    return given == str(PROFILES) and reach == "SYSTEM_DEFAULT"


def audience(environment: Mapping[str, str] = os.environ) -> str:
    """Return in one line who can hear a node with this environment."""
    given = next((environment[name] for name in PROFILE_VARIABLES if environment.get(name)), "")
    reach = environment.get(RANGE, "").upper()
    if environment.get(SWITCH) == "1":
        reach = "LOCALHOST"
    if _is_on_loopback(environment):
        heard = "on this machine only, over the loopback"
    elif server := environment.get(_SERVER):
        heard = f"by the nodes of the discovery server {server}"
    else:
        heard = _REACH.get(reach or "SUBNET", _REACH["LOCALHOST"])  # what ROS does not know
        if given:
            heard += f"; transports as in {given}"
        if peers := environment.get(_PEERS):
            heard += f"; also by {peers}"
    secured = environment.get("ROS_SECURITY_ENABLE") == "true"
    return f"ROS domain {environment.get('ROS_DOMAIN_ID') or '0'}: heard {heard}" + (
        "; SROS 2 is on" if secured else ""
    )
