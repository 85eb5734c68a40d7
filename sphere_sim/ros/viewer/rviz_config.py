# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Configuration of RViz for a robot of any size and a world frame of any name."""

from typing import Any

import yaml

from sphere_sim.output.round_numbers import grid_cell
from sphere_sim.viewer.source import DEFAULT_RADIUS

_LENGTHS = {
    "Axes Length", "Axes Radius", "Distance", "Line Width", "Marker Scale", "Position Tolerance",
    "X", "Y", "Z",
}
_FRAMES = {"Fixed Frame", "Reference Frame", "Target Frame"}


def rviz_config(text: str, radius: float, frame: str) -> str:
    """Return a configuration for the default robot as one for another radius [m] and frame."""
    return yaml.safe_dump(_adapted(yaml.safe_load(text), radius, frame), sort_keys=False)


def _adapted(value: Any, radius: float, frame: str) -> Any:
    if isinstance(value, list):
        return [_adapted(item, radius, frame) for item in value]
    if not isinstance(value, dict):
        return value
    found = {name: _adapted(item, radius, frame) for name, item in value.items()}
    for name in _LENGTHS & found.keys():
        found[name] *= radius / DEFAULT_RADIUS
    found |= dict.fromkeys(_FRAMES & found.keys(), frame)
    if "Cell Size" in found:
        found["Cell Size"] = grid_cell(radius)
    return found
