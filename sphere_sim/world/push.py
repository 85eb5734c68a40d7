# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Push: an impulse at an instant."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Push:
    """Push at the centre of the sphere.

    Attributes
    ----------
    time : float
        From the start of the run [s].
    impulse : tuple of float
        x, y [N s; world frame].
    """

    time: float
    impulse: tuple[float, float]
