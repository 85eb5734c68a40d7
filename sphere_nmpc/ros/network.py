# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Environment of nodes: what ROS reads from it, what they can be reached from, and its network.

`prepare_environment` is called before ROS starts. For a value that they cannot use, ROS and Fast
DDS raise an error of an inner library, abort the process, or ignore the variable, even one that
should have restricted a node to this machine. So values are checked here first, and

- ``ROS_LOCALHOST_ONLY=1`` is applied strictly: ROS itself reads it as the discovery range
  ``LOCALHOST``, with which Fast DDS discovers nodes on this machine only, but still opens its
  ports on all interfaces, where any machine can send to them;
- where other machines are named, a node waits for a network interface: Fast DDS announces the
  addresses of the start as long as a node runs, 127.0.0.1 where there are none, so that nodes on
  other machines would answer to themselves;
- Fast DDS uses UDP alone: a node that is killed leaves locks behind in shared memory, at which
  others may wait for ever, and nodes of two users discover each other there but exchange no
  messages. For messages of this size it is no faster.
"""

import os
import re
import socket
import struct
import sys
import time
from collections.abc import Callable, Iterator, Mapping, MutableMapping
from mmap import PAGESIZE
from pathlib import Path
from xml.etree import ElementTree

from sphere_nmpc.errors import InvalidValueError

DOMAIN = "ROS_DOMAIN_ID"
DISCOVERY_RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
LOCALHOST_ONLY = "ROS_LOCALHOST_ONLY"
NETWORK_TIMEOUT = 10.0
"""Longest wait for an interface where the environment names other machines [s]."""
_MIDDLEWARE, _LOG_FOLDER = "RMW_IMPLEMENTATION", "ROS_LOG_DIR"
_STATIC_PEERS, _DISCOVERY_SERVER = "ROS_STATIC_PEERS", "ROS_DISCOVERY_SERVER"
_BUILTIN_TRANSPORTS = "FASTDDS_BUILTIN_TRANSPORTS"
_LOOPBACK_PROFILES = {
    "FASTRTPS_DEFAULT_PROFILES_FILE": str(Path(__file__).with_name("loopback.xml")),
    "FASTDDS_DEFAULT_PROFILES_FILE": str(Path(__file__).with_name("loopback_fast_dds_3.xml")),
}
"""Variables that name the XML profiles of Fast DDS up to version 2 (Jazzy) and from version 3 on
(Kilted), which has other names of elements, each with those for the loopback interface only."""
_TRANSPORT_VARIABLES = (
    _STATIC_PEERS, _DISCOVERY_SERVER, _BUILTIN_TRANSPORTS, *_LOOPBACK_PROFILES
)
"""Variables with which users choose discovery or transports themselves."""
_FAST_DDS = ("", "rmw_fastrtps_cpp", "rmw_fastrtps_dynamic_cpp")
_HIGHEST_DOMAIN = 232
"""Largest domain id for which the port numbers of DDS are valid."""
_OWN = re.compile(r"localhost|(?<![\w.])127\.")
"""Names of this machine in lists of hosts."""
_REACH = {
    "SUBNET": f"from every machine of the network; {LOCALHOST_ONLY}=1 keeps it on this machine",
    "LOCALHOST": "from this machine only; its ports are open on all interfaces, "
    f"{LOCALHOST_ONLY}=1 closes them",
    "OFF": "from this process only",
    "SYSTEM_DEFAULT": "as the middleware is configured",
}
_SHARED_MEMORY, _TRACING = Path("/dev/shm"), "lttng-ust-wait"
"""Folder of shared memory on Linux, and the beginning of the names of the files of LTTng in it."""
_POLL = 0.05
"""Interval between two looks at the interfaces [s]."""
_INTERFACES = Path("/sys/class/net")
_OPERATING = ("up", "unknown")
"""States of an interface in operation, which is one with a carrier; tunnels know none."""
_GET_ADDRESS = 0x8915
"""Request SIOCGIFADDR of netdevice(7)."""


class RosEnvironmentError(InvalidValueError):
    """Environment variable, or a folder of the system, that ROS cannot use as it is."""


def prepare_environment(environment: MutableMapping[str, str] = os.environ) -> list[str]:
    """Check the environment of this process and adapt it; return what to log, in one line each.

    A value that ROS cannot use raises `RosEnvironmentError`.
    """
    apply_localhost_only(environment)
    waited = wait_for_network(environment)  # first: names of peers may need it to be resolved
    check_environment(environment)
    avoid_shared_memory(environment)
    return [waited] if waited else []


def check_environment(environment: Mapping[str, str] = os.environ) -> None:
    """Raise `RosEnvironmentError` if ROS cannot start with this environment."""
    domain_id(environment)
    for name in _LOOPBACK_PROFILES:
        if path := environment.get(name):
            _check_profiles(name, path)
    for peer in environment.get(_STATIC_PEERS, "").split(";"):
        try:
            socket.getaddrinfo(peer or None, 0)
        except (OSError, UnicodeError):
            raise RosEnvironmentError(
                _STATIC_PEERS, peer, "names or addresses of machines, separated by ;"
            ) from None
    chosen = environment.get(_LOG_FOLDER)
    if chosen and not _is_writable(Path(chosen).expanduser()):
        raise RosEnvironmentError(_LOG_FOLDER, chosen, "a folder that can be created and written")


def domain_id(environment: Mapping[str, str] = os.environ) -> int | None:
    """Return the ROS domain id that the environment sets; None where it sets none."""
    given = environment.get(DOMAIN)
    if not given:
        return None
    # ROS would read a leading 0 as octal, and a negative number as a very large one.
    if not re.fullmatch(r"0|[1-9][0-9]{0,2}", given) or int(given) > _HIGHEST_DOMAIN:
        raise RosEnvironmentError(DOMAIN, given, f"a whole number from 0 to {_HIGHEST_DOMAIN}")
    return int(given)


def check_middleware(environment: Mapping[str, str] = os.environ) -> None:
    """Raise `RosEnvironmentError` if the selected middleware is not installed.

    Call it before rclpy is imported, which would abort the process.
    """
    given = environment.get(_MIDDLEWARE)
    if not given:
        return
    index = "share/ament_index/resource_index/rmw_typesupport/*"
    installed = {entry.name for entry in _in_ros(index, environment)}
    installed.discard("rmw_implementation")  # only selects one of the others
    if installed and given not in installed:
        raise RosEnvironmentError(_MIDDLEWARE, given, " or ".join(sorted(installed)))


def check_shared_memory(folder: Path = _SHARED_MEMORY) -> None:
    """Raise `RosEnvironmentError` if there is no room for the two pages that ROS's tracing shares.

    Call it before rclpy is imported, which would end the process by a bus error.
    """
    try:
        found = os.statvfs(folder)
        is_full = found.f_blocks > 0 and found.f_bavail * found.f_frsize < 2 * PAGESIZE
        pages = f"{_TRACING}-?", f"{_TRACING}-*-{os.getuid()}"
        if not is_full or all(
            any(file.stat().st_blocks for file in folder.glob(page)) for page in pages
        ):
            return
    except OSError:
        return  # without it there is no tracing
    raise RosEnvironmentError(
        str(folder), "a full file system", f"{2 * PAGESIZE} bytes of room for ROS: remove files "
        "there, or enlarge it (for a container --shm-size)"
    )


def unwritable_log_folder(environment: Mapping[str, str] = os.environ) -> Path | None:
    """Return ROS's default log folder if it cannot be written; None if it can, or is not used."""
    if environment.get(_LOG_FOLDER):
        return None
    home = environment.get("ROS_HOME")
    try:
        folder = (Path(home).expanduser() if home else Path.home() / ".ros") / "log"
    except RuntimeError:  # this user has no home folder
        return Path("~/.ros/log")
    # ROS itself reads the variables only, not the user database. A home that does not exist, as
    # /nonexistent of a system user, is not to be made.
    has_home = home or os.path.isdir(environment.get("HOME", ""))
    return None if has_home and _is_writable(folder) else folder


