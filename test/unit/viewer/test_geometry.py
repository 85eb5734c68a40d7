# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Meshes are closed and face outwards."""

import numpy as np
import pytest

from sphere_sim.viewer.geometry import Mesh, merged, octants, sector


def volume(mesh: Mesh) -> float:
    a, b, c = (mesh.vertices[mesh.faces[:, i]].astype(float) for i in range(3))
    return float(np.sum(np.einsum("ij,ij->i", a, np.cross(b, c)))) / 6.0


def test_shell_and_discs_are_closed_and_face_outwards() -> None:
    shell = merged([octants(0.3, even) for even in (False, True)])
    assert np.allclose(np.linalg.norm(shell.vertices, axis=1), 0.3, atol=1e-6)
    assert volume(shell) == pytest.approx(4.0 / 3.0 * np.pi * 0.3**3, rel=0.02)
    for axis in range(3):
        disc = sector(0.5, 0.1, axis)
        assert np.allclose(np.ptp(disc.vertices[:, axis]), 0.1)
        assert volume(disc) == pytest.approx(np.pi * 0.25 * 0.1, rel=0.02)
