# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Sphere in the scene: marked shell, circle Gamma, rotors and counterweights."""

import math

import numpy as np
import viser

from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector
from sphere_sim.output import colours
from sphere_sim.output.colours import Colour
from sphere_sim.viewer.geometry import Mesh, cap, great_circle, octants, sector, segments

_SLOWDOWN = 10.0
"""Ratio of true to drawn rotor speeds: at full speed the direction of rotation is not visible."""
_SHADOW_HEIGHT = 1.0 / 300.0
"""Distance of floor and discs of the shadow over the radius."""
_PROPORTIONS = RobotParameters()
_THIN = 0.1
"""Drawn thickness of a rotor over its radius; a rotor with these inertias would be flat."""


def add_shell(
    scene: viser.SceneApi, name: str, radius: float, panels: Colour, opacity: float
) -> viser.FrameHandle:
    """Add a shell with marks that show its orientation as a node of the scene, and return that.

    Every other octant has the colour `panels` and this opacity; the others are more transparent.
    """
    frame = scene.add_frame(name, show_axes=False)
    for even, colour, share in ((True, panels, 1.0), (False, colours.WHITE, 0.45)):
        mesh = octants(radius, even)
        _add(scene, f"{name}/panels_{int(even)}", mesh, colour, opacity * share)
    # Ends of body x and y, the axes of the rotors, and of body z.
    for axis, colour in enumerate((*colours.ROTORS, colours.INK)):
        _add(scene, f"{name}/pole_{axis}", cap(1.004 * radius, axis, 0.17), colour, None)
    return frame


class Ball:
    """Robot in the scene, created for one radius of the shell [m] and then moved.

    Its rotors have the proportions of the default robot.
    """

    def __init__(self, scene: viser.SceneApi, radius: float) -> None:
        self.radius = radius
        self._frame = scene.add_frame("/sphere", show_axes=False)
        add_shell(scene, "/sphere/shell", radius, colours.BLUE, 0.42)
        scene.add_line_segments(
            "/sphere/gamma", segments(great_circle(1.006 * radius)),
            colours.linear(colours.GAMMA),
            thickness=0.026 * radius,
        )
        self._shadow = scene.add_frame("/shadow", show_axes=False)
        # Imitation of a shadow on the floor; computed shadows are too slow without a graphics
        # card.
        for i, (size, darkness) in enumerate(((0.55, 0.16), (0.8, 0.12), (1.0, 0.08))):
            spot = sector(size * radius, 3e-4 * radius, 2)
            scene.add_mesh_simple(
                f"/shadow/{i}", spot.vertices, spot.faces, color=colours.INK, opacity=darkness,
                position=(0.0, 0.0, _SHADOW_HEIGHT * (i + 1) * radius), cast_shadow=False,
                receive_shadow=False,
            )
        scale = radius / _PROPORTIONS.shell_radius
        self._offset = scale * _PROPORTIONS.rotor_offset
        disc = scale * math.sqrt(
            2.0 * _PROPORTIONS.rotor_axial_inertia / _PROPORTIONS.rotor_mass
        )
        self._rotors = [self._add_rotor(scene, axis, disc) for axis in range(2)]
        self._angles: Vector = np.zeros(2)
        self._time: float | None = None

    def place(self, state: Vector, speeds: Vector, time: float) -> None:
        """Show a state, shape (6,), with rotors turned by `speeds` [rad/s] up to `time` [s]."""
        self._frame.position = (float(state[0]), float(state[1]), self.radius)
        self._frame.wxyz = state[2:]
        self._shadow.position = (float(state[0]), float(state[1]), 0.0)
        elapsed = 0.0 if self._time is None else min(max(0.0, time - self._time), 1.0)
        self._time = time
        turned = np.nan_to_num(speeds) * elapsed / _SLOWDOWN
        self._angles = (self._angles + turned) % (4.0 * math.pi)
        for axis, rotor in enumerate(self._rotors):
            half = 0.5 * float(self._angles[axis])
            rotor.wxyz = (math.cos(half), *(math.sin(half) * np.eye(3)[axis]))

    def _add_rotor(self, scene: viser.SceneApi, axis: int, disc: float) -> viser.FrameHandle:
        name = f"/sphere/rotor_{axis + 1}"
        place = self._offset * np.eye(3)[axis]
        frame = scene.add_frame(name, show_axes=False, position=place)
        _add(scene, f"{name}/disc", sector(disc, _THIN * disc, axis), colours.ROTORS[axis], None)
        for part in range(2):
            start = math.pi * part
            slice_ = sector(0.92 * disc, 1.3 * _THIN * disc, axis, start, start + 0.5 * math.pi)
            _add(scene, f"{name}/mark_{part}", slice_, colours.INK, None)
        scene.add_icosphere(
            f"/sphere/counterweight_{axis + 1}", 0.25 * disc, (120, 125, 130),
            position=-place, cast_shadow=False,
        )
        return frame


class Estimate:
    """Translucent shell, a little smaller than the sphere's, at a pose that odometry estimates."""

    def __init__(self, scene: viser.SceneApi, radius: float) -> None:
        self._radius = radius
        self._shell = add_shell(scene, "/estimate", 0.97 * radius, colours.ESTIMATE, 0.6)
        self._label = scene.add_label("/estimate_label", "estimate", anchor="bottom-center")

    def place(self, state: Vector | None) -> None:
        """Show a state, shape (6,), or nothing."""
        self._shell.visible = self._label.visible = state is not None
        if state is not None:
            self._shell.position = (float(state[0]), float(state[1]), self._radius)
            self._shell.wxyz = state[2:]
            self._label.position = (float(state[0]), float(state[1]), 2.2 * self._radius)


def _add(
    scene: viser.SceneApi, name: str, mesh: Mesh, colour: Colour, opacity: float | None
) -> None:
    scene.add_mesh_simple(
        name, mesh.vertices, mesh.faces, color=colour, opacity=opacity,
        side="front" if opacity is None else "double", receive_shadow=False,
        cast_shadow=False,
    )
