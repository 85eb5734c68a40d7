# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Log lines of the faults around a node: one when a fault begins, with names that are known."""

import pytest
from patience import PATIENCE

from sphere_nmpc.fault_log import FaultLog
from sphere_nmpc.ros import graph_monitor
from sphere_nmpc.ros.graph_faults import GraphFault
from sphere_nmpc.ros.graph_monitor import UNKNOWN, GraphMonitor

NAMELESS = GraphFault("other publisher of /pose", f"given 2 (/simulator, {UNKNOWN})")
NAMED = GraphFault("other publisher of /pose", "given 2 (/simulator, /simulator)")


@pytest.mark.parametrize(
    ("limit", "seen", "logged"),
    [
        (PATIENCE, [NAMELESS, NAMELESS, NAMED, NAMED], [NAMED]),
        (PATIENCE, [NAMED, NAMELESS, NAMED], [NAMED]),
        (-1.0, [NAMELESS, NAMELESS], [NAMELESS]),
    ],
    ids=["named soon", "named at once", "never named"],
)
def test_fault_is_logged_once_when_the_name_of_the_node_is_known(
    graph, monkeypatch, limit, seen, logged
) -> None:
    monkeypatch.setattr(graph_monitor, "NAMED_WITHIN", limit)
    lines: list[str] = []
    monitor = GraphMonitor(graph.probe, FaultLog(lines.append))
    for fault in seen:
        monitor.update([fault])
        assert monitor.faults[0] == fault, "the status has it at once"
    assert lines == [f"{fault.kind}: {fault.message}" for fault in logged]
