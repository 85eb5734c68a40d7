# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Notebooks: their cells, what these have printed, and a run of the code without Jupyter.

The code is plain Python that prints and draws, so that it runs as a kernel would run it: cell
after cell, in one namespace.
"""

import contextlib
import io
import json
import linecache
import subprocess
import traceback
from decimal import Decimal
from pathlib import Path
from typing import Any

from documented_examples import NUMBER, forms
from patience import PATIENCE

from sphere_nmpc.process.child import module_command

SHARE = 0.05
"""Difference of two numbers that processors may make [of the number]; their order of rounding
changes the last digits of a solution, and those decide on which side of a threshold it is."""


def code_cells(path: Path) -> list[dict[str, Any]]:
    """Return the code cells of a notebook."""
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    return [cell for cell in cells if cell["cell_type"] == "code"]


def text_of(lines: str | list[str]) -> str:
    """Return a text, which notebooks have as one or by lines."""
    return "".join(lines)


def printed_by(cell: dict[str, Any]) -> str:
    """Return what a cell has printed, by its outputs."""
    streams = [output for output in cell["outputs"] if output["output_type"] == "stream"]
    return "".join(text_of(output["text"]) for output in streams)


def run_notebook(path: Path) -> subprocess.CompletedProcess[str]:
    """Run the code of a notebook in a new process, which writes what each cell prints as JSON.

    Where a cell fails, the error output ends with its number, line and error.
    """
    command = module_command("notebook_cells", str(path))
    return subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)


def main(arguments: list[str]) -> int:
    """Run the cells of the notebook that is named; return 1 where one fails."""
    (path,) = map(Path, arguments)
    namespace: dict[str, Any] = {"__name__": "__main__"}
    outputs = []
    for number, cell in enumerate(code_cells(path), 1):
        source, name = text_of(cell["source"]), f"{path.name}, cell {number}"
        # For the traceback.
        linecache.cache[name] = len(source), None, source.splitlines(keepends=True), name
        try:
            with contextlib.redirect_stdout(io.StringIO()) as output:
                exec(compile(source, name, "exec"), namespace)
        except Exception:
            traceback.print_exc()
            return 1
        outputs.append(output.getvalue())
    print(json.dumps(outputs))
    return 0


def agree(told: str, printed: str) -> bool:
    """Return whether two outputs have the same words and, nearly, the same numbers."""
    if forms(told) != forms(printed):
        return False
    numbers = [[Decimal(found[0]) for found in NUMBER.finditer(text)] for text in (told, printed)]
    return len(numbers[0]) == len(numbers[1]) and all(map(_are_near, *numbers))


def _are_near(told: Decimal, printed: Decimal) -> bool:
    """Return whether a number is within a share, or a unit of the last place, of the told one."""
    place = Decimal(1).scaleb(int(told.as_tuple().exponent))
    return abs(told - printed) <= max(place, Decimal(SHARE) * abs(told))
