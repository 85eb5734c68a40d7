# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Write urdf/sphere.urdf; a test compares the file with what this writes."""

from pathlib import Path

from sphere_nmpc.model.parameters import RobotParameters
from sphere_sim.world.robot_description import make_urdf

FILE = Path(__file__).parents[2] / "urdf" / "sphere.urdf"

if __name__ == "__main__":
    FILE.write_text(make_urdf(RobotParameters()), encoding="utf-8")
