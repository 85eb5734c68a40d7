# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Display of newest values: a picture in place on a terminal, otherwise a line now and then."""

import math
import time
from collections.abc import Callable
from typing import TypeVar

from rich.console import Console, RenderableType
from rich.live import Live

Display = TypeVar("Display", bound="LiveDisplay")
_PICTURE_EVERY = 0.05
"""Wall time between two pictures on a terminal [s]."""
_LINE_EVERY = 2.0
"""Wall time between two lines where there is no terminal [s]."""


class LiveDisplay:
    """Display that is updated in place on a terminal; a context manager."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._live = Live(console=console, auto_refresh=False) if console.is_terminal else None
        self._shown_at = -math.inf

    def __enter__(self: Display) -> Display:
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(self, *exception: object) -> None:
        if self._live is not None:
            self._live.stop()

    def show(
        self, picture: Callable[[], RenderableType], line: Callable[[], str], last: bool = False
    ) -> None:
        """Show a picture, or a line, if one is due, or it is the last one."""
        every = _LINE_EVERY if self._live is None else _PICTURE_EVERY
        if not last and time.monotonic() < self._shown_at + every:
            return
        self._shown_at = time.monotonic()
        if self._live is not None:
            self._live.update(picture(), refresh=True)
        else:
            self._console.print(line(), markup=False, highlight=False, soft_wrap=True)
