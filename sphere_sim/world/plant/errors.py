# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Errors of the plants."""

from sphere_nmpc.errors import SphereNmpcError


class MissingEngineError(SphereNmpcError, ImportError):
    """The rigid-body engine is not installed."""

    def __init__(self) -> None:
        super().__init__(
            "the plant 'rigid_body' needs MuJoCo: pip install 'sphere_nmpc[rigid]' (or mujoco)"
        )


class PlantDivergedError(SphereNmpcError, RuntimeError):
    """The state of a simulated plant is not finite: the time step is too long for the settings.

    Parameters
    ----------
    time_step : float
        Longest integration step of the settings [s].
    """

    def __init__(self, time_step: float) -> None:
        super().__init__(
            f"rigid_body: the state is no longer finite; time_step {time_step:g} s is too long "
            "for the contact and the drives"
        )
        self.time_step = time_step
