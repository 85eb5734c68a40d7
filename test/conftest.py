# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Isolation of the test session from other ROS graphs and from randomness; common fixtures."""

import fcntl
import importlib.machinery
import os
import signal
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from hypothesis import settings

if TYPE_CHECKING:
    from ros_graph import Graph

_HERE = Path(__file__).parent
# `colcon test` runs in the source tree, which would hide the package that has been built.
_INSTALLED = [path for path in sys.path if Path(path).resolve() != _HERE.parent]
if importlib.machinery.PathFinder.find_spec("sphere_nmpc", _INSTALLED):
    sys.path[:] = _INSTALLED
    os.environ["PYTHONSAFEPATH"] = "1"  # the same for children
# Modules that tests share, those of the campaign of faults, and the scripts of bench/, some of
# which are tested.
_SCRIPTS = _HERE.parent / "bench"
# Not this folder: names of its tests could hide modules.
sys.path += map(str, (_HERE / "support", _HERE / "campaign", _SCRIPTS, _SCRIPTS / "documents"))


def _lock_domain() -> int:
    """Return a ROS domain id that no other session on this machine holds, and hold it.

    The lock is released with the process, however it ends; ids derived from process ids would
    collide in one of a hundred sessions. The ports of ids above 101 are ephemeral ports of Linux.
    """
    folder = Path(tempfile.gettempdir())
    for domain in range(1, 102):
        try:
            path = folder / f"sphere_nmpc_domain_{domain}.lock"
            lock = os.open(path, os.O_CREAT | os.O_RDWR | os.O_NOFOLLOW)
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:  # held by another session, or left by another user
            continue
        return domain
    raise RuntimeError("all ROS domain ids from 1 to 101 are in use")


os.environ["ROS_DOMAIN_ID"] = str(_lock_domain())
# After the folders: from the package that is tested.
from sphere_nmpc.ros.network import use_loopback_only  # noqa: E402

use_loopback_only()
from end_of_run import end_with_this_process  # noqa: E402

from sphere_nmpc.process.child import END_SIGNALS  # noqa: E402

end_with_this_process()

# No deadline, as the machine may be busy; equal examples in each run.
settings.register_profile("repeatable", deadline=None, derandomize=True)
settings.load_profile("repeatable")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the files that have slow tests, so that none is alone at the end."""
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: item.path not in slow)


@pytest.fixture
def graph(request: pytest.FixtureRequest) -> Iterator["Graph"]:
    """Return a new graph of nodes; a parameter, if there is one, is the arguments for rclpy."""
    pytest.importorskip("rclpy")
    from ros_graph import running_graph

    with running_graph(getattr(request, "param", None)) as graph:
        yield graph


@pytest.fixture(autouse=True)
def _signals_have_their_defaults() -> None:
    """Let interrupts reach the processes under test.

    An ignored signal is inherited: from a shell that started the session in the background, or
    from a node in the session that ignored further signals at its end.
    """
    for number in END_SIGNALS:
        signal.signal(number, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.default_int_handler)
