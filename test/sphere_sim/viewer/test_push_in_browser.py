# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Two pushes from the page in real time; the tests depend on their order."""

import math
from collections.abc import Iterator

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("viser")
pytest.importorskip("mujoco")

from browser import find_browser
from geometry_msgs.msg import Vector3Stamped
from plot_lines import line_ends
from session import LATCHED, Session, open_session
from std_msgs.msg import Bool

from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.ros.messages import stamp_from_ros
from sphere_sim.viewer import colours

BROWSER = find_browser()
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(BROWSER is None, reason="no Chromium here: apt-get install chromium"),
]
SIMULATOR = (
    "-p", "initial_state:=[0.6, -0.4, 1.0, 0.0, 0.0, 0.0]", "-p", "plant:=rigid_body",
)
TOLERANCE = 1e-2
"""Error from the goal within which the sphere is back; the controller's `goal_tolerance`."""
PLOT = "momentum about the contact point, world [N m s]"
PUSHES = ((0.6, 30.0), (1.0, 210.0))
"""Impulses [N s] and directions [degrees]; the second one reverses the momentum."""


class Pushed:
    """Session with the pushes that the simulator has confirmed.

    Parameters
    ----------
    session : Session
        Nodes and page.
    """

    def __init__(self, session: Session) -> None:
        self.session = session
        self._at_goal = session.graph.collect(Bool, "controller/at_goal", LATCHED)
        self._confirmed = session.graph.collect(Vector3Stamped, "simulator/pushed")
        self.momentum = np.zeros(2)
        """Momentum that the pushes have caused [N m s; world frame]."""

    def wait_at_goal(self) -> None:
        """Wait until status and pose agree that the sphere is at the goal."""
        self.session.graph.until(
            lambda: self._at_goal and self._at_goal[-1].data and self.session.error < TOLERANCE
        )

    def push(self, impulse: float, direction: float) -> float:
        """Push by the page [N s; degrees]; return the time until the sphere is back [s]."""
        session, count = self.session, len(self._confirmed)
        session.page.type_number("impulse [N s]", str(impulse))
        session.page.type_number("direction [°]", str(direction))
        session.page.click_button("Push")
        session.graph.until(lambda: len(self._confirmed) > count)
        pushed = self._confirmed[-1]
        angle = math.radians(direction)
        wanted = impulse * np.array([math.cos(angle), math.sin(angle)])
        given = np.array([pushed.vector.x, pushed.vector.y])
        np.testing.assert_allclose(given, wanted, atol=1e-9)
        self.momentum += RobotParameters().shell_radius * np.array([-given[1], given[0]])
        session.graph.until(lambda: not self._at_goal[-1].data)
        self.wait_at_goal()
        return 1e-9 * (session.time - stamp_from_ros(pushed.header.stamp))


@pytest.fixture(scope="module")
def pushed(tmp_path_factory) -> Iterator[Pushed]:
    with open_session(BROWSER, tmp_path_factory.mktemp("session"), SIMULATOR) as session:
        yield Pushed(session)


def test_sphere_rolls_to_an_upright_goal(pushed) -> None:
    pushed.session.page.wait_for("live")
    pushed.session.page.choose("pick a goal …", "origin, upright")
    pushed.session.graph.until(lambda: pushed.session.goals)
    pushed.wait_at_goal()


@pytest.mark.parametrize(("impulse", "direction"), PUSHES)
def test_pushed_sphere_returns_and_the_plot_has_its_momentum(pushed, impulse, direction) -> None:
    session = pushed.session
    took = pushed.push(impulse, direction)
    print(f"{impulse} N s at {direction} degrees: back after {took:.2f} s")
    session.page.wait_for(PLOT)
    reported = [float(session.status[f"momentum_{axis}"]) for axis in "xy"]
    # The constants are learnt from this very motion, as in ros/test_push.py.
    np.testing.assert_allclose(reported, pushed.momentum, atol=0.01)

    def is_drawn() -> bool:
        """Return whether the newest x and y are on their sides of zero."""
        ends = line_ends(session.page, PLOT, (colours.BLUE, colours.VERMILION, colours.INK))
        return ends is not None and np.array_equal(
            np.sign(ends[2] - ends[:2]), np.sign(pushed.momentum)
        )

    session.graph.until(is_drawn)


def test_page_has_logged_no_error(pushed) -> None:
    assert pushed.session.page.console == []
