# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Settings of the simulator and of pushes."""

from dataclasses import dataclass

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.quantity import quantity, validate

PLANTS = ("rolling", "rigid_body")
"""Plants that can be chosen by name."""
CLOCKS = ("simulated", "system")
"""Clocks that the simulation can run on."""


@dataclass(frozen=True)
class SimulatorSettings:
    """Settings of the simulator: plant, start, clock, noise and pose sensor.

    Raises
    ------
    InvalidParameterError
        If a value is not in its range.
    """

    plant: str = quantity(
        "rolling", "-", "What is simulated: ideal rolling, or bodies with contact and drives",
        choices=PLANTS,
    )
    initial_state: tuple[float, ...] = quantity(
        (2.0, -3.0, 0.03, 0.454, 0.88, 0.1363), "m, -",
        "Start at rest: x, y, then the quaternion w, x, y, z", minimum=-1e6, maximum=1e6,
    )
    clock: str = quantity(
        "simulated", "-",
        "Simulated time, published on /clock, or the system clock, as on a real robot",
        choices=CLOCKS,
    )
    frame_prefix: str = quantity(
        "", "-", "Prefix of base_link in frame names; if empty, the node's namespace"
    )
    real_time_factor: float = quantity(
        1.0, "-", "Simulated over wall time; 0 is as fast as possible", minimum=0.0,
        maximum=1000.0, live=True,
    )
    lockstep: bool = quantity(
        False, "-",
        "Stop the clock at each sampling instant until the rotor command for it has arrived",
    )
    lockstep_timeout: float = quantity(
        5.0, "s", "Wall time after which waiting in lockstep ends with a warning", minimum=0.01,
        maximum=3600.0,
    )
    sample_period: float = quantity(
        0.25,
        "s",
        "Time that ~/step advances; spacing of the sampling instants in lockstep, until a "
        "controller tells its own on control_period",
        minimum=1e-3,
        maximum=100.0,
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
    start_paused: bool = quantity(False, "-", "Start paused, until the pause service is called")

    def __post_init__(self) -> None:
        validate(self)
        if self.is_on_system_clock:
            for name, expected in (
                ("real_time_factor", 1.0), ("lockstep", False), ("start_paused", False)
            ):
                if getattr(self, name) != expected:
                    raise InvalidParameterError(
                        name, getattr(self, name), f"{expected} with clock: system, which "
                        "cannot be stopped or accelerated"
                    )
        if self.lockstep and not self.is_sensor_plain:
            raise InvalidParameterError(
                "lockstep", True, "false where sensor_rate, sensor_latency or sensor_dropout is "
                "not 0: the command for a sampling instant would never arrive",
            )

    @property
    def is_on_system_clock(self) -> bool:
        """Whether time is that of the system clock."""
        return self.clock == "system"

    @property
    def is_sensor_plain(self) -> bool:
        """Whether there is a pose, without delay, at each published instant."""
        return not (self.sensor_rate or self.sensor_latency or self.sensor_dropout)


@dataclass(frozen=True)
class PushSettings:
    """Settings of pushes, for plants that can be pushed.

    Raises
    ------
    InvalidParameterError
        If a value is not in its range.
    """

    push_impulse: tuple[float, ...] = quantity(
        (0.5, 0.0), "N s", "Impulse of a push at the centre of the sphere: x, y in the world",
        minimum=-1e3, maximum=1e3, live=True,
    )

    def __post_init__(self) -> None:
        validate(self)
