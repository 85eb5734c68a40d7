# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Goals of clients with simulator, controller and navigator as processes; each of them is killed.

The protocol of goals is tested in test/unit/control/test_goal_client.py, and under faults by the
campaign.
"""

import importlib.util
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import navigation_messages
import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from navigation_client import drawn, pose
from navigation_session import Session
from patience import PATIENCE
from ros_graph import running_graph

from sphere_sim.ros.session.process_set import ProcessSet, verb_command

ROOT = Path(__file__).parents[2]
DOCUMENT = ROOT / "docs" / "when_it_does_not_move.md"
ROWS = [
    re.compile(".*".join(map(re.escape, row.split("…"))))
    for row in re.findall(r"^\| ([^|]+?) \|", DOCUMENT.read_text("utf-8"), re.MULTILINE)
]
"""Patterns of the documented warnings."""


@pytest.fixture(scope="module")
def session(tmp_path_factory) -> Iterator[Session]:
    navigation_messages.provide()
    folder = tmp_path_factory.mktemp("session")
    with running_graph() as graph, ProcessSet(folder) as processes:
        yield Session(graph, processes)
    log = (folder / "navigator.log").read_text()
    for warning in re.findall(r"\[WARN\] \S+ \[navigator\]: (.*)", log):
        assert any(row.match(warning) for row in ROWS), warning


@pytest.mark.slow
def test_goals_cancels_and_takeovers_have_one_right_end_each(session) -> None:
    rng = np.random.default_rng(1)
    client, graph = session.client, session.graph
    others = graph.publisher(PoseStamped, "goal_pose")
    for _ in range(2):
        assert client.wait(client.send(drawn(rng))) == ["succeeded"]
    for _ in range(3):
        sent = client.send(drawn(rng))
        graph.spin_for(rng.uniform(0.0, 0.5))
        assert client.wait(sent) == ["canceled" if client.cancel(sent) else "succeeded"]
        session.wait_for_rest()
    for number in range(2):
        first = client.send(pose(2.0 - 4.0 * (number % 2), 0.0))
        # Until then a busy controller may report that there is none.
        graph.until(lambda: session.statuses[-1]["mode"] != "no goal")
        graph.spin_for(rng.uniform(0.0, 0.3))
        seen = len(session.statuses)
        if number % 2:
            others.publish(drawn(rng))
        else:
            assert client.wait(client.send(drawn(rng), drawn(rng))) == ["succeeded"]
        (end,) = client.wait(first)
        arrived = any(values["mode"] == "at the goal" for values in session.statuses[:seen])
        assert end == "aborted" or arrived
        assert all(values["mode"] != "no goal" for values in session.statuses[seen:])
    assert "refused" not in session.log("navigator")


def set_floor(session: Session, corners: str) -> None:
    assert session.graph.set_parameters("controller", floor=corners)[0].successful


@pytest.mark.slow
def test_goal_that_cannot_be_followed_is_rejected_aborted_or_missed(session) -> None:
    client, outside = session.client, pose(100.0, 100.0)
    wrong, elsewhere = pose(1.0, 0.0), pose(1.0, 0.0)
    wrong.pose.position.x = float("nan")
    elsewhere.header.frame_id = "odom"
    for poses, told in (
        ((wrong,), "navigate_to_pose rejected: state: given"),
        ((pose(1.0, 0.0), elsewhere), "navigate_through_poses rejected: frame: given"),
    ):
        assert not client.send(*poses).is_accepted
        assert session.log("navigator").count(told) == 1
    set_floor(session, "[[-3, -3], [3, -3], [3, 3], [-3, 3]]")
    sent = client.send(outside)
    assert client.wait(sent) == ["aborted"]
    told = "the strategy gives up the goal: it is outside of the floor"
    assert sent.reason == f"goal outside: {told}"
    assert sent.result.result().result.error_code == 204
    sent = client.send(pose(0.4, 0.0), outside, pose(0.0, 0.0), name="follow_waypoints")
    assert client.wait(sent) == ["succeeded"]
    result = sent.result.result().result
    (missed,) = result.missed_waypoints
    assert (getattr(missed, navigation_messages.MISSED[0]), missed.error_code) == (1, 204)
    aimed_at = [one.feedback.current_waypoint for one in sent.feedback]
    assert aimed_at == sorted(aimed_at) and {0, 2} <= set(aimed_at) <= {0, 1, 2}
    set_floor(session, "")


@pytest.fixture
def commander(tmp_path) -> Path:
    """Return a folder with nav2_simple_commander: that of Nav2, or what stands in for it."""
    if importlib.util.find_spec("nav2_simple_commander") is None:
        package = tmp_path / "nav2_simple_commander"
        package.mkdir()
        (package / "__init__.py").touch()
        stand_in = ROOT / "test" / "support" / "commander_stand_in.py"
        shutil.copy(stand_in, package / "robot_navigator.py")
    return tmp_path


@pytest.mark.slow
def test_goal_is_reached_after_controller_or_simulator_are_started_again(session) -> None:
    for node, side in (("controller", 2.5), ("simulator", -2.5)):
        sent = session.client.send(pose(side, 0.0))
        session.moves()
        session.restart(node)
        assert session.client.wait(sent) == ["succeeded"]


@pytest.mark.slow
def test_example_runs_as_printed(session, commander) -> None:
    path = os.pathsep.join([str(commander), *filter(None, sys.path)])
    done = subprocess.run(
        [sys.executable, str(ROOT / "examples" / "commander.py")], text=True, check=False,
        capture_output=True, env=os.environ | {"PYTHONPATH": path}, timeout=PATIENCE,
    )
    assert done.returncode == 0, done.stderr
    way, *ends = done.stdout.splitlines()
    assert re.fullmatch(r"the way to the pose was \d\.\d m long", way)
    assert ends == [
        "pose: succeeded", "waypoints: succeeded", "path: succeeded", "far pose: canceled"
    ]


@pytest.mark.slow
def test_killed_navigator_can_be_restarted_while_the_sphere_goes_on(session) -> None:
    navigator, client = session.processes["navigator"], session.client
    client.send(pose(2.0, 0.0))
    session.moves()
    killed = client.navigators()
    navigator.kill()
    session.graph.until(lambda: session.status()["mode"] == "at the goal")
    navigator.start()
    session.graph.until(lambda: client.navigators() - killed)
    # As long as the killed one is known it could be another that lives.
    sent = client.send(pose(0.0, 0.0))
    while not sent.is_accepted:
        told = "rejected: navigators: given /navigator, /navigator"
        assert told in session.log("navigator")
        session.graph.until(lambda: len(client.navigators()) == 1)
        sent = client.send(pose(0.0, 0.0))
    session.moves()
    # Ended by a signal, it does not leave a goal behind.
    session.processes.stop("navigator")
    assert client.wait(sent) == ["aborted"]
    assert sent.reason == "the navigator has ended"
    session.graph.until(lambda: session.status()["mode"] == "no goal")
    session.wait_for_rest()


def test_missing_package_is_told_in_one_line(monkeypatch, tmp_path) -> None:
    folder = str(navigation_messages.built())
    monkeypatch.setattr("sys.path", [entry for entry in sys.path if entry != folder])
    if importlib.machinery.PathFinder.find_spec(navigation_messages.PACKAGE) is not None:
        pytest.skip("nav2_msgs is installed")
    done = subprocess.run(
        verb_command("navigator"), capture_output=True, text=True, check=False, cwd=tmp_path
    )
    assert done.returncode == 1 and not done.stdout
    (line,) = done.stderr.splitlines()
    assert line.endswith("'nav2_msgs' is not installed; apt install ros-jazzy-nav2-msgs")
