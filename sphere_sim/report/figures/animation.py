# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Animation (GIF) of a recorded run."""

import io
import math
from pathlib import Path

import matplotlib as mpl
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from sphere_nmpc.model.state import POSITION, QUATERNION, Vector
from sphere_sim.evaluation.metrics import (
    angle_errors,
    position_errors,
    settling_index,
)
from sphere_sim.output.atomic_write import write_atomically
from sphere_sim.output.round_numbers import grid_cell
from sphere_sim.recording.run import Run
from sphere_sim.report.figures.floor_view import Camera, paint_ball
from sphere_sim.report.figures.style import BLUE, GREY, VERMILION

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


def write_animation(run: Run, path: Path) -> None:
    """Write a GIF that repeats endlessly, in real time, until the run has settled.

    Parameters
    ----------
    run : Run
        The run; one that does not settle is shown completely.
    path : Path
        File to write.
    """
    end = min(_end_of_interest(run), float(run.times[-1]))
    instants = np.arange(0.0, end + 1e-9, 1.0 / _FRAME_RATE)
    indices = np.minimum(np.searchsorted(run.times, instants - 1e-9), run.times.size - 1)
    radius = run.robot.shell_radius
    seen = run.states[: indices[-1] + 1, POSITION]
    places = seen if run.goal is None else np.vstack((seen, run.goal[POSITION]))
    camera = Camera.on(places, radius, (_SIZE[0] * _OVERSAMPLING, _SIZE[1] * _OVERSAMPLING))
    floor = _floor(camera, run, radius)
    frames = [_frame(camera, floor, run, int(i), radius) for i in indices]
    # With one palette for all frames colours do not flicker.
    palette = frames[len(frames) // 2].quantize(_COLOURS, Image.Quantize.MEDIANCUT)
    paletted = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    milliseconds = [round(1e3 / _FRAME_RATE)] * len(frames)
    milliseconds[-1] = round(1e3 * _LAST_FRAME)
    packed = io.BytesIO()
    paletted[0].save(
        packed, "GIF", save_all=True, append_images=paletted[1:], duration=milliseconds, loop=0,
        optimize=True,
    )
    write_atomically(path, packed.getvalue())


def _end_of_interest(run: Run) -> float:
    """Return half a second after the run has settled [s]; inf if it has not."""
    times, errors = run.errors()
    index = settling_index(errors)
    return float("inf") if index is None else float(times[index]) + 0.5


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
        paint_ball(picture, camera, place, run.goal[QUATERNION], radius, opacity=0.28)
    return picture


def _frame(
    camera: Camera, floor: Image.Image, run: Run, index: int, radius: float
) -> Image.Image:
    """Return the frame at an index of the run's poses."""
    picture = floor.copy()
    draw = ImageDraw.Draw(picture)
    past = run.states[: index + 1, POSITION]
    if len(past) > 1:
        draw.line(camera.project(np.column_stack((past, np.zeros(len(past))))), fill=BLUE,
                  width=3 * _OVERSAMPLING, joint="curve")
    arm = _ARM * _drawn_size(camera, radius)
    _cross(draw, camera, run.states[0, POSITION], arm, GREY)
    if run.goal is not None:
        _cross(draw, camera, run.goal[POSITION], arm, VERMILION)
    x, y = run.states[index, POSITION]
    paint_ball(picture, camera, (x, y, radius), run.states[index, QUATERNION], radius)
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
        state = run.states[index : index + 1]
        distance = float(position_errors(state, run.goal)[0])
        angle = float(np.degrees(angle_errors(state, run.goal)[0]))
        text += f"     to the goal: {distance:.{digits}f} m, {angle:.0f}\N{DEGREE SIGN}"
    draw.text((12 * _OVERSAMPLING, 10 * _OVERSAMPLING), text, fill=_INK, font=font)
