# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Environment of nodes: unusable values, network reach, interfaces, and nodes of other users."""

import ipaddress
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import psutil
import pytest
from geometry_msgs.msg import PoseStamped
from patience import PATIENCE, until

from sphere_nmpc.process.child import Child, stop_together
from sphere_nmpc.ros.guarded_node import LATCHED
from sphere_nmpc.ros.network import (
    DISCOVERY_RANGE,
    LOCALHOST_ONLY,
    RosEnvironmentError,
    apply_localhost_only,
    avoid_shared_memory,
    check_environment,
    check_middleware,
    check_shared_memory,
    network_addresses,
    network_reach,
    profiles_variable,
    reaches_other_machines,
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
ROOT = Path(__file__).parents[2]
OLD, NEW = ("", "FASTRTPS"), ("_fast_dds_3", "FASTDDS")
"""Parts of the names of profiles and variables, up to version 2 and from version 3 on."""
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


@pytest.mark.parametrize(
    ("name", "given", "expected"),
    [
        ("ROS_DOMAIN_ID", "233", "a whole number from 0 to 232"),
        ("ROS_DOMAIN_ID", "010", "a whole number"),
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
    for installed in ({"RMW_IMPLEMENTATION": "rmw_fastrtps_cpp"}, {}):
        check_middleware(installed)


@linux
def test_full_shared_memory_is_refused_unless_the_pages_of_ros_are_there(
    tmp_path, monkeypatch
) -> None:
    check_shared_memory(tmp_path)
    full = os.statvfs_result((4096, 4096, 16, 0, 0, 0, 0, 0, 0, 255))
    monkeypatch.setattr(os, "statvfs", lambda folder: full)
    words = f"{tmp_path}: given 'a full file system', expected .* bytes of room"
    pages = [tmp_path / name for name in ("lttng-ust-wait-6", f"lttng-ust-wait-6-{os.getuid()}")]
    for page in pages:
        with pytest.raises(RosEnvironmentError, match=words):
            check_shared_memory(tmp_path)
        page.touch()  # as a process leaves it that has found no room
    with pytest.raises(RosEnvironmentError, match=words):
        check_shared_memory(tmp_path)
    for page in pages:
        with page.open("wb") as file:
            file.write(bytes(4096))
            file.flush()
            os.fsync(file.fileno())  # some file systems allocate late
    check_shared_memory(tmp_path)


@pytest.mark.parametrize(
    "given",
    [{LOCALHOST_ONLY: "1", DISCOVERY_RANGE: "SUBNET"}, {DISCOVERY_RANGE: "localhost"}],
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


@pytest.mark.parametrize(
    ("environment", "expected"),
    [
        ({}, "domain 0: reachable from every machine of the network; ROS_LOCALHOST_ONLY=1"),
        ({"ROS_DOMAIN_ID": "7", DISCOVERY_RANGE: "SUBNET"}, "domain 7: reachable from every"),
        ({DISCOVERY_RANGE: "LOCALHOST"}, "machine only; its ports are open on all interfaces"),
        ({DISCOVERY_RANGE: "LOCALHOST", **PEERS}, "also from 10.0.0.7"),
        ({"ROS_DISCOVERY_SERVER": "10.0.0.1:11811"}, "discovery server 10.0.0.1:11811"),
        ({"FASTRTPS_DEFAULT_PROFILES_FILE": "mine.xml"}, "transports as in mine.xml"),
    ],
)
def test_network_reach_names_the_deciding_setting(environment, expected) -> None:
    assert expected in network_reach(environment)


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


def test_udp_alone_is_used_unless_the_environment_selects_transports() -> None:
    everywhere, here = {"ROS_DOMAIN_ID": "42"}, {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    avoid_shared_memory(everywhere)
    assert everywhere == {"ROS_DOMAIN_ID": "42", "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4"}
    avoid_shared_memory(here)
    assert "over the loopback" in network_reach(here)
    chosen = {"FASTDDS_BUILTIN_TRANSPORTS": "DEFAULT"}
    avoid_shared_memory(chosen)
    assert chosen == {"FASTDDS_BUILTIN_TRANSPORTS": "DEFAULT"}


@root
@pytest.mark.slow
def test_node_of_a_user_without_home_exchanges_messages_with_one_of_root(graph, tmp_path) -> None:
    tmp_path.chmod(0o777)
    environment = {name: value for name, value in os.environ.items()
                   if name not in ("ROS_LOG_DIR", "HOME")}
    command = [*as_user(54321), *RUN, "controller"]  # who has no entry in the list of users
    node = Child(command, "controller", tmp_path / "log", env=environment).start()
    try:
        until(lambda: "reachable" in node.output or not node.running)
        confirmed = graph.collect(PoseStamped, "controller/active_goal", LATCHED)
        graph.send_goal(PAPER_CASES[1].goal)
        graph.until(lambda: confirmed)
        node.send(signal.SIGTERM)
        assert node.wait(PATIENCE) == 0, node.output
    finally:
        node.kill()
    assert node.output.count("log file: given ~/.ros/log") == 1


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
    nodes = [Child([*RUN, verb, *arguments], verb, tmp_path / verb, env=plain, cwd=tmp_path)
             for verb, arguments in commands.items()]
    # Fast DDS opens three at least: for discovery, for data, and one to send from.
    wanted = {"controller": 3, "viewer": 4}
    try:
        processes = {node.name: psutil.Process(node.start().pid) for node in nodes}
        until(lambda: all(len(ports(processes[verb])) >= wanted[verb] for verb in processes))
        for verb, process in processes.items():
            found = ports(process)
            assert all(ipaddress.ip_address(ip).is_loopback for _, ip, _ in found), (verb, found)
    finally:
        stop_together(nodes)


@pytest.mark.parametrize("name", ["config/lossy_network", "sphere_nmpc/ros/loopback"])
def test_profiles_are_understood_by_fast_dds(name) -> None:
    used = profiles_variable()
    end, _ = NEW if NEW[1] in used else OLD
    done = subprocess.run(
        [*RUN, "goal", "1", "0", "--timeout", "0"], capture_output=True, text=True,
        env=os.environ | {used: str(ROOT / f"{name}{end}.xml")}, timeout=PATIENCE, check=False,
    )
    assert "no controller was ready" in done.stderr and "XMLPARSER" not in done.stderr
    assert not done.stdout, "errors in profiles are printed there"
    old, new = ((ROOT / f"{name}{end}.xml").read_text().split() for end, _ in (OLD, NEW))
    assert len([*filter(new.__contains__, old)]) >= len(old) - 4, "settings are the same"


def test_the_profiles_are_those_of_the_installed_fast_dds(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(sys, "prefix", "/nonexistent")
    for made, (end, variable) in (([], OLD), (["lib"], OLD), (["lib", "libfastdds.so"], NEW)):
        tmp_path.joinpath(*made).mkdir(exist_ok=True)
        environment = {"AMENT_PREFIX_PATH": f"/absent:{tmp_path}"}
        use_loopback_only(environment)
        profiles = {n: Path(v).name for n, v in environment.items() if n.startswith("FAST")}
        assert profiles == {f"{variable}_DEFAULT_PROFILES_FILE": f"loopback{end}.xml"}
