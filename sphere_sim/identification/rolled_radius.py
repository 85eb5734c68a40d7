# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Radius of the shell from a straight way that was measured, and that odometry has estimated."""

import numpy as np

from sphere_nmpc.errors import Description, InvalidInputError
from sphere_nmpc.model.state import Vector

_REST = 0.5
"""Time at both ends in which the sphere has to rest [s]."""
_STILL = 1e-3
"""Displacement within it up to which the sphere rests [m]."""
_MIN_ROLLED_WAY = 1.0
"""Shortest way [m]: on it a millimetre of the tape is a part in a thousand of the radius."""
_STRAIGHT = 0.05
"""Largest excess of the length of the path over the distance of its ends [-]."""


def rolled_radius(
    times: Vector, places: Vector, radius: float, distance: float
) -> tuple[float, float]:
    """Return the radius that makes a way as long as it was measured, and its estimated length [m].

    The estimate is proportional to the radius [m] that it was made with, unless the odometry had
    fixes, from which it estimates that, too. `times` [s], shape (K,),
    rise, `places` [m], shape (K, 2), are those of the centre then; `distance` [m] was measured
    between the ends. `InvalidInputError` is raised where that is no straight way of a metre or
    more, or the sphere does not rest at both ends.
    """
    ends = list[Vector]()
    for name, at in (("start", times <= times[0] + _REST), ("end", times >= times[-1] - _REST)):
        ends.append(places[at].mean(axis=0))
        moved = float(np.max(np.linalg.norm(places[at] - ends[-1], axis=1)))
        if times[-1] - times[0] < 2.0 * _REST or moved > _STILL:
            raise InvalidInputError(
                f"{name} of the way", Description(f"{1e3 * moved:.2g} mm"),
                f"at most {1e3 * _STILL:g} mm in {_REST:g} s: the sphere has to rest at both ends",
            )
    rolled = float(np.linalg.norm(ends[1] - ends[0]))
    path = float(np.sum(np.linalg.norm(np.diff(places, axis=0), axis=1)))
    if rolled < _MIN_ROLLED_WAY:
        given = Description(f"{rolled:.4f} m")
        raise InvalidInputError("estimated way", given, f"{_MIN_ROLLED_WAY:g} m or more")
    if path > (1.0 + _STRAIGHT) * rolled:
        raise InvalidInputError(
            "path", Description(f"{path:.4f} m"),
            f"a straight one, at most {100.0 * _STRAIGHT:g} % longer than the distance of its "
            f"ends, {rolled:.4f} m",
        )
    return radius * distance / rolled, rolled
