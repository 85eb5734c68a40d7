# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Push and tilt of the fault campaign on a simulator: they leave momentum until it is cleared."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import Vector3
from rclpy.parameter import Parameter

from sphere_nmpc.model.drift import momentum_of_push
from sphere_nmpc.model.parameters import RobotParameters
from sphere_sim.faults.catalogue import FAULTS
from sphere_sim.ros.faults.actions import action_of
from sphere_sim.ros.simulator.node import SimulatorNode

ROBOT = RobotParameters()


class Session:
    """What the actions need of a `FaultSession`, with the simulator in this process."""

    def __init__(self, graph) -> None:
        self._graph = graph
        self.node = SimulatorNode([Parameter("real_time_factor", value=5.0)])
        graph.add(self.node)
        self._pushes = graph.publisher(Vector3, "simulator/push")
        self.rng = np.random.default_rng(8)
        self.pushed = 0

    @property
    def momentum(self) -> np.ndarray:
        """Momentum of the sphere [N m s; world]."""
        return self.node.simulator.plant.momentum

    @property
    def monitor(self) -> SimpleNamespace:
        return SimpleNamespace(time=self.node.simulator.time)

    def push(self, impulse: np.ndarray) -> None:
        before = self.momentum
        self._pushes.publish(Vector3(x=float(impulse[0]), y=float(impulse[1])))
        self._graph.until(lambda: np.any(self.momentum != before))

    def set_parameters(self, node: str, **values: Any) -> list[Any]:
        assert node == "simulator"
        return self.node.set_parameters([Parameter(k, value=v) for k, v in values.items()])

    def pass_time(self, duration: float) -> None:
        end = self.node.simulator.time + duration
        self._graph.until(lambda: self.node.simulator.time >= end)


@pytest.mark.parametrize(
    ("name", "impulse"),
    # Half a second on 0.2 degrees, as long as a push of that impulse.
    [("push", 0.5), ("tilt", ROBOT.total_mass * 9.81 * np.sin(np.radians(0.2)) * 0.5)],
)
def test_momentum_stays_after_the_fault_and_is_cleared_after_the_recovery(
    graph, name, impulse
) -> None:
    session: Any = Session(graph)
    action = action_of(FAULTS[name])
    action.begin(session)
    session.pass_time(0.5)
    action.end(session)
    left = session.momentum
    expected = ROBOT.rotor_axial_inertia * np.linalg.norm(momentum_of_push(ROBOT, (impulse, 0.0)))
    # The floor is tilted for up to an interval of 10 ms, or the pace of a busy machine, longer.
    assert np.linalg.norm(left) >= 0.99 * expected
    session.pass_time(0.5)
    np.testing.assert_allclose(session.momentum, left, rtol=1e-6)
    action.clear(session)
    assert np.linalg.norm(session.momentum) < 0.02 * np.linalg.norm(left)
