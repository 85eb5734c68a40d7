# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Node parameters that are stored in a bag."""

import dataclasses
import json
from typing import Any

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.model.parameters import RobotParameters

PARAMETERS_PREFIX = "parameters:"
"""Custom data under this prefix and a node's full name hold the node's parameters as JSON."""


def recorded_robot(custom_data: dict[str, str], node: str) -> RobotParameters:
    """Return the robot that a node's parameters ``robot.*`` describe.

    Parameters
    ----------
    custom_data : dict of str to str
        Custom data of the bag.
    node : str
        Full name of the node.

    Returns
    -------
    RobotParameters
        The defaults where the bag has no valid parameters of the node.
    """
    names = {entry.name for entry in dataclasses.fields(RobotParameters)}
    values = {
        key.removeprefix("robot."): value
        for key, value in _parameters(custom_data, node).items()
        if key.startswith("robot.")
    }
    try:
        return RobotParameters(**{key: value for key, value in values.items() if key in names})
    except InvalidParameterError:
        return RobotParameters()


def _parameters(custom_data: dict[str, str], node: str) -> dict[str, Any]:
    """Return the recorded parameters of a node; empty where the bag has none."""
    try:
        values = json.loads(custom_data.get(f"{PARAMETERS_PREFIX}{node}", "{}"))
    except ValueError:
        return {}
    return values if isinstance(values, dict) else {}
