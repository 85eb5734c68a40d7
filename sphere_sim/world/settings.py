# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Settings of the simulator, and the table of plants."""

from dataclasses import dataclass

from sphere_nmpc.foreign.entry_table import Entry, EntryTable
from sphere_nmpc.model.state import DEFAULT_START
from sphere_nmpc.quantities import quantity, validate

PLANTS = EntryTable(
    "plant", "sphere_nmpc.plants", "sphere_sim.world.plant.contract:Plant",
    {
        "rolling": Entry("sphere_sim.world.plant.rolling_plant:RollingPlant"),
        "rigid_body": Entry("sphere_sim.world.plant.rigid_body.rigid_body_plant:RigidBodyPlant"),
    },
    Entry,
)
"""All plants by name, which are the choices of the parameter ``plant``."""


POSE_SOURCES = ("sensor", "odometry")
"""Where poses come from."""


@dataclass(frozen=True)
class SimulatorSettings:
    """Settings of the simulator: plant, start, drives, noise and pose sensor."""

    plant: str = quantity(
        "rolling", "-", "What is simulated: ideal rolling, or bodies with contact and drives",
        choices=PLANTS.keys(),
    )
    initial_state: tuple[float, ...] = quantity(
        DEFAULT_START, "m, -",
        "Start at rest: x, y, then the quaternion w, x, y, z", minimum=-1e6, maximum=1e6,
    )
    pose_source: str = quantity(
        "sensor", "-",
        "Who publishes pose, odom and the transform: the simulator's sensor, or an odometry node",
        choices=POSE_SOURCES,
    )
    pose_rate: float = quantity(
        100.0, "Hz", "Rate of pose, odometry and joint states", minimum=1.0, maximum=2000.0
    )
    command_timeout: float = quantity(
        0.5, "s", "Time after which rotor_commands that are not renewed are no longer followed",
        minimum=1e-3, maximum=60.0,
    )
    noise_period: float = quantity(
        0.5, "s", "Spacing of the process noise: the paper's T", minimum=1e-3, maximum=10.0
    )
    process_noise: float = quantity(
        0.0, "m, -", "Standard deviation added to each state every noise period (Eq. 43)",
        minimum=0.0, maximum=1.0, live=True,
    )
    position_noise: float = quantity(
        0.0, "m", "Standard deviation of the published position", minimum=0.0, maximum=1.0,
        live=True,
    )
    orientation_noise: float = quantity(
        0.0, "rad", "Standard deviation of the published orientation about each axis", minimum=0.0,
        maximum=1.0, live=True,
    )
    sensor_rate: float = quantity(
        0.0, "Hz", "Sampling rate of the pose sensor; 0 is at pose_rate", minimum=0.0,
        maximum=2000.0,
    )
    sensor_latency: float = quantity(
        0.0, "s", "Delay of poses; their stamp is the time of measurement", minimum=0.0,
        maximum=10.0, live=True,
    )
    sensor_dropout: float = quantity(
        0.0, "-", "Share of poses that are lost", minimum=0.0, maximum=1.0, live=True
    )
    seed: int = quantity(0, "-", "Seed of all noise", minimum=0, maximum=2**31 - 1)

    def __post_init__(self) -> None:
        validate(self)

    @property
    def has_odometry(self) -> bool:
        """Whether poses come from an odometry node, which needs the IMU."""
        return self.pose_source == "odometry"

    @property
    def is_sensor_plain(self) -> bool:
        """Whether there is a pose, without delay, at each published instant."""
        return not (self.sensor_rate or self.sensor_latency or self.sensor_dropout)
