# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Commands as ros2_controllers' joint trajectory controller interpolates them."""

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from ros2_control import Interpolation

from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.ros import cdr_messages
from sphere_nmpc.ros.controller.command_sender import CommandSender

SPEEDS = st.tuples(*[st.floats(-100.0, 100.0)] * 2)


@st.composite
def holds(draw, start: float = 0.0) -> FirstOrderHold:
    gaps = draw(st.lists(st.integers(1_000_000, 1_000_000_000), min_size=1, max_size=40))
    speeds = draw(st.lists(SPEEDS, min_size=len(gaps) + 1, max_size=len(gaps) + 1))
    return FirstOrderHold(start + np.cumsum([0, *gaps]) / 1e9, np.array(speeds))


@given(hold=holds(), first=SPEEDS, shares=st.lists(st.floats(0.0, 1.2), min_size=1, max_size=20))
def test_cubics_through_a_trajectory_are_the_first_order_hold(hold, first, shares) -> None:
    followed = Interpolation(cdr_messages.trajectory_message(hold, np.array(first)))
    for share in shares:
        time = share * hold.end
        # The angles are below 4000 rad, in which doubles resolve 5e-13; it is divided by 1e-3 s.
        np.testing.assert_allclose(followed.sample(time)[1], hold.at(time), rtol=0.0, atol=1e-8)


class Node:
    """Node whose publishers keep what is published."""

    def __init__(self) -> None:
        self.published: dict[str, list[bytes]] = {}

    def create_publisher(self, _type: type, topic: str, _depth: int) -> SimpleNamespace:
        return SimpleNamespace(publish=self.published.setdefault(topic, []).append)

    def create_timer(self, _period: float, _callback: object) -> None:
        pass


@given(first=holds(), start=st.floats(0.0, 1.5), second=holds())
def test_angles_go_on_from_those_of_the_command_that_is_replaced(first, start, second) -> None:
    node = Node()
    sender = CommandSender(node, 100.0, lambda: 0.0)
    at = round(start * first.end, 9)
    for hold in (first, second.delayed(at), first.delayed(100.0)):
        sender.send(hold, 0)
    messages = [Interpolation(raw) for raw in node.published["rotor_trajectory"]]
    for replaced, new in pairwise(messages):
        expected, _ = replaced.sample(new.start)
        # As above, and a start that is rounded to nanoseconds.
        np.testing.assert_allclose(new.sample(new.start)[0], expected, rtol=0.0, atol=1e-6)
