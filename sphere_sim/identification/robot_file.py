# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of a robot with identified constants, and the file of parameters that nodes take."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace

import numpy as np

from sphere_nmpc.model.parameters import LumpedConstants, RobotParameters
from sphere_nmpc.model.state import Vector

_STEP = 1e-6
"""Relative step of the differences by lumped constants [-]."""
CHANGED = ("rotor_axial_inertia", "rotor_transverse_inertia", "shell_inertia", "rotor_offset")
"""Parameters that are changed to have identified constants, besides the radius."""


def with_constants(given: RobotParameters, lumped: LumpedConstants) -> RobotParameters:
    """Return a robot with these constants of the motion, and the masses of a given one.

    Constants are ratios of inertias: any mass could be kept. The inertia of a rotor follows from
    c1, its transverse one in proportion, then the shell's and the distance of the rotors from the
    inertias about the centre; those of counterweights stay. `InvalidParameterError` is raised
    where that is no robot.
    """
    rolling = given.total_mass * lumped.shell_radius**2
    transverse = rolling * (1.0 / lumped.transverse_ratio - 1.0)
    axial = rolling * (1.0 / lumped.axial_ratio - 1.0)
    own = lumped.input_gain * rolling / lumped.transverse_ratio
    across = given.rotor_transverse_inertia * own / given.rotor_axial_inertia
    offset = transverse - own - given.counterweight_axial_inertia
    shell = 2.0 * offset - axial
    square = offset - shell - across - given.counterweight_transverse_inertia
    square /= given.rotor_mass + given.counterweight_mass
    return replace(
        given, shell_radius=lumped.shell_radius, rotor_axial_inertia=own,
        rotor_transverse_inertia=across, shell_inertia=shell,
        rotor_offset=math.sqrt(square) if square >= 0.0 else -1.0,
    )


def deviations_of(
    given: RobotParameters, constants: Vector, covariance: Vector
) -> dict[str, float]:
    """Return the deviations of the radius and `CHANGED` by those of the constants, (4, 4)."""
    names = ("shell_radius", *CHANGED)

    def values(constants: Vector) -> Vector:
        robot = with_constants(given, LumpedConstants(*constants.tolist()))
        return np.array([getattr(robot, name) for name in names])

    here = values(constants)
    slope = np.column_stack([
        (values(constants + step) - here) / _STEP for step in np.diag(_STEP * constants)
    ]) / constants
    found = np.sqrt(np.diag(slope @ covariance @ slope.T))
    return dict(zip(names, found.tolist(), strict=True))


@dataclass(frozen=True)
class Entry:
    """A parameter: its value, and what the file says of it."""

    value: float | tuple[float, ...]
    note: str = ""


def written(sections: Mapping[str, Mapping[str, Entry]], head: str) -> str:
    """Return a file of parameters, with a heading; sections by nodes, as ``/**``.

    Names with a dot, as ``imu.position``, are nested.
    """
    lines = [f"# {line}".rstrip() for line in head.splitlines()]
    for node, entries in sections.items():
        lines += ["", f"{node}:", "  ros__parameters:"]
        group = ""
        for name, entry in entries.items():
            before, _, last = name.rpartition(".")
            if before != group:
                group = before
                lines.append(f"    {group}:")
            text = f"{'      ' if group else '    '}{last}: {_number(entry.value)}"
            lines.append(f"{text:<44}  # {entry.note}" if entry.note else text)
    return "\n".join(lines) + "\n"


def _number(value: float | tuple[float, ...]) -> str:
    if isinstance(value, tuple):
        return f"[{', '.join(map(_number, value))}]"
    text = f"{value:.7g}"
    # YAML 1.1 reads a number without a point as a whole one, or as text.
    mantissa, e, exponent = text.partition("e")
    return f"{mantissa if '.' in mantissa else mantissa + '.0'}{e}{exponent}"


def robot_entries(robot: RobotParameters, notes: Mapping[str, str]) -> dict[str, Entry]:
    """Return all parameters of a robot, with notes by their names."""
    return {
        f"robot.{field.name}": Entry(getattr(robot, field.name), notes.get(field.name, "as given"))
        for field in fields(robot)
    }
