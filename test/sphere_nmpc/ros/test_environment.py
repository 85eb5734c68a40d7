# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""An environment that ROS cannot use is told in one line; a log file is not worth a refusal."""

import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from geometry_msgs.msg import PoseStamped
from rclpy.qos import DurabilityPolicy, QoSProfile
from ros_graph import Graph

from sphere_nmpc.errors import SphereNmpcError
from sphere_nmpc.ros.conversions import pose_to_ros
from sphere_nmpc.ros.environment import (
    RosEnvironmentError,
    check_environment,
    check_middleware,
    domain_of,
    missing_log_folder,
)
from sphere_nmpc.ros.loopback import audience
from sphere_nmpc.ros.shared_memory import TRANSPORTS, leave_to_others
from sphere_sim.scenario.scenarios import PAPER_CASES

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
NOWHERE = "/proc/nonexistent"
"""A folder that nobody can make, root neither."""
CONTROLLER = "import sys; from sphere_nmpc.ros.controller.node import main; sys.exit(main())"
PATIENCE = 60.0


def controller(
    environment: dict[str, str | None], within: tuple[str, ...] = ()
) -> subprocess.Popen:
    whole = os.environ | {"PYTHONUNBUFFERED": "1"} | environment
    return subprocess.Popen(
        [*within, sys.executable, "-c", CONTROLLER],
        env={name: value for name, value in whole.items() if value is not None},
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
    )


def lines_until_up(node: subprocess.Popen) -> list[str]:
    """Return what a node tells until it says who can hear it, and end it."""
    told = []
    try:
        for line in node.stderr:
            told.append(line)
            if "heard" in line:
                break
        node.send_signal(signal.SIGINT)
        assert node.wait(PATIENCE) == 0, told
    finally:
        node.kill()
        node.wait()
    return told


@pytest.mark.parametrize("given", ["abc", "500", "233", "-3", "010", "1.5", " 7", "0x10", "٣"])
def test_what_is_no_domain_is_refused(given) -> None:
    with pytest.raises(RosEnvironmentError, match=r"ROS_DOMAIN_ID: given .* from 0 to 232"):
        domain_of({"ROS_DOMAIN_ID": given})


@pytest.mark.parametrize(("given", "domain"), [("0", 0), ("42", 42), ("232", 232), ("", None)])
def test_a_domain_is_taken_as_it_is_written(given, domain) -> None:
    assert domain_of({"ROS_DOMAIN_ID": given}) == domain


@pytest.mark.parametrize(
    ("name", "given", "expected"),
    [
        ("FASTRTPS_DEFAULT_PROFILES_FILE", "/absent.xml", "a file that can be read"),
        ("FASTRTPS_DEFAULT_PROFILES_FILE", __file__, "XML"),
        ("ROS_STATIC_PEERS", "no/name", "names or addresses"),
        ("ROS_LOG_DIR", NOWHERE, "a folder"),
        ("ROS_LOG_DIR", "/dev/full", "a folder"),
    ],
)
def test_a_variable_that_cannot_be_used_is_named_with_what_was_expected(
    name, given, expected
) -> None:
    with pytest.raises(SphereNmpcError, match=f"{name}: given .*, expected {expected}") as found:
        check_environment({name: given})
    assert found.value.exit_code == 2


def test_only_an_installed_middleware_is_taken() -> None:
    with pytest.raises(RosEnvironmentError, match=r"given 'nonesuch', expected .*rmw_"):
        check_middleware({"RMW_IMPLEMENTATION": "nonesuch"})
    check_middleware({"RMW_IMPLEMENTATION": "rmw_fastrtps_cpp"})
    check_middleware({})


def test_a_log_folder_is_looked_for_where_ros_does(tmp_path) -> None:
    assert missing_log_folder({"ROS_HOME": str(tmp_path / "new")}) is None
    assert (tmp_path / "new" / "log").is_dir()
    assert missing_log_folder({"ROS_HOME": NOWHERE}) == Path(NOWHERE) / "log"
    assert missing_log_folder({"ROS_LOG_DIR": NOWHERE}) is None, "that is told otherwise"


@pytest.mark.parametrize(
    ("environment", "told"),
    [
        ({"ROS_DOMAIN_ID": "500"}, "ROS_DOMAIN_ID: given '500', expected"),
        ({"FASTRTPS_DEFAULT_PROFILES_FILE": "/absent.xml"}, "PROFILES_FILE: given '/absent.xml'"),
        ({"ROS_LOG_DIR": NOWHERE}, "ROS_LOG_DIR: given"),
    ],
)
def test_a_node_ends_with_one_line_about_it(environment, told) -> None:
    node = controller(environment)
    _, errors = node.communicate(timeout=PATIENCE)
    assert node.returncode == 2
    assert len(errors.strip().splitlines()) == 1 and told in errors


