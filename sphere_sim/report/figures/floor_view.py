# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Orthographic view of a floor from above at an angle, with a marked sphere on it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageColor, ImageDraw, ImageFilter

from sphere_nmpc.model import rotation
from sphere_nmpc.model.state import Vector
from sphere_sim.report.figures.style import BLUE, ORANGE, VERMILION

_ELEVATION = np.radians(38.0)
_LIGHT = np.array((0.35, -0.45, 0.82)) / np.linalg.norm((0.35, -0.45, 0.82))
_BELT = 0.07
"""Half width of the line of circle Gamma over the radius."""
_HUB = 0.965
"""Cosine of the half angle of the dots at the ends of the rotors' axes."""


@dataclass(frozen=True, eq=False)
class Camera:
    """Orthographic projection of world points [m] to pixels.

    Attributes
    ----------
    size : tuple of int
        Width and height [pixels].
    right, up, towards : ndarray, shape (3,)
        Axes of the picture and direction to the viewer, unit vectors [world frame].
    scale : float
        Scale [pixels/m].
    middle : ndarray, shape (2,)
        Centre of the picture along `right` and `up` [m].
    """

    size: tuple[int, int]
    right: Vector
    up: Vector
    towards: Vector
    scale: float
    middle: Vector

    @classmethod
    def on(cls, places: Vector, radius: float, size: tuple[int, int]) -> "Camera":
        """Return a view that contains spheres of a radius [m] at places (n, 2) [m].

        The direction of their largest spread is horizontal in the picture.
        """
        spread = places - places.mean(axis=0)
        axis = np.linalg.svd(spread, full_matrices=False)[2][0]
        right = np.array((axis[0], axis[1], 0.0))
        if right[0] < 0.0:
            right = -right
        ahead = np.array((-right[1], right[0], 0.0))
        up = np.sin(_ELEVATION) * ahead + np.cos(_ELEVATION) * np.array((0.0, 0.0, 1.0))
        towards = np.cross(right, up)
        centres = np.column_stack((places, np.full(len(places), radius)))
        flat = np.column_stack((centres @ right, centres @ up))
        low, high = flat.min(axis=0) - 1.5 * radius, flat.max(axis=0) + 1.5 * radius
        scale = float(np.min(np.array(size) / (high - low)))
        return cls(size, right, up, towards, scale, 0.5 * (low + high))

    def project(self, points: object) -> list[tuple[float, float]]:
        """Return the pixels of world points, shape (n, 3) [m]."""
        world = np.asarray(points, dtype=float)
        x = self.size[0] / 2.0 + self.scale * (world @ self.right - self.middle[0])
        y = self.size[1] / 2.0 - self.scale * (world @ self.up - self.middle[1])
        return list(zip(x.tolist(), y.tolist(), strict=True))

    def floor_extent(self, tile: float) -> tuple[tuple[float, float], tuple[float, float]]:
        """Return the ranges of x and y of the visible floor, in whole tiles [m]."""
        reach = np.array(self.size) / (2.0 * self.scale)
        reach[1] /= np.sin(_ELEVATION)
        ahead = np.array((-self.right[1], self.right[0]))
        middle = self.right[:2] * self.middle[0] + ahead * self.middle[1] / np.sin(_ELEVATION)
        half = np.abs(self.right[:2]) * reach[0] + np.abs(ahead) * reach[1]
        low = np.floor((middle - half) / tile) * tile
        high = np.ceil((middle + half) / tile) * tile
        return (float(low[0]), float(high[0])), (float(low[1]), float(high[1]))


def paint_ball(
    picture: Image.Image,
    camera: Camera,
    place: Sequence[float],
    quaternion: Vector,
    radius: float,
    opacity: float = 1.0,
) -> None:
    """Draw a sphere with octants, circle Gamma and the ends of the rotors' axes.

    Parameters
    ----------
    picture : Image
        Picture to draw on.
    camera : Camera
        View.
    place : sequence of 3 floats
        Centre [m; world frame].
    quaternion : ndarray, shape (4,)
        Orientation wxyz, body to world.
    radius : float
        Radius [m].
    opacity : float, optional
        Opacity, 0 to 1; only an opaque sphere has a shadow.
    """
    x, y = camera.project([tuple(place)])[0]
    if opacity >= 1.0:
        _paint_shadow(picture, camera, place, radius)
    reach = camera.scale * radius
    half = int(np.ceil(reach)) + 1
    left, top = round(x) - half, round(y) - half
    across = (np.arange(2 * half) + left + 0.5 - x) / reach
    down = (np.arange(2 * half) + top + 0.5 - y) / reach
    a, b = np.meshgrid(across, -down)
    outside = a * a + b * b > 1.0
    c = np.sqrt(np.clip(1.0 - a * a - b * b, 0.0, 1.0))
    axes = np.stack((camera.right, camera.up, camera.towards))
    normals = np.stack((a, b, c), axis=-1) @ axes
    colours = _shell_colours(normals @ rotation.matrix(quaternion))
    shade = 0.55 + 0.5 * np.clip(normals @ _LIGHT, 0.0, 1.0)
    painted = np.clip(colours * shade[..., None], 0, 255).astype(np.uint8)
    mask = np.where(outside, 0, round(255 * opacity)).astype(np.uint8)
    picture.paste(Image.fromarray(painted), (left, top), Image.fromarray(mask))


def _shell_colours(points: Vector) -> Vector:
    """Return the colours of points of the unit sphere, shape (..., 3) [body frame]."""
    blue, orange, vermilion = (
        np.array(ImageColor.getrgb(name), dtype=float) for name in (BLUE, ORANGE, VERMILION)
    )
    odd = np.prod(points, axis=-1) > 0.0
    colours = np.where(odd[..., None], blue + 0.25 * (255.0 - blue), 250.0)
    colours[np.abs(points[..., 2]) < _BELT] = vermilion
    hubs = np.max(np.abs(points[..., :2]), axis=-1) > _HUB
    colours[hubs] = orange
    return colours


def _paint_shadow(
    picture: Image.Image, camera: Camera, place: Sequence[float], radius: float
) -> None:
    turn = np.linspace(0.0, 2.0 * np.pi, 49)
    # The shadow is displaced away from the light.
    x, y = np.asarray(place[:2]) - 0.35 * radius * _LIGHT[:2]
    rim = np.column_stack((x + 0.9 * radius * np.cos(turn), y + 0.9 * radius * np.sin(turn),
                           np.zeros_like(turn)))
    mask = Image.new("L", picture.size, 0)
    ImageDraw.Draw(mask).polygon(camera.project(rim), fill=95)
    picture.paste("#555555", (0, 0), mask.filter(ImageFilter.GaussianBlur(6)))
