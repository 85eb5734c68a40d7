# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The transform is published where its message exists; a stand-in takes that place here."""

from geometry_msgs.msg import TransformStamped

from sphere_nmpc.model.parameters import RobotParameters
from sphere_sim.ros.simulator import state_publisher
from sphere_sim.ros.simulator.state_publisher import StatePublisher
from sphere_sim.world.settings import SimulatorSettings
from sphere_sim.world.simulator import Simulator


def test_transform_is_published_if_there_is_a_subscriber(graph, monkeypatch) -> None:
    # A TFMessage cannot be had from the wheels; a message that wraps nothing can be sent instead.
    class StandIn(TransformStamped):
        def __init__(self, transforms=()) -> None:
            super().__init__()
            if transforms:
                self.header, self.child_frame_id = transforms[0].header, "base_link"

    monkeypatch.setattr(state_publisher, "TFMessage", StandIn)
    publisher = StatePublisher(graph.probe, 0.3)
    received = graph.collect(TransformStamped, "/tf")
    graph.until(lambda: publisher._transforms.get_subscription_count() > 0)
    publisher.publish(Simulator(SimulatorSettings(), RobotParameters()))
    graph.until(lambda: received)
    assert (received[0].header.frame_id, received[0].child_frame_id) == ("world", "base_link")
