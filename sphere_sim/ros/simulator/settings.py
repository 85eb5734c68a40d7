# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Settings of the simulator node: those of the simulator, its clock, its frames and pushes."""

from dataclasses import dataclass

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.quantities import quantity, validate
from sphere_sim.world.settings import SimulatorSettings

CLOCKS = ("simulated", "system")
"""Clocks that the simulation can run on."""


@dataclass(frozen=True)
class SimulatorNodeSettings(SimulatorSettings):
    """Settings of the simulator, and of the clock and the frames of its node."""

    clock: str = quantity(
        "simulated", "-",
        "Simulated time, published on /clock, or the system clock, as on a real robot",
        choices=CLOCKS,
    )
    frame_prefix: str = quantity(
        "", "-",
        "Prefix of base_link and imu in frame names; if empty, the node's namespace",
    )
    real_time_factor: float = quantity(
        1.0, "-", "Simulated over wall time; 0 is as fast as possible",
        minimum=0.0, maximum=1000.0, live=True,
    )
    lockstep: bool = quantity(
        False, "-",
        "Stop the clock at each sampling instant until the rotor command for it has arrived",
    )
    lockstep_timeout: float = quantity(
        5.0, "s", "Wall time after which waiting in lockstep ends with a warning",
        minimum=0.01, maximum=3600.0,
    )
    sample_period: float = quantity(
        0.25, "s",
        "Time that ~/step advances; spacing of the sampling instants in lockstep, until a "
        "controller publishes its own on control_period",
        minimum=1e-3, maximum=100.0,
    )
    start_paused: bool = quantity(False, "-", "Start paused, until the pause service is called")

    def __post_init__(self) -> None:
        super().__post_init__()
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


@dataclass(frozen=True)
class PushSettings:
    """Settings of pushes, for plants that can be pushed."""

    push_impulse: tuple[float, ...] = quantity(
        (0.5, 0.0), "N s", "Impulse of a push at the centre of the sphere: x, y in the world",
        minimum=-1e3, maximum=1e3, live=True,
    )

    def __post_init__(self) -> None:
        validate(self)
