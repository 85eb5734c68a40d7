# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Network reach of nodes follows the ROS environment, down to the loopback interface only."""

import ipaddress
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from xml.etree import ElementTree

import pytest
from patience import PATIENCE

from sphere_nmpc.ros.loopback import (
    DISCOVERY_RANGE,
    LOCALHOST_ONLY,
    apply_localhost_only,
    network_reach,
    use_loopback_only,
)

psutil = pytest.importorskip("psutil")

VERBS = ("simulator", "controller", "recorder", "markers", "viewer")
OF_FAST_DDS = 3
"""Fewest ports that Fast DDS opens: for discovery, for data, and one to send from."""


def test_installed_fast_dds_profiles_list_only_the_loopback() -> None:
    environment: dict[str, str] = {}
    use_loopback_only(environment)
    (path,) = {value for name, value in environment.items() if name != DISCOVERY_RANGE}
    tree = ElementTree.parse(path)
    found = [e.text for e in tree.iter() if e.tag.endswith("}address")]
    assert set(found) == {"127.0.0.1"}
    assert environment[DISCOVERY_RANGE] == "SYSTEM_DEFAULT"


def test_discovery_range_localhost_restricts_to_the_loopback() -> None:
    unset: dict[str, str] = {}
    given = {DISCOVERY_RANGE: "localhost"}
    use_loopback_only(unset)
    use_loopback_only(given)
    assert given == unset
    use_loopback_only(given)
    assert given == unset, "idempotent, as in a child process"


@pytest.mark.parametrize(
    "given",
    [{DISCOVERY_RANGE: "SUBNET"}, {DISCOVERY_RANGE: "OFF"}, {"ROS_STATIC_PEERS": "192.168.1.7"},
     {"ROS_DISCOVERY_SERVER": "127.0.0.1:11811"}, {"FASTRTPS_DEFAULT_PROFILES_FILE": "mine.xml"}],
)
def test_explicit_discovery_settings_are_unchanged(given) -> None:
    environment = dict(given)
    use_loopback_only(environment)
    assert environment == given


def test_other_middleware_gets_the_discovery_range_localhost() -> None:
    cyclone = {"RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"}
    environment = dict(cyclone)
    use_loopback_only(environment)
    assert environment == {**cyclone, DISCOVERY_RANGE: "LOCALHOST"}


@pytest.mark.parametrize(
    "given", [{}, {DISCOVERY_RANGE: "LOCALHOST"}, {LOCALHOST_ONLY: "0"}, {LOCALHOST_ONLY: ""}]
)
def test_environment_without_localhost_only_is_unchanged(given) -> None:
    environment = dict(given)
    apply_localhost_only(environment)
    assert environment == given


@pytest.mark.parametrize("range_", ["", "SUBNET"])
def test_localhost_only_overrides_the_discovery_range(range_) -> None:
    given, expected = {LOCALHOST_ONLY: "1", DISCOVERY_RANGE: range_}, {}
    apply_localhost_only(given)
    use_loopback_only(expected)
    assert given == expected


@pytest.mark.parametrize(
    ("environment", "expected"),
    [
        ({}, "domain 0: reachable from every machine of the network; ROS_LOCALHOST_ONLY=1"),
        ({"ROS_DOMAIN_ID": "7", DISCOVERY_RANGE: "SUBNET"}, "domain 7: reachable from every"),
        ({DISCOVERY_RANGE: "LOCALHOST"}, "machine only; its ports are open on all interfaces"),
        ({LOCALHOST_ONLY: "1"}, "from this machine only"),
        ({DISCOVERY_RANGE: "OFF"}, "reachable from this process only"),
        ({DISCOVERY_RANGE: "LOCALHOST", "ROS_STATIC_PEERS": "10.0.0.7"}, "also from 10.0.0.7"),
        ({"ROS_DISCOVERY_SERVER": "10.0.0.1:11811"}, "discovery server 10.0.0.1:11811"),
        ({"FASTRTPS_DEFAULT_PROFILES_FILE": "mine.xml"}, "transports as in mine.xml"),
        ({"ROS_SECURITY_ENABLE": "true"}, "SROS 2 is on"),
    ],
)
def test_network_reach_names_the_deciding_setting(environment, expected) -> None:
    assert expected in network_reach(environment)


def test_network_reach_of_the_loopback() -> None:
    environment = {"ROS_DOMAIN_ID": "3"}
    use_loopback_only(environment)
    assert network_reach(environment) == (
        "ROS domain 3: reachable from this machine only, over the loopback"
    )


@pytest.fixture
def nodes(tmp_path) -> Iterator[dict[str, psutil.Process]]:
    """Start all nodes of the package with ROS_LOCALHOST_ONLY=1."""
    plain = {
        name: value for name, value in os.environ.items()
        if not name.startswith(("ROS_", "FAST")) or name == "ROS_DOMAIN_ID"
    } | {LOCALHOST_ONLY: "1"}
    arguments = {"viewer": ["--port", "0"]}
    started = {
        verb: subprocess.Popen(
            [sys.executable, "-c", "import sys; from sphere_sim.cli.main import main; "
             "sys.exit(main())", verb, *arguments.get(verb, [])],
            env=plain, cwd=tmp_path, stdout=subprocess.DEVNULL,
        )
        for verb in VERBS
    }
    yield {verb: psutil.Process(process.pid) for verb, process in started.items()}
    for process in started.values():
        process.send_signal(signal.SIGINT)
    for process in started.values():
        try:
            process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def ports(process: psutil.Process) -> set[tuple[str, str, int]]:
    """Return kind, address and port of all sockets of a process and its children."""
    family = [process, *process.children(recursive=True)]
    ends = [end for member in family for end in member.net_connections("inet")]
    return {(end.type.name, end.laddr.ip, end.laddr.port) for end in ends if end.laddr}


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads Linux process tables")
def test_nodes_open_ports_on_the_loopback_only(nodes) -> None:
    pytest.importorskip("viser")
    end = time.monotonic() + PATIENCE
    wanted = {verb: OF_FAST_DDS + (verb == "viewer") for verb in VERBS}
    while any(len(ports(nodes[verb])) < wanted[verb] for verb in VERBS) or not any(
        kind == "SOCK_STREAM" for kind, _, _ in ports(nodes["viewer"])
    ):
        assert time.monotonic() < end, {verb: ports(nodes[verb]) for verb in VERBS}
        time.sleep(0.1)
    time.sleep(1.0)  # discovery is complete by now, and the sending ports are open
    for verb, process in nodes.items():
        found = ports(process)
        beyond = {p for p in found if not ipaddress.ip_address(p[1]).is_loopback}
        assert not beyond, verb
