# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Meshes are closed and face outwards; curves lie on their surfaces."""

import numpy as np
import pytest

from sphere_sim.viewer.geometry import (
    Mesh,
    arc,
    cap,
    merged,
    octants,
    sector,
)


def volume(mesh: Mesh) -> float:
    a, b, c = (mesh.vertices[mesh.faces[:, i]].astype(float) for i in range(3))
    return float(np.sum(np.einsum("ij,ij->i", a, np.cross(b, c)))) / 6.0


def test_octants_of_both_signs_form_a_sphere_that_faces_outwards() -> None:
    halves = [octants(0.3, even) for even in (False, True)]
    for sign, half in zip((-1, 1), halves, strict=True):
        centres = half.vertices[half.faces].mean(axis=1)
        assert np.all(np.sign(np.prod(centres, axis=1)) == sign)
    whole = merged(halves)
    assert np.allclose(np.linalg.norm(whole.vertices, axis=1), 0.3, atol=1e-6)
    assert volume(whole) == pytest.approx(4.0 / 3.0 * np.pi * 0.3**3, rel=0.02)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_caps_and_sectors_lie_along_their_axis(axis) -> None:
    pole = cap(1.0, axis, 0.2)
    assert np.all(pole.vertices[:, axis] > 0.97)
    disc = sector(0.5, 0.1, axis)
    assert np.allclose(np.ptp(disc.vertices[:, axis]), 0.1)
    assert volume(disc) == pytest.approx(np.pi * 0.25 * 0.1, rel=0.02)
    assert volume(sector(0.5, 0.1, axis, 0.0, 1.0)) == pytest.approx(0.5 * 0.25 * 0.1, rel=0.02)


def test_arc_stays_on_the_sphere_in_short_steps() -> None:
    way = arc(np.array([0.3, 0.0, 0.0]), np.array([0.0, 0.3, 0.0]), 0.05)
    assert np.allclose(np.linalg.norm(way, axis=1), 0.3)
    assert way[-1] == pytest.approx([0.0, 0.3, 0.0])
    assert len(way) >= 8
