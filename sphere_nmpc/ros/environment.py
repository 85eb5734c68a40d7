# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Checks of the environment variables that ROS reads, before ROS reads them.

For a value that they cannot use, ROS and Fast DDS raise an error of an inner library, abort the
process, or ignore the variable, even one that should have restricted a node to this machine.
"""

import os
import re
import socket
import sys
from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree

from sphere_nmpc.errors import SphereNmpcError
from sphere_nmpc.foreign_text import shown
from sphere_nmpc.ros.loopback import PROFILE_VARIABLES

DOMAIN = "ROS_DOMAIN_ID"
_MIDDLEWARE = "RMW_IMPLEMENTATION"
_HIGHEST_DOMAIN = 232
"""Largest domain id for which the port numbers of DDS are valid."""
_LOG_FOLDER = "ROS_LOG_DIR"


class RosEnvironmentError(SphereNmpcError):
    """Environment variable with a value that ROS cannot use.

    Parameters
    ----------
    name : str
        Name of the variable.
    given : str
        Its value.
    expected : str
        Description of the accepted values.
    """

    exit_code = 2

    def __init__(self, name: str, given: str, expected: str) -> None:
        super().__init__(f"{name}: given {shown(given)}, expected {expected}")


def check_environment(environment: Mapping[str, str] = os.environ) -> None:
    """Raise if ROS cannot start with this environment.

    Raises
    ------
    RosEnvironmentError
        If a variable has a value that ROS cannot use.
    """
    domain_id(environment)
    for name in PROFILE_VARIABLES:
        if path := environment.get(name):
            _check_profiles(name, path)
    for peer in environment.get("ROS_STATIC_PEERS", "").split(";"):
        try:
            socket.getaddrinfo(peer or None, 0)
        except (OSError, UnicodeError):
            raise RosEnvironmentError(
                "ROS_STATIC_PEERS", peer, "names or addresses of machines, separated by ;"
            ) from None
    chosen = environment.get(_LOG_FOLDER)
    if chosen and not _is_writable(Path(chosen).expanduser()):
        raise RosEnvironmentError(_LOG_FOLDER, chosen, "a folder that can be created and written")


def domain_id(environment: Mapping[str, str] = os.environ) -> int | None:
    """Return the ROS domain id that the environment sets; None where it sets none.

    Raises
    ------
    RosEnvironmentError
        If the value is not a valid domain id.
    """
    given = environment.get(DOMAIN)
    if not given:
        return None
    # ROS would read a leading 0 as octal, and a negative number as a very large one.
    if not re.fullmatch(r"0|[1-9][0-9]{0,2}", given) or int(given) > _HIGHEST_DOMAIN:
        raise RosEnvironmentError(DOMAIN, given, f"a whole number from 0 to {_HIGHEST_DOMAIN}")
    return int(given)


def check_middleware(environment: Mapping[str, str] = os.environ) -> None:
    """Raise if the selected middleware is not installed; call it before rclpy is imported.

    Importing rclpy with a middleware that is not there aborts the process.

    Raises
    ------
    RosEnvironmentError
        If it is not installed; the message names those that are.
    """
    given = environment.get(_MIDDLEWARE)
    if not given:
        return
    prefixes = [*environment.get("AMENT_PREFIX_PATH", "").split(os.pathsep), sys.prefix]
    index = Path("share/ament_index/resource_index/rmw_typesupport")
    folders = [folder for prefix in prefixes if (folder := Path(prefix) / index).is_dir()]
    installed = {entry.name for folder in folders for entry in folder.iterdir()}
    installed.discard("rmw_implementation")  # only selects one of the others
    if installed and given not in installed:
        raise RosEnvironmentError(_MIDDLEWARE, given, " or ".join(sorted(installed)))


def unwritable_log_folder(environment: Mapping[str, str] = os.environ) -> Path | None:
    """Return ROS's default log folder if it cannot be written; None if it can.

    Returns None for a folder that the user has set; `check_environment` checks that one.
    """
    if environment.get(_LOG_FOLDER):
        return None
    home = environment.get("ROS_HOME")
    try:
        folder = (Path(home).expanduser() if home else Path.home() / ".ros") / "log"
    except RuntimeError:  # this user has no home folder
        return Path("~/.ros/log")
    # ROS itself reads the variables only, not the user database.
    has_home = bool(home or environment.get("HOME"))
    return None if has_home and _is_writable(folder) else folder


def _is_writable(folder: Path) -> bool:
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
