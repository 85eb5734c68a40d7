# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Command lines of Python children, which never import from the working directory.

With ``-m`` and ``-c`` Python looks for modules in the working directory first, so that a file
``random.py`` beside a bag would be executed. Its option ``-P`` prevents that, but Python 3.10 does
not have it, so the program of a child sets its path before it imports anything else.
"""

import os
import sys


def module_command(module: str, *arguments: str) -> list[str]:
    """Return the command line that calls ``main(arguments)`` of a module in a child process.

    The child is of the same Python and imports from where this process does, and nowhere else.
    """
    program = f"from {module} import main; sys.exit(main(sys.argv[1:]))"
    return python_command(program, *arguments)


def python_command(program: str, *arguments: str, python: str | None = None) -> list[str]:
    """Return the command line of a program of Python as a child process.

    Parameters
    ----------
    program : str
        Source text, for which `sys` is imported.
    *arguments : str
        ``sys.argv[1:]`` of the program.
    python : str, optional
        Another Python, which imports from its own path. By default the child is of the same
        Python and imports from where this process does.
    """
    path = repr([os.path.abspath(entry) for entry in sys.path if entry])
    if python is not None:
        path = "[entry for entry in sys.path if entry]"  # '' is the working directory
    return [python or sys.executable, "-c", f"import sys; sys.path[:] = {path}; {program}",
            *arguments]
