# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""What the environment tells ROS, looked at before ROS reads it.

ROS and Fast DDS meet a variable that they cannot use with an error of a library, with the end of
the process, or by going on without it, as with settings that should have kept a node on this
machine.
"""

import os
import re
import socket
import sys
from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree

from sphere_nmpc.errors import SphereNmpcError
from sphere_nmpc.ros.loopback import PROFILE_VARIABLES

DOMAIN = "ROS_DOMAIN_ID"
_MIDDLEWARE = "RMW_IMPLEMENTATION"
_HIGHEST_DOMAIN = 232
"""The ports of Fast DDS end there."""
_LOGS = "ROS_LOG_DIR"


class RosEnvironmentError(SphereNmpcError):
    """A variable of the environment is not what ROS can use.

    Parameters
    ----------
    name : str
        The variable.
    given : str
        Its value.
    expected : str
        What would have been accepted, in words.
    """

    exit_code = 2

    def __init__(self, name: str, given: str, expected: str) -> None:
        super().__init__(f"{name}: given '{given}', expected {expected}")


def check_environment(environment: Mapping[str, str] = os.environ) -> None:
    """Raise if ROS cannot start with this environment.

    Raises
    ------
    RosEnvironmentError
        Naming the variable.
    """
    domain_of(environment)
    for name in PROFILE_VARIABLES:
        if path := environment.get(name):
            _check_profiles(name, path)
    for peer in environment.get("ROS_STATIC_PEERS", "").split(";"):
        try:
            socket.getaddrinfo(peer or None, 0)
        except (OSError, UnicodeError):
            raise RosEnvironmentError(
                "ROS_STATIC_PEERS", peer, "names or addresses of machines with ; between them"
            ) from None
    chosen = environment.get(_LOGS)
    if chosen and not _can_be_written(Path(chosen).expanduser()):
        raise RosEnvironmentError(_LOGS, chosen, "a folder that can be made and written")


def domain_of(environment: Mapping[str, str] = os.environ) -> int | None:
    """Return the domain that the environment asks for, None where it asks for none.

    Raises
    ------
    RosEnvironmentError
        If it is no domain.
    """
    given = environment.get(DOMAIN)
    if not given:
        return None
    # ROS would take a leading 0 for octal, and a sign for a very high number.
    if not re.fullmatch(r"0|[1-9][0-9]{0,2}", given) or int(given) > _HIGHEST_DOMAIN:
        raise RosEnvironmentError(DOMAIN, given, f"a whole number from 0 to {_HIGHEST_DOMAIN}")
    return int(given)


def check_middleware(environment: Mapping[str, str] = os.environ) -> None:
    """Raise if the middleware that is asked for is not installed; rclpy must not be loaded yet.

    Loading it with another middleware than it was built for ends the process.

    Raises
    ------
    RosEnvironmentError
        With the names of those that are installed.
    """
    given = environment.get(_MIDDLEWARE)
    if not given:
        return
    prefixes = [*environment.get("AMENT_PREFIX_PATH", "").split(os.pathsep), sys.prefix]
    index = Path("share/ament_index/resource_index/rmw_typesupport")
    folders = [folder for prefix in prefixes if (folder := Path(prefix) / index).is_dir()]
    there = {entry.name for folder in folders for entry in folder.iterdir()}
    there.discard("rmw_implementation")  # which only chooses one of the others
    if there and given not in there:
        raise RosEnvironmentError(_MIDDLEWARE, given, " or ".join(sorted(there)))


def missing_log_folder(environment: Mapping[str, str] = os.environ) -> Path | None:
    """Return the folder in which ROS cannot keep a log although nobody chose it; None if it can.

    A folder of the user's own choice is for `check_environment`.
    """
    if environment.get(_LOGS):
        return None
    home = environment.get("ROS_HOME")
    try:
        folder = (Path(home).expanduser() if home else Path.home() / ".ros") / "log"
    except RuntimeError:  # this user has no home
        return Path("~/.ros/log")
    # ROS itself looks at nothing but the variable.
    has_place = bool(home or environment.get("HOME"))
    return None if has_place and _can_be_written(folder) else folder


def _can_be_written(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(folder, os.W_OK | os.X_OK)


def _check_profiles(name: str, path: str) -> None:
    try:
        ElementTree.parse(path)
    except OSError as error:
        reason = f"a file that can be read ({error.strerror})"
        raise RosEnvironmentError(name, path, reason) from None
    except ElementTree.ParseError as error:
        raise RosEnvironmentError(name, path, f"XML ({error})") from None
