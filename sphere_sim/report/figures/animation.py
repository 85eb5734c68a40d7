# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Animation (GIF) of a recorded run: a marked sphere on a floor, seen from above at an angle."""

import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl
import numpy as np
from PIL import Image, ImageColor, ImageDraw, ImageFilter, ImageFont

from sphere_nmpc.model import rotation
from sphere_nmpc.model.goal import Orientation
from sphere_nmpc.model.state import POSITION, QUATERNION, Vector
from sphere_sim.evaluation.metrics import settling_index
from sphere_sim.output.files import write_atomically
from sphere_sim.output.round_numbers import grid_cell
from sphere_sim.recording.run import Run
from sphere_sim.report.figures.style import BLUE, GAMMA, GOAL, GREY, PATH, ROTORS

_SIZE = (640, 300)
_OVERSAMPLING = 2
"""Factor by which frames are drawn larger and then reduced, which smooths the edges."""
_FRAME_RATE = 20.0
"""Frames a second; GIF stores frame times in hundredths of a second."""
_LAST_FRAME = 1.2
"""Duration of the last frame [s]."""
_COLOURS = 128
_ARM = 0.2
"""Half length of the crosses that mark start and goal over the radius."""
_MOST_RADII = 40.0
"""Width of the picture over the radius from which on grid and crosses become larger."""
_BACKGROUND, _LINES, _INK = "#ffffff", "#e4e4e4", "#222222"
_ELEVATION = np.radians(38.0)
_LIGHT = np.array((0.35, -0.45, 0.82)) / np.linalg.norm((0.35, -0.45, 0.82))
_BELT = 0.07
"""Half width of the line of circle Gamma over the radius."""
_HUB = 0.965
"""Cosine of the half angle of the dots at the ends of the rotors' axes."""


@dataclass(frozen=True, eq=False)
class Camera:
    """Orthographic projection of world points [m] to pixels."""

    size: tuple[int, int]
    """Width and height [pixels]."""
    axes: Vector
    """Axes to the right, up and towards the viewer: unit vectors, shape (3, 3) [world frame]."""
    scale: float
    """Scale [pixels/m]."""
    middle: Vector
    """Centre of the picture to the right and up, shape (2,) [m]."""

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
        axes = np.stack((right, up, np.cross(right, up)))
        flat = np.column_stack((places, np.full(len(places), radius))) @ axes[:2].T
        low, high = flat.min(axis=0) - 1.5 * radius, flat.max(axis=0) + 1.5 * radius
        scale = float(np.min(np.array(size) / (high - low)))
        return cls(size, axes, scale, 0.5 * (low + high))

    def project(self, points: object) -> list[tuple[float, float]]:
        """Return the pixels of world points, shape (n, 3) [m]."""
        flat = self.scale * (np.asarray(points, dtype=float) @ self.axes[:2].T - self.middle)
        pixels = np.array(self.size) / 2.0 + flat * (1.0, -1.0)
        return [(x, y) for x, y in pixels.tolist()]

    def floor_extent(self, tile: float) -> tuple[tuple[float, float], tuple[float, float]]:
        """Return the ranges of x and y of the visible floor, in whole tiles [m]."""
        reach = np.array(self.size) / (2.0 * self.scale)
        reach[1] /= np.sin(_ELEVATION)
        right = self.axes[0, :2]
        ahead = np.array((-right[1], right[0]))
        middle = right * self.middle[0] + ahead * self.middle[1] / np.sin(_ELEVATION)
        half = np.abs(right) * reach[0] + np.abs(ahead) * reach[1]
        low = np.floor((middle - half) / tile) * tile
        high = np.ceil((middle + half) / tile) * tile
        return (float(low[0]), float(high[0])), (float(low[1]), float(high[1]))


