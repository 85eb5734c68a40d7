# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The control panel: what a user clicks becomes requests that are taken up later.

Callbacks of the page run on threads of the server; they only put requests into a queue.
"""

import html
import math
import queue
import time
from collections.abc import Callable
from typing import Any

import viser

from sphere_nmpc.model.state import angle_error, position_error
from sphere_sim.viewer import colours
from sphere_sim.viewer.colours import Colour, css
from sphere_sim.viewer.frame import (
    Frame,
    Offers,
    Pause,
    Push,
    Request,
    Reset,
    Seek,
    SetSpeed,
    SetStrategy,
)
from sphere_sim.viewer.presets import PRESETS

PICK = "pick a goal …"
_HAND_OFF = 0.7
"""How long after a user has moved the time slider it is left where it is [s]."""


class Controls:
    """Widgets in the panel, shown as far as the source of the frames offers what they ask for.

    Parameters
    ----------
    server : viser.ViserServer
        Whose page it is.
    live : bool
        Whether the source is live; else it is a recording.
    """

    def __init__(self, server: viser.ViserServer, live: bool) -> None:
        self._requests: queue.SimpleQueue[Request | str] = queue.SimpleQueue()
        gui = server.gui
        self._banner = gui.add_html("")
        self._numbers = gui.add_markdown("")
        self._live = live
        with gui.add_folder("Goal", visible=live):
            gui.add_markdown("Drag the arrows, turn the rings, or pick:")
            self._preset = gui.add_dropdown("goal", (PICK, *PRESETS), initial_value=PICK)
            self._at_once = gui.add_checkbox(
                "send at once", True, hint="Send a goal when it is let go of, or with the button"
            )
            send = gui.add_button("Send goal", icon=viser.Icon.TARGET_ARROW)
        with gui.add_folder("Time" if live else "Recording"):
            # Two, so that a click means what was read even if that is no longer so.
            self._pause = gui.add_button("Pause")
            self._resume = gui.add_button("Resume" if live else "Play", visible=False)
            self._seek = gui.add_slider("time [s]", 0.0, 1.0, 1e-3, 0.0, visible=False)
            self._speed = gui.add_number("speed", 1.0, min=0.0, max=1000.0, step=0.1)
            self._reset = gui.add_button("Reset", hint="Back to the start")
            self._push = gui.add_button("Push")
        with gui.add_folder("Strategy", visible=live) as self._strategy_folder:
            self._strategy = gui.add_dropdown("strategy", ("-",), initial_value="-")
        find = gui.add_button("Find the sphere", icon=viser.Icon.FOCUS_2)
        with gui.add_folder("Legend", expand_by_default=False):
            gui.add_markdown(_LEGEND)
        self._sought = float("-inf")
        self._offers: Offers | None = None
        self._on_click(send, lambda: "send")
        self._on_click(find, lambda: "find")
        self._on_click(self._pause, lambda: Pause(True))
        self._on_click(self._resume, lambda: Pause(False))
        self._on_click(self._reset, Reset)
        self._on_click(self._push, Push)
        self._on_choice(self._preset, lambda name: name if name in PRESETS else None)
        self._on_choice(self._speed, lambda f: SetSpeed(f) if math.isfinite(f) else None)
        self._on_choice(
            self._strategy, lambda it: SetStrategy(it) if it in self._strategy.options else None
        )
        self._on_choice(self._seek, self._seek_to)

    @property
    def sends_at_once(self) -> bool:
        """Whether a goal that is let go of is to be sent."""
        return bool(self._at_once.value)

    def put(self, request: Request | str) -> None:
        """Put a request where `take` finds it; from any thread."""
        self._requests.put(request)

    def take(self) -> list[Request | str]:
        """Return what users have asked for since the last call.

        A text is the name of a preset, a phase of a drag (start, update, end), send, or find.
        """
        taken: list[Request | str] = []
        while not self._requests.empty():
            taken.append(self._requests.get())
        return taken

    def picked(self) -> None:
        """Let the list of goals be ready for the same choice again."""
        _set(self._preset, "value", PICK)

    def show(self, frame: Frame) -> None:
        """Show how things are, in words; a few times a second will do."""
        _set(self._banner, "content", _banner(frame, self._live))
        _set(self._numbers, "content", _numbers(frame))
        offers = frame.offers
        if offers != self._offers:
            self._offers = offers
            self._show_offers(offers)
        if offers.duration is not None and time.monotonic() > self._sought + _HAND_OFF:
            _set(self._seek, "value", round(min(frame.time, offers.duration), 3))
        self._show_strategy(frame)

    def _show_offers(self, offers: Offers) -> None:
        for handle, there in (
            (self._pause, offers.pause and not offers.paused),
            (self._resume, offers.pause and offers.paused),
            (self._reset, offers.reset), (self._push, offers.push),
            (self._speed, offers.speed is not None), (self._seek, offers.duration is not None),
        ):
            _set(handle, "visible", there)
        if offers.speed is not None:
            _set(self._speed, "value", offers.speed)
        if offers.duration is not None:
            _set(self._seek, "max", max(offers.duration, 1e-3))

    def _show_strategy(self, frame: Frame) -> None:
        # One that cannot be changed is a list of one.
        options = frame.offers.strategies or ((frame.strategy or "-"),)
        if tuple(self._strategy.options) != options:
            self._strategy.options = options
        if frame.strategy in options:
            _set(self._strategy, "value", frame.strategy)
        _set(self._strategy, "disabled", len(options) < 2)

    def _seek_to(self, moment: float) -> Seek | None:
        self._sought = time.monotonic()
        return Seek(moment) if math.isfinite(moment) else None

    def _on_click(self, button: Any, make: Callable[[], Request | str]) -> None:
        button.on_click(lambda _: self.put(make()))

    def _on_choice(self, handle: Any, make: Callable[[Any], Request | str | None]) -> None:
        def choose(event: viser.GuiEvent) -> None:
            # What this program itself sets has no client.
            request = make(event.target.value) if event.client is not None else None
            if request is not None:
                self.put(request)

        handle.on_update(choose)


def _set(handle: Any, name: str, value: object) -> None:
    """Set a property if it differs; each setting is a message to every page."""
    if getattr(handle, name) != value:
        setattr(handle, name, value)


def _banner(frame: Frame, live: bool) -> str:
    if frame.alerts:
        return _box(colours.VERMILION, "<br>".join(map(html.escape, frame.alerts)))
    if frame.offers.paused:
        return _box(colours.INK, "time stands still" if live else "recording, stopped")
    return _box(colours.GREEN, "live") if live else _box(colours.BLUE, "recording, playing")


def _box(colour: Colour, text: str) -> str:
    style = "padding:6px 10px;margin:6px 0;border-radius:4px;color:white;font-weight:600"
    return f'<div style="{style};background:{css(colour)}">{text}</div>'


def _numbers(frame: Frame) -> str:
    """Return three lines whatever is known: what is below must not move under a mouse."""
    distance = "–"
    if frame.state is not None and frame.goal is not None:
        distance = (
            f"to the goal: **{position_error(frame.state, frame.goal):.3f} m**, "
            f"**{angle_error(frame.state, frame.goal):.3f} rad**"
        )
    return "  \n".join((f"t = **{frame.time:.2f} s**", frame.mode or "–", distance))


_LEGEND = """
- **blue panels**: the sphere; clear, so that the rotors show
- **orange disc**: rotor 1, about body x; **green disc**: rotor 2, about body y; drawn turning ten
  times slower than they do. Caps of the same colours: where their axes come out; black: body z
- **red-orange circle**: Γ, the circle through the rotors
- **black line** on the shell: where it has touched the ground
- **blue line**: path; **light blue**: predicted plan with its knots
- **pink ghost**: the goal
"""
