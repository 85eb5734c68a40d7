# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Nodes are heard on this machine only, unless whoever starts them says otherwise.

ROS itself looks for nodes in the whole network. With its range ``LOCALHOST`` it looks on this
machine only, but Fast DDS still opens its ports on all interfaces, for everybody to send to.
"""

import os
from collections.abc import MutableMapping
from pathlib import Path

RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
_PROFILES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
"""Where Fast DDS looks for its settings, up to version 2 and from 3 on."""
_WISHES = ("ROS_STATIC_PEERS", "ROS_DISCOVERY_SERVER", "FASTDDS_BUILTIN_TRANSPORTS", *_PROFILES)
"""Who sets one of these knows who is to be heard."""
_FAST_DDS = ("", "rmw_fastrtps_cpp", "rmw_fastrtps_dynamic_cpp")


def stay_on_this_machine(environment: MutableMapping[str, str] = os.environ) -> None:
    """Let nodes that start from now on listen on the loopback alone.

    Parameters
    ----------
    environment : mapping, optional
        Of this process; left as it is where it says anything about the network.
    """
    if any(environment.get(name) for name in _WISHES):
        return
    if environment.get(RANGE, "LOCALHOST").upper() != "LOCALHOST":
        return
    if environment.get("RMW_IMPLEMENTATION", "") not in _FAST_DDS:
        environment[RANGE] = "LOCALHOST"
        return
    # In any other range ROS adds a transport of its own beside the one of the file.
    environment[RANGE] = "SYSTEM_DEFAULT"
    for name in _PROFILES:
        environment[name] = str(Path(__file__).with_name("loopback.xml"))
