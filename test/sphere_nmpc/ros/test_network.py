# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Environment of nodes: unusable values, network reach, interfaces, and nodes of other users."""

import ipaddress
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from xml.etree import ElementTree

import psutil
import pytest
from geometry_msgs.msg import PoseStamped
from patience import PATIENCE
from ros_graph import Graph

from sphere_nmpc.ros.graph_monitor import network_fault
from sphere_nmpc.ros.guarded_node import LATCHED
from sphere_nmpc.ros.messages import pose_to_ros
from sphere_nmpc.ros.network import (
    DISCOVERY_RANGE,
    LOCALHOST_ONLY,
    RosEnvironmentError,
    apply_localhost_only,
    avoid_foreign_shared_memory,
    check_environment,
    check_middleware,
    domain_id,
    network_addresses,
    network_reach,
    other_machines,
    reaches_other_machines,
    unwritable_log_folder,
    use_loopback_only,
    wait_for_network,
)
from sphere_sim.scenario.scenarios import PAPER_CASES

linux = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads Linux interfaces")
root = pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="needs root")
READING = ("--inh-caps=+dac_read_search", "--ambient-caps=+dac_read_search")
"""Permission to read everywhere: interpreter and package may lie below a folder of root alone."""
NOWHERE = "/proc/nonexistent"
"""Folder that not even root can create."""
PEERS = {"ROS_STATIC_PEERS": "10.0.0.7"}
PROFILES = Path(__file__).parents[3] / "config" / "lossy_network.xml"
COMPILER = Path(__file__).parents[1] / "solver" / "quick_cc.sh"
"""One that does not optimise, for nodes that build the solver."""
RUN = (sys.executable, "-c", "import sys; from sphere_sim.cli.main import main; sys.exit(main())")


def as_user(user: int) -> tuple[str, ...]:
    """Return the beginning of a command that runs as a user; skip the test where it cannot."""
    if os.geteuid() != 0 or shutil.which("setpriv") is None:
        pytest.skip("needs root and setpriv, of util-linux, to become another user")
    become = ("setpriv", f"--reuid={user}", f"--regid={user}", "--clear-groups")
    for command in (become, (*become, *READING)):
        use = [*command, sys.executable, "-c", "import sphere_nmpc.solver"]
        if subprocess.run(use, capture_output=True, check=False).returncode == 0:
            return command
    pytest.skip("no other user can read this Python, and root may not grant it here")


@pytest.mark.parametrize("given", ["abc", "233", "-3", "010", "1.5", " 7", "0x10", "٣"])
def test_invalid_domain_id_is_refused(given) -> None:
    with pytest.raises(RosEnvironmentError, match=r"ROS_DOMAIN_ID: given .* from 0 to 232"):
        domain_id({"ROS_DOMAIN_ID": given})


@pytest.mark.parametrize(("given", "domain"), [("0", 0), ("232", 232), ("", None)])
def test_valid_domain_id_is_read(given, domain) -> None:
    assert domain_id({"ROS_DOMAIN_ID": given}) == domain


@pytest.mark.parametrize(
    ("name", "given", "expected"),
    [
        ("FASTRTPS_DEFAULT_PROFILES_FILE", "/absent.xml", "a file that can be read"),
        ("FASTRTPS_DEFAULT_PROFILES_FILE", __file__, "XML"),
        ("ROS_STATIC_PEERS", "no/name", "names or addresses"),
        ("ROS_LOG_DIR", NOWHERE, "a folder"),
    ],
)
def test_error_names_the_variable_and_the_expected_value(name, given, expected) -> None:
    with pytest.raises(RosEnvironmentError, match=f"{name}: given .*, expected {expected}"):
        check_environment({name: given})


def test_middleware_that_is_not_installed_is_refused() -> None:
    with pytest.raises(RosEnvironmentError, match=r"given 'nonesuch', expected .*rmw_"):
        check_middleware({"RMW_IMPLEMENTATION": "nonesuch"})
    check_middleware({"RMW_IMPLEMENTATION": "rmw_fastrtps_cpp"})
    check_middleware({})


