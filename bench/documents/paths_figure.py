# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Figure of docs/results.md: paths, tracks of the sphere along them, and their deviations.

    python bench/paths.py --kinds circle eight s+0.50 --starts 1 --json out/paths.json
    python bench/documents/paths_figure.py out/paths.json --out docs/paths.png
"""

import argparse
import json
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from sphere_sim.report.figures.style import GREY, PATH, styled


def main() -> None:
    """Write the figure."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("measured", type=Path, help="file of bench/paths.py")
    parser.add_argument("--out", type=Path, default=Path("docs/paths.png"))
    arguments = parser.parse_args()
    rows = json.loads(arguments.measured.read_text())["rows"]
    drawn = [row for row in rows if "track" in row]
    with styled():
        figure = Figure(figsize=(3.0 * len(drawn), 4.6), layout="constrained")
        above, below = figure.subplots(2, len(drawn), squeeze=False, height_ratios=(3.0, 2.0))
        for row, plane, error in zip(drawn, above, below, strict=True):
            plane.plot(*np.transpose(row["path"]), color=GREY, linewidth=4.0, label="path")
            plane.plot(*np.transpose(row["track"]), color=PATH, linewidth=1.0, label="centre")
            plane.set(aspect="equal", title=row["kind"], xlabel="x [m]")
            error.plot(row["way"], 1e3 * np.array(row["away"]), color=PATH)
            error.set(xlabel="way [m]", ylim=(0.0, None))
        above[0].set_ylabel("y [m]")
        below[0].set_ylabel("deviation [mm]")
        figure.legend(*above[0].get_legend_handles_labels(), loc="outside right")
        figure.savefig(arguments.out, dpi=80.0)


if __name__ == "__main__":
    main()
