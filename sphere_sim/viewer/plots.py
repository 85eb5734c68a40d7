# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Plots beside the scene, of the last seconds of a run."""

import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import viser
from viser import uplot

from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector
from sphere_sim.output import colours
from sphere_sim.output.colours import Colour, css
from sphere_sim.viewer.source import Frame, errors_of, rotor_momentum

_SMALLEST = 1e-9
"""Least value on a logarithmic axis."""
_HEIGHT = 112
"""Height of a plot [px]."""
_LABEL_SPACING = 15
"""Least distance of two labels on the vertical axis [px]."""
_TICKS = uplot.Axis_Ticks(size=3, width=1)
_OVERSHOOT = 0.03
"""Part of a step by which values may exceed an axis before it grows."""
WINDOW = 30.0
"""Length of the series [s]."""
_SPACING = WINDOW / 400
"""Least time between two of their points [s]."""
NAMES = (
    "time", "distance", "angle", "speed_1", "speed_2", "torque_1", "torque_2", "cost", "to_go",
    "solve_ms", "momentum_x", "momentum_y", "momentum_z",
)
Range = tuple[float, float]


class History:
    """Time series of the last `WINDOW` seconds, thinned from the frames of a run."""

    def __init__(self) -> None:
        self._rows: deque[tuple[float, ...]] = deque()

    def add(self, frame: Frame) -> None:
        """Add a frame; one of a restarted run deletes the series first."""
        if frame.restarted:
            self._rows.clear()
        if frame.state is None or (
            self._rows and frame.time < self._rows[-1][0] + _SPACING
        ):
            return
        distance, angle = errors_of(frame)
        self._rows.append((
            frame.time,
            distance, math.degrees(angle),
            *map(float, frame.rotor_speeds), *map(float, frame.rotor_torques),
            frame.cost, frame.to_go, 1e3 * frame.solve_time,
            *map(float, frame.momentum),
        ))
        while self._rows[0][0] < frame.time - WINDOW:
            self._rows.popleft()

    def series(self) -> dict[str, Vector]:
        """Return the series by name, all of one length; nan where a value is unknown."""
        table = np.array(self._rows, dtype=float).reshape(-1, len(NAMES))
        return dict(zip(NAMES, table.T, strict=True))


@dataclass(frozen=True)
class Chart:
    """Series of the history in one plot, with labels and colours.

    `least` is the smallest range of the vertical axis in a `unit` of the robot, so that small
    changes look small. A chart of `disturbances` is only shown while a value is not zero.
    """

    title: str
    names: tuple[str, ...]
    labels: tuple[str, ...]
    colours: tuple[Colour, ...]
    least: Range
    unit: Callable[[RobotParameters], float] = lambda robot: 1.0
    logarithmic: bool = False
    disturbances: bool = False


CHARTS = (
    Chart("error, log10: distance [m], angle [°]", ("distance", "angle"),
          ("distance", "angle"), (colours.DISTANCE, colours.ANGLE), (-3.0, 0.0),
          logarithmic=True),
    Chart("rotor speeds [rad/s]", ("speed_1", "speed_2"), ("rotor 1", "rotor 2"),
          colours.ROTORS, (-1.0, 1.0), lambda robot: robot.max_rotor_speed),
    Chart("rotor torques [N m]", ("torque_1", "torque_2"), ("rotor 1", "rotor 2"),
          colours.ROTORS, (-0.625, 0.625), lambda robot: robot.full_torque),
    Chart("momentum about the contact point, world [N m s]",
          ("momentum_x", "momentum_y", "momentum_z"), ("x", "y", "z"),
          colours.SERIES[:3], (-0.25, 0.25), rotor_momentum,
          disturbances=True),
    Chart("value of the control problem: time to go [s]", ("to_go",), ("time to go",),
          (colours.BLUE,), (0.0, 2.0)),
    Chart("value of the control problem, log10", ("cost",), ("value",), (colours.BLUE,),
          (0.0, 2.0), logarithmic=True),
    Chart("solve time [ms]", ("solve_ms",), ("solve",), (colours.INK,), (0.0, 1.0)),
)


class Plots:
    """Plots in a separate panel of the page."""

    def __init__(self, server: viser.ViserServer) -> None:
        self._gui = server.gui
        panel = server.gui.add_panel()
        self._tab = panel.add_tab("Plots", viser.Icon.CHART_LINE)
        panel.dock_left()
        panel.set_width(360)
        self._drawn: dict[Chart, viser.GuiUplotHandle] = {}
        self._ranges: dict[Chart, Range] = {}

    def show(self, history: History, robot: RobotParameters) -> None:
        """Draw the history of a robot; plots without any value are hidden."""
        series = history.series()
        times = series["time"]
        for order, chart in enumerate(CHARTS):
            lines = [_drawable(series[name], chart) for name in chart.names]
            has_values = len(times) >= 2 and any(_is_shown(line, chart) for line in lines)
            unit = chart.unit(robot)
            wanted = axis_range(lines, (chart.least[0] * unit, chart.least[1] * unit))
            handle = self._drawn.get(chart)
            if handle is None:
                # Created only with values: a plot that is created hidden keeps a width of 0.
                if has_values:
                    with self._tab:
                        self._ranges[chart] = wanted
                        self._drawn[chart] = self._add(chart, order, (times, *lines))
                continue
            if has_values:
                if wanted != self._ranges[chart]:
                    self._ranges[chart] = wanted
                    handle.scales = _scales(wanted)
                handle.data = (times, *lines)
            if handle.visible != has_values:
                handle.visible = has_values

    def _add(self, chart: Chart, order: int, data: tuple[Vector, ...]) -> viser.GuiUplotHandle:
        lines = tuple(
            uplot.Series(label=label, stroke=css(colour), width=2)
            for label, colour in zip(chart.labels, chart.colours, strict=True)
        )
        return self._gui.add_uplot(
            data=data,
            series=(uplot.Series(label="t [s]"), *lines),
            title=chart.title, scales=_scales(self._ranges[chart]), height=_HEIGHT, order=order,
            axes=(
                uplot.Axis(size=22, gap=2, ticks=_TICKS),
                uplot.Axis(size=44, gap=2, space=_LABEL_SPACING, ticks=_TICKS),
            ),
            padding=(12, 8, 0, 0),
            # Values under the mouse pointer would need another line in each plot.
            legend=uplot.Legend(show=len(chart.names) > 1, live=False),
        )


def axis_range(lines: Sequence[Vector], least: Range) -> Range:
    """Return the range of a vertical axis: `least`, extended in steps to all values but nan."""
    known = np.concatenate([line[np.isfinite(line)] for line in lines])
    low, high = min((least[0], *known)), max((least[1], *known))
    # With steps of half a power of ten the axis does not change with each sample.
    step = 10.0 ** np.floor(np.log10(high - low)) / 2.0
    low, high = np.floor(low / step + _OVERSHOOT), np.ceil(high / step - _OVERSHOOT)
    return float(step * low), float(step * high)


def _scales(vertical: Range) -> dict[str, uplot.Scale]:
    return {"x": uplot.Scale(time=False), "y": uplot.Scale(range=vertical)}


def _is_shown(values: Vector, chart: Chart) -> bool:
    """Return whether there is a value to draw."""
    known = values[np.isfinite(values)]
    return bool(known.any() if chart.disturbances else known.size)


def _drawable(values: Vector, chart: Chart) -> Vector:
    """Return the values to draw; logarithms, as a logarithmic axis has too many grid lines."""
    if not chart.logarithmic:
        return values
    positive = np.where(values > 0.0, values, np.nan)
    return np.log10(np.maximum(positive, _SMALLEST))