def test_default_log_folder_is_that_of_ros(tmp_path) -> None:
    assert unwritable_log_folder({"ROS_HOME": str(tmp_path / "new")}) is None
    assert (tmp_path / "new" / "log").is_dir()
    assert unwritable_log_folder({"ROS_HOME": NOWHERE}) == Path(NOWHERE) / "log"
    assert unwritable_log_folder({"ROS_LOG_DIR": NOWHERE}) is None, "for check_environment"


def test_installed_fast_dds_profiles_list_only_the_loopback() -> None:
    environment: dict[str, str] = {}
    use_loopback_only(environment)
    assert environment.pop(DISCOVERY_RANGE) == "SYSTEM_DEFAULT"
    (path,) = set(environment.values())
    found = [e.text for e in ElementTree.parse(path).iter() if e.tag.endswith("}address")]
    assert set(found) == {"127.0.0.1"}


@pytest.mark.parametrize(
    "given",
    [{LOCALHOST_ONLY: "1"}, {LOCALHOST_ONLY: "1", DISCOVERY_RANGE: "SUBNET"},
     {DISCOVERY_RANGE: "localhost"}],
)
def test_localhost_is_applied_strictly_and_once(given) -> None:
    expected: dict[str, str] = {}
    use_loopback_only(expected)
    for _ in range(2):  # again in a child process
        apply_localhost_only(given)
        use_loopback_only(given)
        assert given == expected
    assert network_reach({**given, "ROS_DOMAIN_ID": "3"}) == (
        "ROS domain 3: reachable from this machine only, over the loopback"
    )
    assert not reaches_other_machines(given)


@pytest.mark.parametrize(
    "given",
    [{DISCOVERY_RANGE: "SUBNET"}, {DISCOVERY_RANGE: "OFF"}, PEERS,
     {"ROS_DISCOVERY_SERVER": "127.0.0.1:11811"}, {"FASTRTPS_DEFAULT_PROFILES_FILE": "mine.xml"}],
)
def test_explicit_discovery_settings_are_unchanged(given) -> None:
    environment = dict(given)
    use_loopback_only(environment)
    apply_localhost_only(environment)
    assert environment == given


def test_other_middleware_gets_the_discovery_range_localhost() -> None:
    environment = {"RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"}
    use_loopback_only(environment)
    assert environment[DISCOVERY_RANGE] == "LOCALHOST" and len(environment) == 2


@pytest.mark.parametrize(
    ("environment", "expected"),
    [
        ({}, "domain 0: reachable from every machine of the network; ROS_LOCALHOST_ONLY=1"),
        ({"ROS_DOMAIN_ID": "7", DISCOVERY_RANGE: "SUBNET"}, "domain 7: reachable from every"),
        ({DISCOVERY_RANGE: "LOCALHOST"}, "machine only; its ports are open on all interfaces"),
        ({DISCOVERY_RANGE: "OFF"}, "reachable from this process only"),
        ({DISCOVERY_RANGE: "LOCALHOST", **PEERS}, "also from 10.0.0.7"),
        ({"ROS_DISCOVERY_SERVER": "10.0.0.1:11811"}, "discovery server 10.0.0.1:11811"),
        ({"FASTRTPS_DEFAULT_PROFILES_FILE": "mine.xml"}, "transports as in mine.xml"),
        ({"ROS_SECURITY_ENABLE": "true"}, "SROS 2 is on"),
    ],
)
def test_network_reach_names_the_deciding_setting(environment, expected) -> None:
    assert expected in network_reach(environment)


