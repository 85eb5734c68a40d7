# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""File with the last pose of an odometry."""

import json

import numpy as np
import pytest

from sphere_nmpc.estimation.odometry.kept_pose import KeptPose, pose_memory, since
from sphere_nmpc.model.state import upright_state

KEPT = KeptPose(
    upright_state(1.0, -2.0, 0.5), np.diag([1e-4, 1e-4, 1e-6, 1e-6, 1e-3]), True,
    np.array([0.5, -7.0]),
)


def test_pose_is_kept_with_its_covariance_and_the_angles_of_the_rotors(tmp_path) -> None:
    memory = pose_memory(tmp_path / "own" / "pose.json", 30.0)
    for kept in (KEPT, KEPT._replace(is_at_rest=False, angles=None)):
        memory.save(kept, 7, False)
        found = memory.recall(7, False)
        assert found is not None
        for one, other in zip(found[0], kept, strict=True):
            assert np.array_equal(one, other)


def test_rest_leaves_the_heading_less_certain_and_what_the_tilt_does_not_show() -> None:
    grown = np.diag(since(KEPT, 30.0, 1e-3, 0.3) - KEPT.covariance)
    np.testing.assert_allclose(grown, [1.8e-7, 1.8e-7, 0.0, 0.0, 9e-4], atol=1e-12)


@pytest.mark.parametrize("change", [
    {"pose": [0.0, 0.0, 9.0, 0.0, 0.0, 0.0]}, {"covariance": [[1.0]]}, {"angles": [1.0]},
    {"covariance": (-np.eye(5)).tolist()}, {"covariance": np.full((5, 5), np.nan).tolist()},
    {"angles": [1.0, float("inf")]}, {"stamp": "x"},
])
def test_file_without_a_valid_pose_is_ignored(tmp_path, change) -> None:
    memory = pose_memory(tmp_path / "own" / "pose.json", 30.0)
    memory.save(KEPT, 7, False)
    (path,) = (tmp_path / "own").iterdir()
    path.write_text(json.dumps({**json.loads(path.read_text()), **change}))
    assert memory.recall(7, False) is None
