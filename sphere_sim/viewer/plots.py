# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The charts beside the scene."""

from dataclasses import dataclass

import numpy as np
import viser
from viser import uplot

from sphere_nmpc.model.state import Vector
from sphere_sim.viewer import colours
from sphere_sim.viewer.colours import Colour, css
from sphere_sim.viewer.history import History, filled

_SMALLEST = 1e-9
"""Least value of which the logarithm is drawn."""
_HEIGHT = 104
"""[px]."""


@dataclass(frozen=True)
class Chart:
    """What one chart shows: names of the series in the history, their labels and colours."""

    title: str
    names: tuple[str, ...]
    labels: tuple[str, ...]
    colours: tuple[Colour, ...]
    logarithmic: bool = False


CHARTS = (
    Chart("error, log10: distance [m], angle [rad]", ("distance", "angle"),
          ("distance", "angle"), (colours.BLUE, colours.VERMILION), logarithmic=True),
    Chart("rotor speeds [rad/s]", ("speed_1", "speed_2"), ("rotor 1", "rotor 2"),
          colours.ROTORS),
    Chart("rotor torques [N m]", ("torque_1", "torque_2"), ("rotor 1", "rotor 2"),
          colours.ROTORS),
    Chart("value of the control problem, log10", ("cost",), ("value",), (colours.BLUE,),
          logarithmic=True),
    Chart("solve time [ms]", ("solve_ms",), ("solve",), (colours.INK,)),
)


class Plots:
    """Charts in a panel of their own.

    Parameters
    ----------
    server : viser.ViserServer
        Whose page it is.
    """

    def __init__(self, server: viser.ViserServer) -> None:
        self._gui = server.gui
        panel = server.gui.add_panel()
        self._tab = panel.add_tab("Plots", viser.Icon.CHART_LINE)
        panel.dock_left()
        panel.set_width(360)
        self._drawn: dict[Chart, viser.GuiUplotHandle] = {}

    def show(self, history: History) -> None:
        """Draw what the history holds; a chart comes up when there is something for it."""
        series = history.series()
        times = series["time"]
        for order, chart in enumerate(CHARTS):
            lines = [filled(_drawable(series[name], chart)) for name in chart.names]
            if len(times) < 2 or not all(np.all(np.isfinite(line)) for line in lines):
                continue
            if chart in self._drawn:
                self._drawn[chart].data = (times, *lines)
            else:
                # Not before: a chart that is made while it is hidden keeps a width of nothing.
                with self._tab:
                    self._drawn[chart] = _add(self._gui, chart, order, (times, *lines))


def _add(
    gui: viser.GuiApi, chart: Chart, order: int, data: tuple[Vector, ...]
) -> viser.GuiUplotHandle:
    lines = tuple(
        uplot.Series(label=label, stroke=css(colour), width=2)
        for label, colour in zip(chart.labels, chart.colours, strict=True)
    )
    return gui.add_uplot(
        data=data,
        series=(uplot.Series(label="t [s]"), *lines),
        title=chart.title, scales={"x": uplot.Scale(time=False)}, height=_HEIGHT, order=order,
        padding=(12, 8, 0, 0),
        # Values under the mouse would take a line more of each chart.
        legend=uplot.Legend(show=len(chart.names) > 1, live=False),
    )


def _drawable(values: Vector, chart: Chart) -> Vector:
    """Return what a chart draws: a logarithm of its own, as its axis would be black with lines."""
    if not chart.logarithmic:
        return values
    positive = np.where(values > 0.0, values, np.nan)
    return np.log10(np.maximum(positive, _SMALLEST))
