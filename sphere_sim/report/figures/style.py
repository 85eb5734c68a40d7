# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Common style of the figures, and their files.

Curves differ in their dashes besides their colours, for print without colour.
"""

import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import matplotlib as mpl
from cycler import cycler
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sphere_sim.output import colours
from sphere_sim.output.colours import css
from sphere_sim.output.files import write_atomically

BLUE, VERMILION, SKY, BLACK, GREY = (
    *map(css, (colours.BLUE, colours.VERMILION, colours.SKY)), "#000000", "#777777",
)
COLOURS, ROTORS = tuple(map(css, colours.SERIES)), tuple(map(css, colours.ROTORS))
PATH, GOAL, GAMMA, TRACE = (
    css(colour) for colour in (colours.PATH, colours.GOAL, colours.GAMMA, colours.TRACE)
)
DISTANCE, ANGLE = map(css, (colours.DISTANCE, colours.ANGLE))
WALL = "#b4bcc4"
DASHES = ("-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)), (0, (8, 2)), (0, (1, 1)))
WIDTH = 10.0
"""Width of all figures of a run [inch]."""
FORMATS = ("png", "svg")
SMALLEST_ERROR = 1e-7
"""Smallest error on a logarithmic axis [mixed units]."""

_STYLE = {
    "axes.axisbelow": True,
    "axes.grid": True,
    "axes.prop_cycle": cycler(color=COLOURS),
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlelocation": "left",
    "axes.titlesize": 10.0,
    "axes.labelsize": 9.5,
    "figure.dpi": 100.0,
    "font.size": 9.5,
    "grid.alpha": 0.35,
    "grid.linewidth": 0.6,
    "legend.fontsize": 8.5,
    "legend.framealpha": 0.85,
    "legend.edgecolor": "none",
    "lines.linewidth": 1.6,
    "mathtext.fontset": "dejavusans",
    "savefig.dpi": 150.0,
    # A fixed salt gives equal files for equal figures.
    "svg.hashsalt": "sphere_nmpc",
}


def literal(text: str) -> str:
    """Return a text so that Matplotlib draws it as it is, and never as a formula."""
    return text.replace("$", r"\$")


@contextmanager
def styled() -> Iterator[None]:
    """Set the style of the project in this context, independent of the user's settings."""
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(_STYLE)
        yield


def save(figure: Figure, folder: Path, name: str) -> list[Path]:
    """Save a figure as `name` in a folder in all formats, and return its files."""
    files = [folder / f"{name}.{kind}" for kind in FORMATS]
    for kind, file in zip(FORMATS, files, strict=True):
        dated, drawn = {"Date": None} if kind == "svg" else {}, io.BytesIO()
        with styled():
            figure.savefig(drawn, format=kind, metadata=dated)
        # The layout is equal in all formats; its computation takes as long as drawing.
        figure.set_layout_engine("none")
        write_atomically(file, drawn.getvalue())
    return files


def from_start(axes: Axes, end: float) -> None:
    """Let the axis of time reach from 0 to the end of a run [s], which may have one pose."""
    axes.set_xlim(0.0, max(float(end), 1e-3))


def legend_above(axes: Axes) -> None:
    """Add the legend of a panel beside its title, where it covers no curve."""
    number = len(axes.get_legend_handles_labels()[0])
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=number, borderaxespad=0.1,
                handlelength=1.6, columnspacing=1.0)


def label(axes: Axes, horizontal: str, vertical: str, title: str | None = None) -> None:
    """Name the axes of a panel, which keeps its title where none is given."""
    axes.set_xlabel(horizontal)
    axes.set_ylabel(vertical)
    if title is not None:
        axes.set_title(title)


def label_over_time(axes: Axes, end: float, vertical: str, title: str | None = None) -> None:
    """Name the axes of curves from 0 to the end of a run [s], and add their legend."""
    label(axes, "time [s]", vertical, title)
    from_start(axes, end)
    legend_above(axes)


def draw_limits(axes: Axes, limit: float) -> None:
    """Draw the limits on both sides of zero."""
    for side in (-limit, limit):
        axes.axhline(side, color=GREY, linewidth=1.0, linestyle=":")


def mark_missing(axes: Axes, what: str) -> None:
    """Mark a panel whose data the bag does not have."""
    axes.text(
        0.5, 0.5, f"no {what} in this bag", transform=axes.transAxes, color=GREY,
        ha="center", va="center",
    )
    axes.set_xticks([])
    axes.set_yticks([])
