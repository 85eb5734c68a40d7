# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Write the table of the lost times of the default robot, in 40 s of one core.

    python bench/documents/displacement_table_file.py
"""

import zipfile

import numpy as np
from displacement import DisplacementSteps
from numpy.typing import ArrayLike, NDArray
from orientation_grid import OrientationGrid

from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector
from sphere_sim.study.displacement_table import FASTEST, FILE, RESOLUTION

_SIZE = 48
"""Nodes in a quarter turn; the time grows with the fourth power."""
_HORIZON = 2.4
"""Time up to which the table goes; later on the lost time does not decrease. A longer table does
not raise it, as what is added in each step outweighs what it gains."""
_EVERY = 9
"""Steps of the computation for one of the table."""


def computed(grid: OrientationGrid, horizon: float) -> tuple[Vector, Vector, NDArray[np.int16]]:
    """Return times, lost times of the cap and stored ones of a grid; see `DisplacementTable`."""
    steps = DisplacementSteps(grid)
    number = int(horizon / steps.step / _EVERY)
    times, at_cap = np.zeros(number + 1), np.zeros(number + 1)
    stored = np.zeros((number + 1, *grid.shape), dtype=np.int16)
    for step in range(1, number + 1):
        for _ in range(_EVERY):
            steps.advance()
        times[step] = steps.time
        at_cap[step] = steps.time - (steps.cap + steps.added) / FASTEST
        lost = steps.time - (steps.coefficients + steps.added) / FASTEST
        stored[step] = np.floor(lost / RESOLUTION)
    return times, at_cap, stored


def write(**arrays: ArrayLike) -> None:
    """Write the file, better compressed than NumPy does."""
    with zipfile.ZipFile(FILE, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as file:
        for name, array in arrays.items():
            with file.open(f"{name}.npy", "w") as member:
                np.lib.format.write_array(member, np.asarray(array))


def main() -> None:
    """Write the file."""
    robot = RobotParameters().lumped
    ratios = robot.transverse_ratio, robot.axial_ratio
    times, at_cap, stored = computed(OrientationGrid(_SIZE, *ratios), _HORIZON)
    changes = np.diff(stored, axis=0, prepend=np.int16(0))
    assert np.max(np.abs(changes)) <= np.iinfo(np.int8).max
    # From angle to angle, modulo 256: with that the file is an eighth smaller.
    slopes = np.diff(changes.astype(np.int8), axis=3, prepend=np.int8(0))
    write(ratios=ratios, times=times, at_cap=at_cap, slopes=slopes)


if __name__ == "__main__":
    main()
