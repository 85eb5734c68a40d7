# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Commands that start nodes use a domain without other nodes of this package."""

import fcntl
import os
import stat
import subprocess
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("rclpy")

from geometry_msgs.msg import PoseStamped
from patience import PATIENCE
from ros_graph import Graph, started
from rosgraph_msgs.msg import Clock

from sphere_nmpc.ros.network import use_loopback_only
from sphere_sim.ros.session import other_publishers
from sphere_sim.ros.session.domain import own_domain
from sphere_sim.ros.session.other_publishers import (
    DomainInUseError,
    find_publishers,
    require_sole_publishers,
)

SESSION = int(os.environ["ROS_DOMAIN_ID"])
SPARE = (187, 186, 185)
"""Domains that nothing of this package takes by itself."""


@pytest.fixture(autouse=True)
def locks(monkeypatch, tmp_path) -> Path:
    """Use the loopback as the commands do, and a temporary folder for the locks."""
    wanted = dict(os.environ)
    use_loopback_only(wanted)
    for name, value in wanted.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


@pytest.fixture
def simulator(monkeypatch) -> Iterator[subprocess.Popen]:
    """A simulator in the domain of this session, once it is found there."""
    # The duration of a search is measured, not tested: a busy machine may need more.
    monkeypatch.setattr(other_publishers, "_SEARCHES", {True: (10.0,), False: (10.0,)})
    with started("simulator", "-p", "start_paused:=true") as process:
        end = time.monotonic() + PATIENCE
        while not find_publishers():
            assert time.monotonic() < end
        yield process


@pytest.fixture
def domain_unset(monkeypatch) -> None:
    # Set first, so that the value of the code under test is removed at the end.
    monkeypatch.setenv("ROS_DOMAIN_ID", "0")
    monkeypatch.delenv("ROS_DOMAIN_ID")


def lock_of(folder: Path, domain: int) -> Path:
    return folder / f"sphere_nmpc_domain_{domain}.lock"


def test_nodes_in_the_domain_that_is_set_are_named(simulator) -> None:
    message = rf"ROS_DOMAIN_ID: given {SESSION}, .*\(/simulator\), expected .*unset ROS_DOMAIN_ID"
    with pytest.raises(DomainInUseError, match=message), own_domain():
        pass


def test_a_domain_in_use_is_passed_over(simulator, locks, domain_unset) -> None:
    with own_domain(domains=(SESSION, *SPARE)) as domain:
        assert domain == SPARE[0] == int(os.environ["ROS_DOMAIN_ID"])
    assert "ROS_DOMAIN_ID" not in os.environ


@pytest.mark.parametrize("mode", [0o644, 0o444], ids=["own", "of another user"])
def test_a_domain_that_is_locked_is_passed_over(locks, domain_unset, mode) -> None:
    lock_of(locks, SPARE[0]).touch()
    lock_of(locks, SPARE[0]).chmod(mode)
    with lock_of(locks, SPARE[0]).open() as other:
        fcntl.flock(other, fcntl.LOCK_EX)
        with own_domain(domains=SPARE) as domain:
            assert domain == SPARE[1]
    with own_domain(domains=SPARE) as domain:
        assert domain == SPARE[0], "the file of another user can be locked if it can be read"


def test_links_and_pipes_in_place_of_a_lock_are_not_touched(locks, domain_unset) -> None:
    target = locks / "target"
    lock_of(locks, SPARE[0]).symlink_to(target)
    os.mkfifo(lock_of(locks, SPARE[1]))
    with own_domain(domains=SPARE) as domain:
        assert domain in SPARE[1:]
    assert not target.exists()
    assert stat.S_ISLNK(lock_of(locks, SPARE[0]).lstat().st_mode)


def test_second_publisher_of_a_topic_is_refused() -> None:
    graph = Graph()
    try:
        for number in (1, 2):
            graph.probe.create_publisher(PoseStamped, "pose", 1)
            graph.until(lambda n=number: graph.probe.count_publishers("pose") == n)
            if number == 1:
                graph.probe.create_publisher(Clock, "clock", 1)
                require_sole_publishers(graph.probe)
        with pytest.raises(DomainInUseError, match=r"\(/probe, /probe\)"):
            require_sole_publishers(graph.probe)
    finally:
        graph.close()
