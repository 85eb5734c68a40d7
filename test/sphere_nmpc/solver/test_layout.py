# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
import ctypes
import subprocess

import numpy as np
import pytest

from sphere_nmpc.solver.native import layout, library, memory
from sphere_nmpc.solver.native.compiler import CompilerError, compilers
from sphere_nmpc.solver.native.layout import FIELDS, SIZE, WORD, index, problem_header


def structure_in_c(tmp_path):
    """Return size and offsets [bytes] of the structure as the C compiler lays it out."""
    try:
        command = compilers()[0]
    except CompilerError:
        pytest.skip("needs a C compiler")
    lines = [f'    printf("%zu\\n", offsetof(problem, {field.name}));' for field in FIELDS]
    program = "\n".join(
        (
            "#include <stddef.h>\n#include <stdint.h>\n#include <stdio.h>",
            problem_header(),
            'int main(void)\n{\n    printf("%zu\\n", sizeof(problem));',
            *lines,
            "}",
        )
    )
    (tmp_path / "layout.c").write_text(program)
    subprocess.run([*command, tmp_path / "layout.c", "-o", tmp_path / "layout"], check=True)
    done = subprocess.run([tmp_path / "layout"], capture_output=True, check=True)
    return [int(number) for number in done.stdout.split()]


def test_python_reads_each_field_where_the_compiler_puts_it(tmp_path):
    size, *offsets = structure_in_c(tmp_path)
    assert size == WORD * SIZE
    assert offsets == [WORD * index(field.name) for field in FIELDS]


def test_structure_of_another_size_does_not_compile(tmp_path, monkeypatch):
    (tmp_path / "changed").mkdir()
    structure_in_c(tmp_path)
    monkeypatch.setattr(layout, "SIZE", SIZE + 1)
    with pytest.raises(subprocess.CalledProcessError):
        structure_in_c(tmp_path / "changed")


def test_binary_of_another_layout_is_not_loaded(monkeypatch):
    """Its name is another one, even where both have the same size."""
    now = library._content_key(library.c_sources())
    monkeypatch.setattr(layout, "FIELDS", (FIELDS[1], FIELDS[0], *FIELDS[2:]))
    assert library._content_key(library.c_sources()) != now


def test_slot_writes_each_value_to_its_own_field(make_problem):
    problem = make_problem("stages and slew", max_step=0.07)
    slot = memory.Slot(problem.intervals)
    slot.write(problem, np.zeros((problem.intervals, 2)), 0.25)
    words = np.ctypeslib.as_array((ctypes.c_double * SIZE).from_address(slot.address))
    for field in FIELDS:
        if field.c_type == "double" and hasattr(problem, field.name):
            given = np.atleast_1d(getattr(problem, field.name))
            assert np.array_equal(words[layout.span(field.name)], given), field.name
    assert words[index("time_budget")] == 0.25
