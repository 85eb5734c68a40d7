# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Configuration of RViz for a robot of any size."""

from typing import Any

import yaml

from sphere_sim.output.round_numbers import grid_cell
from sphere_sim.viewer.frame import DEFAULT_RADIUS

_LENGTHS = {
    "Axes Length", "Axes Radius", "Distance", "Line Width", "Marker Scale", "Position Tolerance",
    "X", "Y", "Z",
}


def scaled_config(text: str, radius: float) -> str:
    """Return a configuration for the default robot as one for another radius [m]."""
    return yaml.safe_dump(_scaled(yaml.safe_load(text), radius), sort_keys=False)


def _scaled(value: Any, radius: float) -> Any:
    if isinstance(value, list):
        return [_scaled(item, radius) for item in value]
    if not isinstance(value, dict):
        return value
    found = {name: _scaled(item, radius) for name, item in value.items()}
    for name in _LENGTHS & found.keys():
        found[name] *= radius / DEFAULT_RADIUS
    if "Cell Size" in found:
        found["Cell Size"] = grid_cell(radius)
    return found
