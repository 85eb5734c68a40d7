# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Tables for docs/faults.md from the files of ``sphere_nmpc faults``.

    python bench/documents/fault_tables.py out/rolling.json out/contact.json

Trials of the same plant are taken together; each plant has its columns.
"""

import argparse
import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

_AT_ONCE = ("one fault", "two faults", "three faults")

Trial = dict[str, Any]


def main() -> None:
    """Print a table of single faults, and one of all trials by the number of faults."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("files", type=Path, nargs="+")
    plants: dict[str, list[Trial]] = {}
    for file in parser.parse_args().files:
        content = json.loads(file.read_text(encoding="utf-8"))
        plants.setdefault(content["campaign"]["plant"], []).extend(content["trials"])
    for lines in (singles(plants), summary(plants)):
        print("\n".join(lines), end="\n\n")


def singles(plants: dict[str, list[Trial]]) -> Iterator[str]:
    """Yield the lines of the table of single faults."""
    columns = "survived | recovery, median [s] | longest [s]"
    yield "| fault | " + " | ".join(f"`{plant}`: {columns}" for plant in plants) + " |"
    yield "|---" * (1 + 3 * len(plants)) + "|"
    every = [trial["fault"] for trials in plants.values() for trial in trials]
    for fault in dict.fromkeys(name for name in every if "+" not in name):
        cells = [f"`{fault}`"]
        for trials in plants.values():
            tried = [trial for trial in trials if trial["fault"] == fault]
            cells += [_survived(tried), *_recoveries(tried, 50, 100)]
        yield "| " + " | ".join(cells) + " |"


def summary(plants: dict[str, list[Trial]]) -> Iterator[str]:
    """Yield the lines of the table of all trials."""
    yield (
        "| plant | at once | survived | recovery, median [s] | 90 % [s] | longest [s] "
        "| speed [rad/s] | slew [rad/s²] |"
    )
    yield "|---" * 8 + "|"
    for plant, trials in plants.items():
        for number, name in enumerate(_AT_ONCE):
            tried = [trial for trial in trials if trial["fault"].count("+") == number]
            if tried:
                worst = [max(t[key] for t in tried) for key in ("worst_speed", "worst_slew")]
                cells = (
                    f"`{plant}`", name, _survived(tried), *_recoveries(tried, 50, 90, 100),
                    *(f"{value:.2f}" for value in worst),
                )
                yield "| " + " | ".join(cells) + " |"


def _survived(trials: list[Trial]) -> str:
    return f"{sum(not trial['complaints'] for trial in trials)} of {len(trials)}"


def _recoveries(trials: Iterable[Trial], *shares: float) -> list[str]:
    """Return percentiles of the recovery [s]."""
    times = [trial["recovery"] for trial in trials if trial["recovery"] is not None]
    return [f"{np.percentile(times, share):.1f}" if times else "-" for share in shares]


if __name__ == "__main__":
    main()
