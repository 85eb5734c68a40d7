# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Figures that are only added to results: one that cannot be drawn does not fail the command."""

import logging
from collections.abc import Callable

from sphere_sim.output.error_text import in_words

_log = logging.getLogger("sphere_nmpc")


def draw_or_warn(verb: str, what: str, draw: Callable[[], object]) -> bool:
    """Draw a figure; log a warning of one line where any error prevents it.

    Parameters
    ----------
    verb : str
        Verb of the ``sphere_nmpc`` command that draws, for the message.
    what : str
        File or files of the figure, for the message.
    draw : callable
        Draws and writes the figure.

    Returns
    -------
    bool
        Whether the figure was written.
    """
    try:
        draw()
    except Exception as error:  # any error of the plotting library; the numbers are written
        _log.warning("sphere_nmpc %s: %s not drawn: %s", verb, what, in_words(error))
        return False
    return True
