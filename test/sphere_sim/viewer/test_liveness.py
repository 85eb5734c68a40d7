# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Alerts about missing poses and a missing controller."""

from sphere_sim.viewer.liveness import Liveness


def test_no_alert_while_both_are_alive() -> None:
    assert Liveness(pose_at=9.9, controller_at=9.4, controllers=1).alerts(10.0) == ()


def test_nodes_without_any_message_are_reported() -> None:
    assert Liveness().alerts(10.0) == ("no pose yet", "no controller yet")


def test_missing_messages_are_reported_with_their_age() -> None:
    liveness = Liveness(pose_at=10.0, controller_at=10.0, controllers=1)
    assert liveness.alerts(10.5) == ()
    assert liveness.alerts(10.7) == ("no pose for 0.7 s",)
    assert liveness.alerts(11.9) == ("no pose for 1.9 s", "controller silent for 1.9 s")


def test_controller_that_left_the_graph_is_reported_sooner() -> None:
    liveness = Liveness(pose_at=10.5, controller_at=10.0, controllers=0)
    assert liveness.alerts(10.7) == ("controller gone",)