@pytest.mark.parametrize(
    ("environment", "variable", "reaches"),
    [
        ({}, "", True),
        (PEERS, "ROS_STATIC_PEERS", True),
        ({**PEERS, LOCALHOST_ONLY: "1"}, "ROS_STATIC_PEERS", True),
        ({**PEERS, DISCOVERY_RANGE: "OFF"}, "", False),
        ({DISCOVERY_RANGE: "LOCALHOST"}, "", False),
        ({"ROS_STATIC_PEERS": "localhost;127.0.0.1", LOCALHOST_ONLY: "1"}, "", False),
        ({"ROS_STATIC_PEERS": "127.0.0.1;10.127.0.1"}, "ROS_STATIC_PEERS", True),
        ({"ROS_DISCOVERY_SERVER": ";10.0.0.1:11811"}, "ROS_DISCOVERY_SERVER", True),
        ({"ROS_DISCOVERY_SERVER": "TCPv4:[127.0.0.1]:42100"}, "", True),
    ],
)
def test_environment_tells_whether_other_machines_are_named_and_reached(
    environment, variable, reaches
) -> None:
    assert other_machines(environment) == variable
    assert reaches_other_machines(environment) == reaches


@linux
def test_start_waits_for_an_interface_only_where_other_machines_are_named() -> None:
    looks: list[int] = []

    def addresses() -> frozenset[str]:
        looks.append(1)
        return frozenset({"10.0.0.1"} if len(looks) > 3 else ())

    assert wait_for_network({}, addresses) == "" and not looks
    assert wait_for_network(PEERS, addresses, PATIENCE) == "" and len(looks) == 4
    message = wait_for_network(PEERS, frozenset, 0.1)
    assert message.startswith("network: given ROS_STATIC_PEERS and no network interface")
    assert message.endswith("restart it when the network is there")


@linux
def test_addresses_are_those_of_interfaces_in_operation() -> None:
    running = {name for name, state in psutil.net_if_stats().items()
               if state.isup and "running" in state.flags and "loopback" not in state.flags}
    known = {end.address for name, ends in psutil.net_if_addrs().items() if name in running
             for end in ends if end.family.name == "AF_INET"}
    assert network_addresses() <= known
    assert bool(network_addresses()) == bool(known)


@pytest.mark.parametrize(
    ("announced", "present", "fault"),
    [
        (set(), {"10.0.0.1"}, True),
        ({"10.0.0.1"}, {"10.0.0.9"}, True),
        ({"10.0.0.1"}, set(), False),  # a cable that is pulled, and may be put back
        ({"10.0.0.1"}, {"10.0.0.1", "172.17.0.1"}, False),
        (set(), set(), False),
    ],
)
def test_fault_is_that_no_announced_address_is_left(announced, present, fault) -> None:
    assert bool(network_fault(announced, present)) == fault


