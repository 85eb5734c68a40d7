# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""How all figures look, and how they are saved.

The colours are those of Okabe and Ito, which people with any colour vision can tell apart; lines
differ in their dashes as well, for print without colour.
"""

import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import matplotlib as mpl
from cycler import cycler
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sphere_sim.output.atomic_write import write_atomically

BLUE, VERMILION, GREEN, PURPLE = "#0072B2", "#D55E00", "#009E73", "#CC79A7"
ORANGE, SKY, YELLOW, BLACK, GREY = "#E69F00", "#56B4E9", "#F0E442", "#000000", "#777777"
COLOURS = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY, BLACK)
DASHES = ("-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)), (0, (8, 2)), (0, (1, 1)))
FORMATS = ("png", "svg")

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
    # Labels stay text in the file's own glyphs, and two equal figures are equal files.
    "svg.hashsalt": "sphere_nmpc",
}


@contextmanager
def styled() -> Iterator[None]:
    """Draw and save figures in the project's style, whatever the user's own settings are."""
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(_STYLE)
        yield


def save(figure: Figure, folder: Path, name: str) -> list[Path]:
    """Save a figure in all formats and return the files.

    Parameters
    ----------
    figure : Figure
        What to save.
    folder : Path
        Where to; must exist.
    name : str
        File name without its ending.

    Raises
    ------
    OSError
        Naming the file that cannot be written.
    """
    files = [folder / f"{name}.{kind}" for kind in FORMATS]
    for kind, file in zip(FORMATS, files, strict=True):
        dated, drawn = {"Date": None} if kind == "svg" else {}, io.BytesIO()
        with styled():
            figure.savefig(drawn, format=kind, metadata=dated)
        # The same in all formats, and found once: it takes as long as drawing.
        figure.set_layout_engine("none")
        write_atomically(file, drawn.getvalue())
    return files


def say_missing(axes: Axes, what: str) -> None:
    """Fill a panel with the news that the bag has nothing for it."""
    axes.text(
        0.5, 0.5, f"no {what} in this bag", transform=axes.transAxes, color=GREY,
        ha="center", va="center",
    )
    axes.set_xticks([])
    axes.set_yticks([])
