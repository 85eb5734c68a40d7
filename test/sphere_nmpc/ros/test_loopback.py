# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Nodes do what the environment of ROS says, and stay on the loopback where it asks for that."""

import ipaddress
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from xml.etree import ElementTree

import pytest

from sphere_nmpc.ros.loopback import (
    RANGE,
    SWITCH,
    audience,
    heed_localhost_only,
    stay_on_this_machine,
)

psutil = pytest.importorskip("psutil")

VERBS = ("simulator", "controller", "recorder", "markers", "viewer")
PATIENCE = 60.0
"""How long five nodes may take to come up on a busy machine [s]."""
OF_FAST_DDS = 3
"""Ports that Fast DDS opens at the least: for news of nodes, for data, and one to send from."""


def test_file_of_fast_dds_is_installed_and_names_the_loopback_alone() -> None:
    environment: dict[str, str] = {}
    stay_on_this_machine(environment)
    (path,) = {value for name, value in environment.items() if name != RANGE}
    tree = ElementTree.parse(path)
    found = [e.text for e in tree.iter() if e.tag.endswith("}address")]
    assert set(found) == {"127.0.0.1"}
    assert environment[RANGE] == "SYSTEM_DEFAULT"


def test_range_of_this_machine_means_the_same() -> None:
    unset: dict[str, str] = {}
    given = {RANGE: "localhost"}
    stay_on_this_machine(unset)
    stay_on_this_machine(given)
    assert given == unset
    stay_on_this_machine(given)
    assert given == unset, "also for a process that was started by one of ours"


@pytest.mark.parametrize(
    "wish",
    [{RANGE: "SUBNET"}, {RANGE: "OFF"}, {"ROS_STATIC_PEERS": "192.168.1.7"},
     {"ROS_DISCOVERY_SERVER": "127.0.0.1:11811"}, {"FASTRTPS_DEFAULT_PROFILES_FILE": "mine.xml"}],
)
def test_who_says_who_is_to_be_heard_is_obeyed(wish) -> None:
    environment = dict(wish)
    stay_on_this_machine(environment)
    assert environment == wish


def test_other_middleware_is_asked_in_the_words_of_ros() -> None:
    environment = {"RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"}
    stay_on_this_machine(environment)
    assert environment == {"RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp", RANGE: "LOCALHOST"}


@pytest.mark.parametrize("given", [{}, {RANGE: "LOCALHOST"}, {SWITCH: "0"}, {SWITCH: ""}])
def test_a_node_leaves_the_environment_alone_unless_asked(given) -> None:
    environment = dict(given)
    heed_localhost_only(environment)
    assert environment == given


@pytest.mark.parametrize("range_", ["", "SUBNET"])
def test_localhost_only_means_the_loopback_alone_whatever_the_range(range_) -> None:
    asked, wanted = {SWITCH: "1", RANGE: range_}, {}
    heed_localhost_only(asked)
    stay_on_this_machine(wanted)
    assert asked == wanted


@pytest.mark.parametrize(
    ("environment", "told"),
    [
        ({}, "domain 0: heard by every machine of the network; ROS_LOCALHOST_ONLY=1 keeps"),
        ({"ROS_DOMAIN_ID": "7", RANGE: "SUBNET"}, "domain 7: heard by every machine"),
        ({RANGE: "LOCALHOST"}, "on this machine only; its ports are open on all interfaces"),
        ({SWITCH: "1"}, "on this machine only"),
        ({RANGE: "OFF"}, "heard by nobody"),
        ({RANGE: "LOCALHOST", "ROS_STATIC_PEERS": "10.0.0.7"}, "also by 10.0.0.7"),
        ({"ROS_DISCOVERY_SERVER": "10.0.0.1:11811"}, "discovery server 10.0.0.1:11811"),
        ({"FASTRTPS_DEFAULT_PROFILES_FILE": "mine.xml"}, "transports as in mine.xml"),
        ({"ROS_SECURITY_ENABLE": "true"}, "SROS 2 is on"),
    ],
)
def test_one_line_says_who_can_hear_a_node(environment, told) -> None:
    assert told in audience(environment)


def test_who_stays_on_the_loopback_says_so() -> None:
    environment = {"ROS_DOMAIN_ID": "3"}
    stay_on_this_machine(environment)
    assert audience(environment) == (
        "ROS domain 3: heard on this machine only, over the loopback"
    )


@pytest.fixture
def nodes(tmp_path) -> Iterator[dict[str, psutil.Process]]:
    """All nodes of the package, asked to stay on this machine."""
    plain = {
        name: value for name, value in os.environ.items()
        if not name.startswith(("ROS_", "FAST")) or name == "ROS_DOMAIN_ID"
    } | {SWITCH: "1"}
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
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="looks at processes of Linux")
def test_nothing_listens_beyond_the_loopback(nodes) -> None:
    pytest.importorskip("viser")
    end = time.monotonic() + PATIENCE
    wanted = {verb: OF_FAST_DDS + (verb == "viewer") for verb in VERBS}
    while any(len(ports(nodes[verb])) < wanted[verb] for verb in VERBS) or not any(
        kind == "SOCK_STREAM" for kind, _, _ in ports(nodes["viewer"])
    ):
        assert time.monotonic() < end, {verb: ports(nodes[verb]) for verb in VERBS}
        time.sleep(0.1)
    time.sleep(1.0)  # by now they have met, and opened what they send to each other from
    for verb, process in nodes.items():
        found = ports(process)
        beyond = {p for p in found if not ipaddress.ip_address(p[1]).is_loopback}
        assert not beyond, verb