@root
def test_shared_memory_of_other_users_selects_udp(tmp_path) -> None:
    def environment(**more: str) -> dict[str, str]:
        return {"ROS_DOMAIN_ID": "42", **more}

    segment = tmp_path / f"fastrtps_port{7400 + 250 * 42 + 11}"
    segment.touch()
    assert not avoid_foreign_shared_memory(environment(), tmp_path), "its own"
    os.chown(segment, 65534, 65534)
    changed = environment()
    assert "uid 65534" in avoid_foreign_shared_memory(changed, tmp_path)
    assert changed == environment(FASTDDS_BUILTIN_TRANSPORTS="UDPv4")
    here = environment(ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST")
    assert "the loopback alone" in avoid_foreign_shared_memory(here, tmp_path)
    assert "over the loopback" in network_reach(here)
    for unchanged in (
        environment(FASTDDS_BUILTIN_TRANSPORTS="DEFAULT"), environment(ROS_DOMAIN_ID="43"), {}
    ):
        assert not avoid_foreign_shared_memory(dict(unchanged), tmp_path)


def controller(
    environment: dict[str, str | None], within: tuple[str, ...] = ()
) -> subprocess.Popen:
    whole = os.environ | {"PYTHONUNBUFFERED": "1", "CC": str(COMPILER)} | environment
    return subprocess.Popen(
        [*within, *RUN, "controller"],
        env={name: value for name, value in whole.items() if value is not None},
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
    )


def test_node_in_an_unusable_environment_ends_with_code_2_and_one_line() -> None:
    node = controller({"ROS_DOMAIN_ID": "500"})
    _, errors = node.communicate(timeout=PATIENCE)
    assert node.returncode == 2
    assert errors.startswith("cannot start: ROS_DOMAIN_ID: given '500', expected")
    assert errors.count("\n") == 1


@root
@pytest.mark.slow
def test_node_of_a_user_without_home_exchanges_messages_with_one_of_root(tmp_path) -> None:
    graph, lines = Graph(), []
    environment = {"ROS_LOG_DIR": None, "HOME": None, "SPHERE_NMPC_CACHE": str(tmp_path)}
    tmp_path.chmod(0o777)
    node = controller(environment, as_user(54321))  # who has no entry in the list of users
    try:
        while not lines or "reachable" not in lines[-1]:  # the solver may have to be built first
            lines.append(node.stderr.readline())
            assert lines[-1], lines
        confirmed = graph.collect(PoseStamped, "controller/active_goal", LATCHED)
        goals = graph.publisher(PoseStamped, "goal_pose")
        goals.publish(pose_to_ros(PAPER_CASES[1].goal, 0, 0.3))
        graph.until(lambda: confirmed)
    finally:
        graph.close()
        node.terminate()
        lines.append(node.communicate(timeout=PATIENCE)[1])
    assert node.returncode == 0, lines
    assert sum("shared memory: given" in line for line in lines) == 1
    assert sum("log file: given ~/.ros/log" in line for line in lines) == 1


def ports(process: psutil.Process) -> set[tuple[str, str, int]]:
    """Return kind, address and port of all sockets of a process and its children."""
    family = [process, *process.children(recursive=True)]
    ends = [end for member in family for end in member.net_connections("inet")]
    return {(end.type.name, end.laddr.ip, end.laddr.port) for end in ends if end.laddr}


@linux
@pytest.mark.slow
def test_nodes_open_ports_on_the_loopback_only(tmp_path) -> None:
    plain = {
        name: value for name, value in os.environ.items()
        if not name.startswith(("ROS_", "FAST")) or name == "ROS_DOMAIN_ID"
    } | {LOCALHOST_ONLY: "1"}
    commands = {"controller": (), "viewer": ("--port", "0")}
    started = {
        verb: subprocess.Popen([*RUN, verb, *arguments], env=plain, cwd=tmp_path,
                               stdout=subprocess.DEVNULL)
        for verb, arguments in commands.items()
    }
    nodes = {verb: psutil.Process(process.pid) for verb, process in started.items()}
    # Fast DDS opens three at least: for discovery, for data, and one to send from.
    wanted = {"controller": 3, "viewer": 4}
    try:
        end = time.monotonic() + PATIENCE
        while any(len(ports(nodes[verb])) < wanted[verb] for verb in nodes):
            assert time.monotonic() < end, {verb: ports(nodes[verb]) for verb in nodes}
            time.sleep(0.1)
        for verb, process in nodes.items():
            found = ports(process)
            assert all(ipaddress.ip_address(ip).is_loopback for _, ip, _ in found), (verb, found)
    finally:
        for process in started.values():
            process.send_signal(signal.SIGINT)
        for process in started.values():
            process.wait(PATIENCE)


def test_profiles_for_lossy_networks_are_understood_by_fast_dds() -> None:
    environment = {**os.environ, "FASTRTPS_DEFAULT_PROFILES_FILE": str(PROFILES)}
    done = subprocess.run(
        [*RUN, "goal", "1", "0", "--timeout", "0"], env=environment, capture_output=True,
        text=True, timeout=PATIENCE, check=False,
    )
    assert "no controller was ready" in done.stderr
    assert not done.stdout, "errors in profiles are printed there"