def use_loopback_only(environment: MutableMapping[str, str] = os.environ) -> None:
    """Restrict nodes that start from now on to the loopback interface.

    The environment is unchanged where it sets discovery or transports, or a discovery range other
    than this machine.
    """
    if any(environment.get(name) for name in _TRANSPORT_VARIABLES):
        return
    if environment.get(DISCOVERY_RANGE, "LOCALHOST").upper() != "LOCALHOST":
        return
    # With this variable set, ROS would add its own transports to those of the profiles.
    environment.pop(LOCALHOST_ONLY, None)
    if environment.get(_MIDDLEWARE, "") not in _FAST_DDS:
        environment[DISCOVERY_RANGE] = "LOCALHOST"
        return
    # ROS adds transports in every other discovery range too.
    environment[DISCOVERY_RANGE] = "SYSTEM_DEFAULT"
    name = profiles_variable(environment)
    environment[name] = _LOOPBACK_PROFILES[name]


def profiles_variable(environment: Mapping[str, str] = os.environ) -> str:
    """Return the variable from which the Fast DDS that is installed takes its profiles."""
    old, new = _LOOPBACK_PROFILES
    return new if any(_in_ros("lib/libfastdds.so", environment)) else old


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
    return f"ROS domain {environment.get(DOMAIN) or '0'}: reachable {source}"


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


