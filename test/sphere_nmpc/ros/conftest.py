# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""A graph of nodes for each test that asks for one."""

from collections.abc import Iterator

import pytest

pytest.importorskip("rclpy")

from ros_graph import Graph


@pytest.fixture
def graph() -> Iterator[Graph]:
    graph = Graph()
    yield graph
    graph.close()
