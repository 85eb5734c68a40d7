# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Nodes wait for the network where other machines are named, and tell of one that came late."""

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest
from patience import PATIENCE

from sphere_nmpc.ros.graph_faults import network_fault
from sphere_nmpc.ros.loopback import (
    DISCOVERY_RANGE,
    LOCALHOST_ONLY,
    other_machines,
    reaches_other_machines,
    use_loopback_only,
)
from sphere_nmpc.ros.network import network_addresses, wait_for_network

linux = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads Linux interfaces")
PEERS = {"ROS_STATIC_PEERS": "10.0.0.7"}
PROFILES = Path(__file__).parents[3] / "config" / "lossy_network.xml"
RUN = (sys.executable, "-c", "import sys; from sphere_sim.cli.main import main; sys.exit(main())")


@pytest.mark.parametrize(
    ("environment", "variable", "reaches"),
    [
        ({}, "", True),
        (PEERS, "ROS_STATIC_PEERS", True),
        ({**PEERS, DISCOVERY_RANGE: "LOCALHOST"}, "ROS_STATIC_PEERS", True),
        ({**PEERS, LOCALHOST_ONLY: "1"}, "ROS_STATIC_PEERS", True),
        ({**PEERS, DISCOVERY_RANGE: "OFF"}, "", False),
        ({DISCOVERY_RANGE: "LOCALHOST"}, "", False),
        ({"ROS_STATIC_PEERS": "localhost;127.0.0.1", LOCALHOST_ONLY: "1"}, "", False),
        ({"ROS_STATIC_PEERS": "127.0.0.1;10.127.0.1"}, "ROS_STATIC_PEERS", True),
        ({"ROS_DISCOVERY_SERVER": ";10.0.0.1:11811"}, "ROS_DISCOVERY_SERVER", True),
        ({"ROS_DISCOVERY_SERVER": "127.0.0.1:11811"}, "", True),
        ({"ROS_DISCOVERY_SERVER": "TCPv4:[127.0.0.1]:42100"}, "", True),
    ],
)
def test_environment_tells_whether_other_machines_are_named_and_reached(
    environment, variable, reaches
) -> None:
    assert other_machines(environment) == variable
    assert reaches_other_machines(environment) == reaches


def test_loopback_alone_reaches_no_other_machine() -> None:
    environment: dict[str, str] = {}
    use_loopback_only(environment)
    assert not reaches_other_machines(environment)


@linux
def test_start_waits_until_an_interface_is_in_operation() -> None:
    looks: list[int] = []

    def addresses() -> frozenset[str]:
        looks.append(1)
        return frozenset({"10.0.0.1"} if len(looks) > 3 else ())

    assert wait_for_network(PEERS, addresses, PATIENCE) == ""
    assert len(looks) == 4


@linux
def test_start_continues_without_a_network_and_says_so() -> None:
    message = wait_for_network(PEERS, frozenset, 0.1)
    assert message.startswith("network: given ROS_STATIC_PEERS and no network interface")
    assert message.endswith("restart it when the network is there")


def test_start_does_not_wait_where_no_other_machine_is_named() -> None:
    def addresses() -> frozenset[str]:
        raise AssertionError("not asked")

    assert wait_for_network({}, addresses) == ""


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


def test_profiles_for_lossy_networks_are_understood_by_fast_dds() -> None:
    environment = {**os.environ, "FASTRTPS_DEFAULT_PROFILES_FILE": str(PROFILES)}
    done = subprocess.run(
        [*RUN, "goal", "1", "0", "--timeout", "0"], env=environment, capture_output=True,
        text=True, timeout=PATIENCE, check=False,
    )
    assert "no controller was ready" in done.stderr
    assert not done.stdout, "errors in profiles are printed there"


@pytest.fixture
def hosts() -> Iterator[tuple[str, str]]:
    """Names of two network namespaces with a cable between them that is switched off."""
    if os.geteuid() != 0 or shutil.which("ip") is None:
        pytest.skip("needs root and the command ip (iproute2), for network namespaces")
    names = tuple(f"sphere_test_{os.getpid()}_{end}" for end in "ab")
    made = [["netns", "add", name] for name in names]
    made += [["-n", name, "link", "set", "lo", "up"] for name in names]
    made += [["link", "add", "name", "cable", "netns", names[0], "type", "veth",
              "peer", "name", "cable", "netns", names[1]],
             ["-n", names[0], "address", "add", "10.78.0.1/24", "dev", "cable"],
             ["-n", names[1], "address", "add", "10.78.0.2/24", "dev", "cable"]]
    try:
        for command in made:
            done = subprocess.run(["ip", *command], capture_output=True, text=True, check=False)
            if done.returncode:
                pytest.skip(f"no network namespaces here: {done.stderr.strip()}")
        yield names
    finally:
        for name in names:
            subprocess.run(["ip", "netns", "del", name], capture_output=True, check=False)


@pytest.mark.slow
def test_node_that_starts_before_its_network_is_found_from_another_host(hosts, tmp_path) -> None:
    here, there = hosts
    environment = {
        **{k: v for k, v in os.environ.items() if not k.startswith(("ROS_", "FAST"))},
        "ROS_DOMAIN_ID": "66", "ROS_LOG_DIR": str(tmp_path),
        "ROS_STATIC_PEERS": "10.78.0.1;10.78.0.2", DISCOVERY_RANGE: "LOCALHOST",
    }
    controller = subprocess.Popen(
        ["ip", "netns", "exec", here, *RUN, "controller"], env=environment,
        stderr=subprocess.PIPE, text=True,
    )
    try:
        time.sleep(3.0)  # most machines start a node in less; without the wait it is never found
        for host in hosts:
            subprocess.run(["ip", "-n", host, "link", "set", "cable", "up"], check=True)
        goal = subprocess.run(
            ["ip", "netns", "exec", there, *RUN, "goal", "1", "0", "--timeout", f"{PATIENCE}"],
            env=environment, capture_output=True, text=True, timeout=2.0 * PATIENCE, check=False,
        )
        assert goal.returncode == 0, goal.stderr
    finally:
        controller.terminate()
        _, printed = controller.communicate(timeout=PATIENCE)
    assert "network: given" not in printed