def network_addresses() -> frozenset[str]:
    """Return the first IPv4 address of each interface in operation, without the loopback.

    Always empty on systems other than Linux; see `wait_for_network`.
    """
    if not sys.platform.startswith("linux"):
        return frozenset()
    import fcntl

    found = set()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as control:
        for state in _INTERFACES.glob("*/operstate"):
            try:
                operates = state.read_text().strip() in _OPERATING
                request = struct.pack("16s24x", state.parent.name.encode())
                address = socket.inet_ntoa(fcntl.ioctl(control, _GET_ADDRESS, request)[20:24])
            except OSError:  # without an IPv4 address, or removed meanwhile
                continue
            if operates and not _OWN.match(address):
                found.add(address)
    return frozenset(found)


def wait_for_network(
    environment: Mapping[str, str] = os.environ,
    addresses: Callable[[], frozenset[str]] = network_addresses,
    timeout: float = NETWORK_TIMEOUT,
) -> str:
    """Wait until an interface is in operation, where the environment names other machines.

    `addresses` returns those of this machine. Returned is a message in one line if there is none
    after `timeout` [s], empty otherwise.
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


def avoid_shared_memory(environment: MutableMapping[str, str] = os.environ) -> None:
    """Select UDP for Fast DDS, unless the environment selects transports itself."""
    if any(environment.get(name) for name in _TRANSPORT_VARIABLES):
        return
    if _range(environment) == "LOCALHOST":
        # In this range ROS adds its own transports, among them shared memory.
        use_loopback_only(environment)
    else:
        environment[_BUILTIN_TRANSPORTS] = "UDPv4"


def _range(environment: Mapping[str, str]) -> str:
    """Return the discovery range in force, as ROS reads it."""
    if environment.get(LOCALHOST_ONLY) == "1":
        return "LOCALHOST"
    return environment.get(DISCOVERY_RANGE, "").upper() or "SUBNET"


def _uses_loopback_only(environment: Mapping[str, str]) -> bool:
    reach = environment.get(DISCOVERY_RANGE, "").upper()
    return _profiles(environment) in _LOOPBACK_PROFILES.values() and reach == "SYSTEM_DEFAULT"


def _profiles(environment: Mapping[str, str]) -> str:
    """Return the path of the Fast DDS profiles in use; empty without any."""
    return next(filter(None, map(environment.get, _LOOPBACK_PROFILES)), "")


def _in_ros(pattern: str, environment: Mapping[str, str]) -> Iterator[Path]:
    """Yield the files of a pattern in the installations of ROS that the environment names."""
    for prefix in filter(None, environment.get("AMENT_PREFIX_PATH", "").split(os.pathsep)):
        yield from Path(prefix).glob(pattern)
    yield from Path(sys.prefix).glob(pattern)


def _check_profiles(name: str, path: str) -> None:
    try:
        ElementTree.parse(path)
    except OSError as error:
        reason = f"a file that can be read ({error.strerror})"
        raise RosEnvironmentError(name, path, reason) from None
    except ElementTree.ParseError as error:
        raise RosEnvironmentError(name, path, f"XML ({error})") from None


def _is_writable(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(folder, os.W_OK | os.X_OK)