@pytest.mark.parametrize("home", [NOWHERE, None], ids=["unwritable", "unset"])
def test_a_node_without_a_home_says_so_once_and_starts(home, tmp_path) -> None:
    told = lines_until_up(
        controller({"HOME": home, "ROS_LOG_DIR": None, "SPHERE_NMPC_CACHE": str(tmp_path)})
    )
    assert sum("log file: given" in line for line in told) == 1, told


def segment(folder: Path, port: int) -> None:
    (folder / f"fastrtps_port{port}").touch()


def test_one_s_own_shared_memory_is_used(tmp_path) -> None:
    segment(tmp_path, 7400 + 250 * 42 + 11)
    environment = {"ROS_DOMAIN_ID": "42"}
    assert not leave_to_others(environment, tmp_path)
    assert environment == {"ROS_DOMAIN_ID": "42"}
    assert not leave_to_others(environment, tmp_path / "absent")


@pytest.mark.skipif(os.geteuid() != 0, reason="needs root, to make files of another user")
def test_shared_memory_of_others_in_the_domain_is_left_to_them(tmp_path) -> None:
    segment(tmp_path, 7400 + 250 * 42 + 11)
    os.chown(next(tmp_path.iterdir()), 65534, 65534)
    environment = {"ROS_DOMAIN_ID": "42"}
    assert "uid 65534" in leave_to_others(environment, tmp_path)
    assert environment["FASTDDS_BUILTIN_TRANSPORTS"] == "UDPv4"
    here = {"ROS_DOMAIN_ID": "42", "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    assert "the loopback alone" in leave_to_others(here, tmp_path)
    assert "over the loopback" in audience(here)
    for wish in ({"ROS_DOMAIN_ID": "43"}, {}, {"ROS_DOMAIN_ID": "42", TRANSPORTS: "DEFAULT"}):
        before = dict(wish)
        assert not leave_to_others(wish, tmp_path)
        assert wish == before


def another_user(user: str) -> tuple[str, ...]:
    # Reading everywhere is left to them: this interpreter may lie in root's home.
    reading = "+dac_read_search"
    return ("setpriv", f"--reuid={user}", f"--regid={user}", "--clear-groups",
            f"--inh-caps={reading}", f"--ambient-caps={reading}")


@pytest.mark.slow
@pytest.mark.skipif(os.geteuid() != 0, reason="needs root, to become another user")
@pytest.mark.skipif(shutil.which("setpriv") is None, reason="needs setpriv, of util-linux")
@pytest.mark.parametrize("reach", ["LOCALHOST", "SUBNET"])
def test_nodes_of_two_users_hear_each_other(monkeypatch, tmp_path, reach) -> None:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", reach)
    graph, told = Graph(), []
    environment = {"ROS_LOG_DIR": None, "HOME": NOWHERE, "SPHERE_NMPC_CACHE": str(tmp_path)}
    node = controller(environment, another_user("65534"))
    try:
        while not told or "heard" not in told[-1]:  # it may have to build its solver first
            told.append(node.stderr.readline())
        confirmed = graph.hear(PoseStamped, "controller/active_goal", LATCHED)
        goals = graph.speaker(PoseStamped, "goal_pose")
        goals.publish(pose_to_ros(PAPER_CASES[1].goal, 0, 0.3))
        graph.until(lambda: confirmed)
    finally:
        graph.close()
        node.terminate()
        told.append(node.communicate(timeout=PATIENCE)[1])
    assert node.returncode == 0
    assert sum("shared memory: given" in line for line in told) == 1


@pytest.mark.slow
@pytest.mark.skipif(os.geteuid() != 0, reason="needs root, to become another user")
@pytest.mark.skipif(shutil.which("setpriv") is None, reason="needs setpriv, of util-linux")
@pytest.mark.parametrize("user", ["65534", "54321"], ids=["nobody", "without a passwd entry"])
def test_a_node_starts_for_another_user_after_root(user, tmp_path) -> None:
    cache = tmp_path / "roots"
    lines_until_up(controller({"SPHERE_NMPC_CACHE": str(cache)}))
    environment = {"SPHERE_NMPC_CACHE": str(cache), "ROS_LOG_DIR": None, "HOME": None}
    told = lines_until_up(controller(environment, another_user(user)))
    assert not any("Traceback" in line for line in told)
    assert sum("log file: given ~/.ros/log" in line or "log file: given /nonexistent" in line
               for line in told) == 1, told
