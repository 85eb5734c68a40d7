# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The graph of the tests serves each of its nodes, however much another one has to do."""

import pytest

pytest.importorskip("rclpy")

from rclpy.executors import Executor
from rclpy.node import Node

from sphere_nmpc.ros.lifetime import RunnableNode


class Busy(RunnableNode):
    """Node whose timer is always due, and that waits for a different time each time."""

    def __init__(self) -> None:
        super().__init__("busy")
        self.create_timer(1e-9, lambda: None)
        self._wait = 1.0

    def work(self, executor: Executor) -> None:
        self._wait += 1.0
        executor.spin_once(timeout_sec=self._wait)


def test_node_beside_a_busy_one_is_served(graph) -> None:
    graph.add(Busy())
    late, served = Node("late"), []
    late.create_timer(1e-9, lambda: served.append(True))
    graph.add(late)
    for _ in range(20):
        graph.spin()
    assert len(served) >= 10
