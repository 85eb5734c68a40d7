# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Plant as predictions know it: its parameters, estimated or as built."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from sphere_nmpc.model.parameters import LumpedConstants
from sphere_nmpc.model.state import Vector


def _exactly() -> Callable[[], Vector]:
    """Return a function that returns one array of deviations 0, which cannot be written to."""
    deviations: Vector = np.zeros(4)
    deviations.flags.writeable = False
    return lambda: deviations


@dataclass(frozen=True, eq=False)
class PlantEstimate:
    """Parameters of the plant that predictions use; all of them of one update.

    Attributes
    ----------
    constants : LumpedConstants
        Estimated, or as built where learning is off.
    lag : float
        Delay of the motion behind the rotor speeds sent [s].
    noise : float
        Standard deviation of the disturbance of each state within a sample period [m, -].
    deviations : ndarray, shape (4,)
        Standard deviations of the estimated [Rs, c1, r1, r3].
    acceleration : float
        Rotor acceleration that the drives attain [rad/s^2]; inf where it is not less than asked.
    slippery : bool
        Whether the sphere has slipped recently.
    """

    constants: LumpedConstants
    lag: float = 0.0
    noise: float = 0.0
    deviations: Vector = field(default_factory=_exactly())
    acceleration: float = float("inf")
    slippery: bool = False
