# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Occupied cells as few rectangles: for contacts with them, and for drawings."""

import numpy as np
from numpy.typing import NDArray

from sphere_nmpc.floor.occupancy import Cells


def rectangles(cells: Cells) -> NDArray[np.intp]:
    """Return the occupied cells as rectangles that do not overlap, shape (n, 4).

    Columns are left, bottom, right and top [cells]. Runs of cells in a row are joined with equal
    ones in the rows above.
    """
    steps = np.diff(np.pad(cells, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    row, left = np.nonzero(steps == 1)
    right = np.nonzero(steps == -1)[1]
    order = np.lexsort((row, right, left))
    row, left, right = row[order], left[order], right[order]
    continues = (np.diff(left) == 0) & (np.diff(right) == 0) & (np.diff(row) == 1)
    first = np.flatnonzero(np.concatenate(([True], ~continues))[: row.size])
    last = np.append(first[1:], row.size)[: first.size] - 1
    return np.column_stack((left[first], row[first], right[first], row[last] + 1))