def write_animation(run: Run, path: Path) -> None:
    """Write a GIF of a run until it has settled, in real time; it repeats endlessly.

    A run that does not settle is shown completely.
    """
    index, end = settling_index(run.goal_errors[:, 0]), float(run.times[-1])
    if index is not None:
        end = min(end, float(run.times[index]) + 0.5)
    instants = np.arange(0.0, end + 1e-9, 1.0 / _FRAME_RATE)
    indices = np.minimum(np.searchsorted(run.times, instants - 1e-9), run.times.size - 1)
    radius = run.robot.shell_radius
    seen = run.states[: indices[-1] + 1, POSITION]
    places = seen if run.goal is None else np.vstack((seen, run.goal[POSITION]))
    camera = Camera.on(places, radius, (_SIZE[0] * _OVERSAMPLING, _SIZE[1] * _OVERSAMPLING))
    floor = _floor(camera, run, radius)
    frames = [_frame(camera, floor, run, int(i), radius) for i in indices]
    # With one palette for all frames colours do not flicker.
    # Others give the thin lines and crosses colours of large parts.
    palette = frames[len(frames) // 2].quantize(_COLOURS, Image.Quantize.FASTOCTREE)
    paletted = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    milliseconds = [round(1e3 / _FRAME_RATE)] * len(frames)
    milliseconds[-1] = round(1e3 * _LAST_FRAME)
    packed = io.BytesIO()
    paletted[0].save(
        packed, "GIF", save_all=True, append_images=paletted[1:], duration=milliseconds, loop=0,
        optimize=True,
    )
    write_atomically(path, packed.getvalue())


def _floor(camera: Camera, run: Run, radius: float) -> Image.Image:
    """Return the background: tiles, half a metre for 0.3 m, and the translucent goal."""
    picture = Image.new("RGB", camera.size, _BACKGROUND)
    draw = ImageDraw.Draw(picture)
    tile = grid_cell(_drawn_size(camera, radius))
    (left, right), (near, far) = camera.floor_extent(tile)
    for x in np.arange(left, right + 0.5 * tile, tile):
        draw.line(camera.project([(x, near, 0.0), (x, far, 0.0)]), fill=_LINES, width=2)
    for y in np.arange(near, far + 0.5 * tile, tile):
        draw.line(camera.project([(left, y, 0.0), (right, y, 0.0)]), fill=_LINES, width=2)
    if run.goal is not None:
        place = (*run.goal[POSITION], radius)
        free = run.goals.values[-1].orientation is Orientation.ANY
        shown = None if free else run.goal[QUATERNION]
        _paint_ball(picture, camera, place, shown, radius, opacity=0.28)
    return picture


def _frame(
    camera: Camera, floor: Image.Image, run: Run, index: int, radius: float
) -> Image.Image:
    """Return the frame at an index of the run's poses."""
    picture = floor.copy()
    draw = ImageDraw.Draw(picture)
    past = run.states[: index + 1, POSITION]
    if len(past) > 1:
        draw.line(camera.project(np.column_stack((past, np.zeros(len(past))))), fill=PATH,
                  width=3 * _OVERSAMPLING, joint="curve")
    arm = _ARM * _drawn_size(camera, radius)
    _cross(draw, camera, run.states[0, POSITION], arm, GREY)
    if run.goal is not None:
        _cross(draw, camera, run.goal[POSITION], arm, GOAL)
    x, y = run.states[index, POSITION]
    _paint_ball(picture, camera, (x, y, radius), run.states[index, QUATERNION], radius)
    _caption(ImageDraw.Draw(picture), run, index, radius)
    return picture.resize(_SIZE, Image.Resampling.LANCZOS)


def _drawn_size(camera: Camera, radius: float) -> float:
    """Return the radius for which grid and crosses are drawn [m]; tiny ones would be unseen."""
    return max(radius, camera.size[0] / camera.scale / _MOST_RADII)


def _cross(
    draw: ImageDraw.ImageDraw, camera: Camera, place: Vector, arm: float, colour: str
) -> None:
    """Draw a cross on the floor."""
    for way in ((arm, 0.0), (0.0, arm)):
        ends = [(*(place - way), 0.0), (*(place + way), 0.0)]
        draw.line(camera.project(ends), fill=colour, width=3 * _OVERSAMPLING)


def _caption(draw: ImageDraw.ImageDraw, run: Run, index: int, radius: float) -> None:
    """Draw time and distance to the goal, to a thirtieth of the radius or finer."""
    digits = max(0, math.ceil(-math.log10(radius / 30.0) - 1e-9))
    font = ImageFont.truetype(
        str(Path(mpl.get_data_path(), "fonts", "ttf", "DejaVuSans.ttf")), 13 * _OVERSAMPLING
    )
    text = f"{run.times[index]:4.1f} s"
    if run.goal is not None:
        _, distance, angle = run.goal_errors[index].tolist()
        text += f"     to the goal: {distance:.{digits}f} m"
        if math.isfinite(angle):
            text += f", {math.degrees(angle):.0f}\N{DEGREE SIGN}"
    draw.text((12 * _OVERSAMPLING, 10 * _OVERSAMPLING), text, fill=_INK, font=font)


def _paint_ball(
    picture: Image.Image, camera: Camera, place: Sequence[float], quaternion: Vector | None,
    radius: float, opacity: float = 1.0,
) -> None:
    """Draw a sphere with octants, circle Gamma and the ends of the rotors' axes.

    Its centre is at `place` [m; world frame], its orientation the quaternion wxyz, body to world;
    one without an orientation is blue all over. Only an opaque sphere has a shadow.
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
    normals = np.stack((a, b, c), axis=-1) @ camera.axes
    colours = np.broadcast_to(np.array(ImageColor.getrgb(BLUE), dtype=float), normals.shape)
    if quaternion is not None:
        colours = _shell_colours(normals @ rotation.matrix(quaternion))
    shade = 0.55 + 0.5 * np.clip(normals @ _LIGHT, 0.0, 1.0)
    painted = np.clip(colours * shade[..., None], 0, 255).astype(np.uint8)
    mask = np.where(outside, 0, round(255 * opacity)).astype(np.uint8)
    picture.paste(Image.fromarray(painted), (left, top), Image.fromarray(mask))


def _shell_colours(points: Vector) -> Vector:
    """Return the colours of points of the unit sphere, shape (..., 3) [body frame]."""
    blue, gamma, *rotors = (
        np.array(ImageColor.getrgb(name), dtype=float) for name in (BLUE, GAMMA, *ROTORS)
    )
    odd = np.prod(points, axis=-1) > 0.0
    colours = np.where(odd[..., None], blue + 0.25 * (255.0 - blue), 250.0)
    colours[np.abs(points[..., 2]) < _BELT] = gamma
    for axis, colour in enumerate(rotors):
        colours[np.abs(points[..., axis]) > _HUB] = colour
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
