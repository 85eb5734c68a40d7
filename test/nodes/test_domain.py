# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Commands that start nodes use a domain without other nodes of this package."""

import fcntl
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("rclpy")

from patience import until
from ros_graph import started

from sphere_nmpc.process.child import Child
from sphere_nmpc.ros.network import use_loopback_only
from sphere_sim.ros.session import other_publishers
from sphere_sim.ros.session.domain import own_domain
from sphere_sim.ros.session.other_publishers import DomainInUseError, find_publishers

pytestmark = pytest.mark.slow

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
def simulator(monkeypatch) -> Iterator[Child]:
    """A simulator in the domain of this session, once it is found there."""
    # The duration of a search is measured, not tested: a busy machine may need more.
    monkeypatch.setattr(other_publishers, "_SEARCHES", {True: (10.0,), False: (10.0,)})
    with started("simulator", start_paused=True) as process:
        until(find_publishers)
        yield process


def test_domain_in_use_is_named_where_it_is_set_and_passed_over_elsewhere(
    simulator, locks, monkeypatch
) -> None:
    message = rf"ROS_DOMAIN_ID: given {SESSION}, .*\(/simulator\), expected .*unset ROS_DOMAIN_ID"
    with pytest.raises(DomainInUseError, match=message), own_domain():
        pass
    monkeypatch.delenv("ROS_DOMAIN_ID")
    with own_domain(domains=(SESSION, *SPARE)) as domain:
        assert domain == SPARE[0] == int(os.environ["ROS_DOMAIN_ID"])
    assert "ROS_DOMAIN_ID" not in os.environ


def test_a_domain_that_is_locked_is_passed_over(locks, monkeypatch) -> None:
    monkeypatch.delenv("ROS_DOMAIN_ID")
    lock = locks / f"sphere_nmpc_domain_{SPARE[0]}.lock"
    lock.touch(mode=0o444)
    with lock.open() as other:
        fcntl.flock(other, fcntl.LOCK_EX)
        with own_domain(domains=SPARE) as domain:
            assert domain == SPARE[1]
    with own_domain(domains=SPARE) as domain:
        assert domain == SPARE[0], "the file of another user can be locked if it can be read"
