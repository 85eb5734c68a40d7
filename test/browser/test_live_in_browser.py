# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Viewer in a real browser, with real nodes over DDS."""

import math
import re

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("viser")

from browser import colour, pixel, scene_of
from geometry_msgs.msg import PoseStamped, Vector3Stamped
from rclpy.qos import DurabilityPolicy, QoSProfile
from verb_process import page_of, start

from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.process.child import stop_together
from sphere_nmpc.ros.messages import pose_from_ros

SIMULATOR = ("-p", "initial_state:=[0.0, 0.0, 1.0, 0.0, 0.0, 0.0]")
CONTROLLER = ("-p", "use_sim_time:=true", "-p", "goal_memory:=0.0")
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
RADIUS = RobotParameters().shell_radius
OWN = re.compile(r"http://127\.0\.0\.1|data:|blob:|about:")


@pytest.mark.slow
def test_page_shows_the_robot_and_its_requests_reach_the_nodes(graph, page, tmp_path) -> None:
    goals = graph.collect(PoseStamped, "controller/active_goal", LATCHED)
    pushes = graph.collect(Vector3Stamped, "simulator/pushed")
    simulator, _, viewer = nodes = [
        start(tmp_path, "simulator", "--ros-args", *SIMULATOR),
        start(tmp_path, "controller", "--ros-args", *CONTROLLER),
        start(tmp_path, "viewer", "--port", "0"),
    ]

    def is_red(point: tuple[float, float, float]) -> bool:
        red, green, _ = colour(page, point)
        return bool(red - green > 100.0)

    try:
        graph.until(lambda: page_of(viewer))
        page.open(page_of(viewer))
        page.wait_for("live")
        page.settle()

        # Drag the arrow along x, which is red, by one metre.
        before = scene_of(page)
        grab, release = ((x, 0.0, RADIUS) for x in (0.5, 1.5))
        page.wait(lambda: is_red(grab), "no arrow is drawn there")
        page.drag(pixel(page, grab), pixel(page, release))
        graph.until(lambda: goals)
        goal = pose_from_ros(goals[-1])
        assert goal[0] == pytest.approx(1.0, abs=0.3) and abs(goal[1]) < 1e-3
        assert abs(goal[2]) == pytest.approx(1.0, abs=1e-3)
        page.wait(lambda: np.mean(np.abs(scene_of(page) - before)) > 1.0)
        page.click_button("Cancel")
        page.wait_for("no goal")

        page.type_number("impulse [N s]", "0.6")
        page.type_number("direction [°]", "30")
        page.click_button("Push")
        graph.until(lambda: pushes)
        pushed = pushes[-1].vector
        assert (pushed.x, pushed.y) == pytest.approx((0.3 * math.sqrt(3.0), 0.3))
        page.wait_for("momentum about the contact point, world [N m s]")  # it is plotted

        page.click_button("Pause")
        page.wait_for("paused")
        page.evaluate("document.body.append('stale')")
        page.call("Page.reload")
        page.wait(lambda: "stale" not in page.text and "paused" in page.text)
        page.click_button("Resume")
        page.wait_for("live")
        simulator.kill()
        page.wait_for("no pose for")
        assert page.console == []
        assert [url for url in page.requested if not OWN.match(url)] == []
    finally:
        stop_together(nodes)
        for log in sorted(tmp_path.glob("*.log")):  # shown where a test failed
            print(f"{log.name}:\n{log.read_text(errors='replace')[-3000:]}")
