# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Widget whose value users choose and the program updates."""

from collections.abc import Callable
from typing import Any

from sphere_sim.viewer.source import Request


class Choice:
    """Value of a widget, from which each change by a user makes one request.

    The server sets the value on a thread of its own as soon as a page sends one. A value that
    differs from what the program has set is therefore a user's: it is not overwritten before it
    has been taken.

    Parameters
    ----------
    handle : viser.GuiInputHandle
        The widget.
    make : callable
        Returns the request for a value; None if the value is invalid.
    """

    def __init__(self, handle: Any, make: Callable[[Any], Request | str | None]) -> None:
        self.handle = handle
        """The widget."""
        self._make = make
        self._known = handle.value

    def take(self) -> Request | str | None:
        """Return the request for a user's change since the last call; None without a valid one."""
        value = self.handle.value
        if value == self._known:
            return None
        request = self._make(value)
        if request is None:
            self.handle.value = self._known
        else:
            self._known = value
        return request

    def show(self, value: Any) -> None:
        """Set the value, unless a user's change has not been taken yet."""
        if self.handle.value == self._known:
            self._known = value
            self.handle.value = value

    def offer(self, options: tuple[str, ...]) -> None:
        """Set the options of a list; the first one is selected if the present one is not there."""
        if tuple(self.handle.options) == options:
            return
        before = self.handle.value
        self.handle.options = options
        if self.handle.value != before:
            self._known = self.handle.value
