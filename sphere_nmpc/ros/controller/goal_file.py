# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Where a controller keeps the goal in force."""

import os
from pathlib import Path

from rclpy.node import Node

from sphere_nmpc.cache import cache_folder


def goal_file(node: Node) -> Path:
    """Return the file for the goal of a node, one for each domain and full name."""
    name = node.get_fully_qualified_name().strip("/").replace("/", ".")
    domain = os.environ.get("ROS_DOMAIN_ID") or "0"
    return cache_folder() / "goals" / f"{domain}.{name}.json"
