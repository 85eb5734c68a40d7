# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Figure of docs/results.md: position errors over the way, by the odometry and by other methods.

    python bench/odometry.py --parts drift others --json out/drives.json
    python bench/documents/odometry_figure.py out/drives.json --out docs/odometry.png
"""

import argparse
import json
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from sphere_sim.report.figures.style import COLOURS, DASHES, styled


def main() -> None:
    """Write the figure."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("measured", type=Path, help="file of bench/odometry.py")
    parser.add_argument("--out", type=Path, default=Path("docs/odometry.png"))
    arguments = parser.parse_args()
    plants = json.loads(arguments.measured.read_text())["drift"]
    with styled():
        figure = Figure(figsize=(8.6, 3.3), layout="constrained")
        for axes, (plant, methods) in zip(
            figure.subplots(1, 2, sharey=True), plants.items(), strict=True
        ):
            curves = [one for one in methods.items() if "over_way_m" in one[1]]
            for (name, found), colour, dash in zip(curves, COLOURS, DASHES, strict=False):
                # At the start all errors are 0, which a logarithmic axis does not have.
                way, error = (np.array(found[key][1:]) for key in ("way_m", "over_way_m"))
                axes.semilogy(way, 1e3 * error, color=colour, linestyle=dash, label=name)
            axes.set_title(plant)
            axes.set_xlabel("way [m]")
        figure.axes[0].set_ylabel("median position error [mm]")
        figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside right")
        figure.savefig(arguments.out, dpi=80.0)


if __name__ == "__main__":
    main()
