# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Notebooks in examples/ run, and have the outputs that their cells make."""

import json
import re

import pytest

pytest.importorskip("matplotlib")

from compiled_solver import compiled
from documented_examples import EXAMPLES
from notebook_cells import agree, code_cells, printed_by, run_notebook, text_of

NOTEBOOKS = sorted(EXAMPLES.glob("*.ipynb"))
LARGEST = 250_000
"""Size of a notebook with its pictures [bytes]; a clone and an installation have them."""

each_notebook = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)


def test_there_are_notebooks() -> None:
    assert len(NOTEBOOKS) == 3


@each_notebook
def test_notebook_is_valid_and_was_run_from_top_to_bottom(path) -> None:
    notebook = json.loads(path.read_text(encoding="utf-8"))
    assert path.stat().st_size <= LARGEST
    # Cells have ids from this version on.
    assert (notebook["nbformat"], notebook["nbformat_minor"]) == (4, 5)
    assert notebook["metadata"]["language_info"]["name"] == "python"
    cells = notebook["cells"]
    ids = [cell["id"] for cell in cells]
    assert len(set(ids)) == len(ids) and all(re.fullmatch(r"[\w-]{1,64}", one) for one in ids)
    keys = {"id", "cell_type", "metadata", "source"}
    for cell in cells:
        is_code = cell["cell_type"] == "code"
        assert is_code or cell["cell_type"] == "markdown"
        assert set(cell) == (keys | {"execution_count", "outputs"} if is_code else keys)
        assert cell["metadata"] == {}, "times of a run, with which no two runs are equal"
        assert text_of(cell["source"]).strip()
    counts = [cell["execution_count"] for cell in code_cells(path)]
    assert counts == list(range(1, len(counts) + 1))


@each_notebook
def test_targets_of_links_exist(path) -> None:
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    texts = [text_of(cell["source"]) for cell in cells if cell["cell_type"] == "markdown"]
    links = [link for text in texts for link in re.findall(r"\]\(([^)\s]+)\)", text)]
    # Others do not lead from an installation to a document.
    assert links and all((EXAMPLES / link).is_file() for link in links)


@each_notebook
def test_outputs_are_text_and_pictures_without_warnings(path) -> None:
    pictures = 0
    for cell in code_cells(path):
        for output in cell["outputs"]:
            if output["output_type"] == "display_data":
                assert "image/png" in output["data"]
                pictures += 1
            else:
                assert (output["output_type"], output["name"]) == ("stream", "stdout")
    assert pictures >= 4


@pytest.mark.slow
@each_notebook
def test_cells_run_in_a_new_process_and_print_what_the_notebook_has(path, monkeypatch) -> None:
    assert compiled(), "without it a notebook takes minutes"
    monkeypatch.setenv("MPLBACKEND", "Agg")
    done = run_notebook(path)
    assert done.returncode == 0, done.stderr
    cells, outputs = code_cells(path), json.loads(done.stdout)
    for number, (cell, printed) in enumerate(zip(cells, outputs, strict=True), 1):
        told = printed_by(cell)
        assert agree(told, printed), f"{path.name}, cell {number} has\n{told}and prints\n{printed}"


def test_failing_cell_is_named_with_its_line_and_error(tmp_path) -> None:
    cells = [
        {"cell_type": "markdown", "source": ["# Title"]},
        {"cell_type": "code", "source": ["speed = 1.0\n", "print(speed)"]},
        {"cell_type": "code", "source": "half = speed / 2\nprint(half / 0.0)"},
    ]
    path = tmp_path / "failing.ipynb"
    path.write_text(json.dumps({"cells": cells}), encoding="utf-8")
    done = run_notebook(path)
    assert done.returncode == 1 and not done.stdout
    assert '"failing.ipynb, cell 2", line 2' in done.stderr
    assert "print(half / 0.0)" in done.stderr
    assert done.stderr.rstrip().endswith("ZeroDivisionError: float division by zero")


@pytest.mark.parametrize(
    ("printed", "expected"),
    [
        ("N = 4: 12.5 s, 2.1e-04", True), ("N = 4: 12.1 s, 2.2e-04", True),
        ("N = 4: 10.0 s, 2.1e-04", False), ("N = 5: 12.5 s, 2.1e-04", True),
        ("N = 4: nan s, 2.1e-04", False), ("N = 4: 12.5 s, 2.1e-03", False),
        ("N = 4: 12.5 s", False), ("N = 4: 12.5 s, 2.1e-04\nN = 4: 12.5 s, 2.1e-04", False),
    ],
)
def test_outputs_agree_up_to_what_processors_differ_by(printed, expected) -> None:
    assert agree("N = 4: 12.5 s, 2.1e-04", printed) is expected
