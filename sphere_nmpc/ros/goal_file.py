# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Where a controller keeps the goal in force."""

import os
from pathlib import Path

from rclpy.node import Node

from sphere_nmpc.solver.native import cache_folder


def goal_file(node: Node) -> Path | None:
    """Return the file for the goal of a node, one for each domain and full name.

    None where the user has no home for it.
    """
    try:
        folder = cache_folder()
    except RuntimeError:
        return None
    name = node.get_fully_qualified_name().strip("/").replace("/", ".")
    return folder / "goals" / f"{os.environ.get('ROS_DOMAIN_ID') or '0'}.{name}.json"
