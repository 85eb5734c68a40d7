# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Unusable ROS environments end a node with one line; a missing log file does not end it."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from geometry_msgs.msg import PoseStamped
from other_user import as_user
from patience import PATIENCE
from rclpy.qos import DurabilityPolicy, QoSProfile
from ros_graph import Graph

from sphere_nmpc.errors import SphereNmpcError
from sphere_nmpc.ros.environment import (
    RosEnvironmentError,
    check_environment,
    check_middleware,
    domain_id,
    unwritable_log_folder,
)
from sphere_nmpc.ros.loopback import network_reach
from sphere_nmpc.ros.messages import pose_to_ros
from sphere_nmpc.ros.shared_memory import avoid_foreign_shared_memory
from sphere_sim.scenario.scenarios import PAPER_CASES

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
NOWHERE = "/proc/nonexistent"
"""Folder that not even root can create."""
COMPILER = Path(__file__).parents[1] / "solver" / "quick_cc.sh"
"""One that does not optimise, for nodes that build the solver."""
CONTROLLER = "import sys; from sphere_nmpc.ros.controller.node import main; sys.exit(main())"


def controller(
    environment: dict[str, str | None], within: tuple[str, ...] = ()
) -> subprocess.Popen:
    whole = os.environ | {"PYTHONUNBUFFERED": "1", "CC": str(COMPILER)} | environment
    return subprocess.Popen(
        [*within, sys.executable, "-c", CONTROLLER],
        env={name: value for name, value in whole.items() if value is not None},
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
    )


def lines_until_up(node: subprocess.Popen) -> list[str]:
    """Return the log up to the line with the network reach, then stop the node."""
    lines = []
    try:
        for line in node.stderr:
            lines.append(line)
            if "reachable" in line:
                break
        node.send_signal(signal.SIGINT)
        assert node.wait(PATIENCE) == 0, lines
    finally:
        node.kill()
        node.wait()
    return lines


@pytest.mark.parametrize("given", ["abc", "500", "233", "-3", "010", "1.5", " 7", "0x10", "٣"])
def test_invalid_domain_id_is_refused(given) -> None:
    with pytest.raises(RosEnvironmentError, match=r"ROS_DOMAIN_ID: given .* from 0 to 232"):
        domain_id({"ROS_DOMAIN_ID": given})


@pytest.mark.parametrize(("given", "domain"), [("0", 0), ("42", 42), ("232", 232), ("", None)])
def test_valid_domain_id_is_read(given, domain) -> None:
    assert domain_id({"ROS_DOMAIN_ID": given}) == domain


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
def test_error_names_the_variable_and_the_expected_value(
    name, given, expected
) -> None:
    with pytest.raises(SphereNmpcError, match=f"{name}: given .*, expected {expected}") as found:
        check_environment({name: given})
    assert found.value.exit_code == 2


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


@pytest.mark.parametrize(
    ("environment", "message"),
    [
        ({"ROS_DOMAIN_ID": "500"}, "ROS_DOMAIN_ID: given '500', expected"),
        ({"FASTRTPS_DEFAULT_PROFILES_FILE": "/absent.xml"}, "PROFILES_FILE: given '/absent.xml'"),
        ({"ROS_LOG_DIR": NOWHERE}, "ROS_LOG_DIR: given"),
    ],
)
def test_node_ends_with_code_2_and_one_line(environment, message) -> None:
    node = controller(environment)
    _, errors = node.communicate(timeout=PATIENCE)
    assert node.returncode == 2
    assert len(errors.strip().splitlines()) == 1 and message in errors


@pytest.mark.parametrize("home", [NOWHERE, None], ids=["unwritable", "unset"])
def test_node_without_home_folder_starts_with_one_message(home, tmp_path) -> None:
    lines = lines_until_up(
        controller({"HOME": home, "ROS_LOG_DIR": None, "SPHERE_NMPC_CACHE": str(tmp_path)})
    )
    assert sum("log file: given" in line for line in lines) == 1, lines


def segment(folder: Path, port: int) -> None:
    (folder / f"fastrtps_port{port}").touch()


def test_own_shared_memory_is_used(tmp_path) -> None:
    segment(tmp_path, 7400 + 250 * 42 + 11)
    environment = {"ROS_DOMAIN_ID": "42"}
    assert not avoid_foreign_shared_memory(environment, tmp_path)
    assert environment == {"ROS_DOMAIN_ID": "42"}
    assert not avoid_foreign_shared_memory(environment, tmp_path / "absent")


@pytest.mark.skipif(os.geteuid() != 0, reason="needs root, to make files of another user")
def test_shared_memory_of_other_users_selects_udp(tmp_path) -> None:
    segment(tmp_path, 7400 + 250 * 42 + 11)
    os.chown(next(tmp_path.iterdir()), 65534, 65534)
    environment = {"ROS_DOMAIN_ID": "42"}
    assert "uid 65534" in avoid_foreign_shared_memory(environment, tmp_path)
    assert environment["FASTDDS_BUILTIN_TRANSPORTS"] == "UDPv4"
    here = {"ROS_DOMAIN_ID": "42", "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    assert "the loopback alone" in avoid_foreign_shared_memory(here, tmp_path)
    assert "over the loopback" in network_reach(here)
    chosen = {"ROS_DOMAIN_ID": "42", "FASTDDS_BUILTIN_TRANSPORTS": "DEFAULT"}
    for unchanged in ({"ROS_DOMAIN_ID": "43"}, {}, chosen):
        before = dict(unchanged)
        assert not avoid_foreign_shared_memory(unchanged, tmp_path)
        assert unchanged == before


@pytest.mark.slow
@pytest.mark.parametrize("reach", ["LOCALHOST", "SUBNET"])
def test_nodes_of_two_users_exchange_messages(monkeypatch, tmp_path, reach) -> None:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", reach)
    graph, lines = Graph(), []
    environment = {"ROS_LOG_DIR": None, "HOME": NOWHERE, "SPHERE_NMPC_CACHE": str(tmp_path)}
    node = controller(environment, as_user(65534))
    try:
        while not lines or "reachable" not in lines[-1]:  # the solver may have to be built first
            lines.append(node.stderr.readline())
        confirmed = graph.collect(PoseStamped, "controller/active_goal", LATCHED)
        goals = graph.publisher(PoseStamped, "goal_pose")
        goals.publish(pose_to_ros(PAPER_CASES[1].goal, 0, 0.3))
        graph.until(lambda: confirmed)
    finally:
        graph.close()
        node.terminate()
        lines.append(node.communicate(timeout=PATIENCE)[1])
    assert node.returncode == 0
    assert sum("shared memory: given" in line for line in lines) == 1


@pytest.mark.slow
@pytest.mark.parametrize("user", [65534, 54321], ids=["nobody", "without a passwd entry"])
def test_node_of_another_user_starts_after_one_of_root(user, tmp_path) -> None:
    cache = tmp_path / "roots"
    lines_until_up(controller({"SPHERE_NMPC_CACHE": str(cache)}))
    environment = {"SPHERE_NMPC_CACHE": str(cache), "ROS_LOG_DIR": None, "HOME": None}
    lines = lines_until_up(controller(environment, as_user(user)))
    assert not any("Traceback" in line for line in lines)
    assert sum("log file: given ~/.ros/log" in line or "log file: given /nonexistent" in line
               for line in lines) == 1, lines
