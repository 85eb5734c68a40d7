# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Control panel: texts, and widgets from which requests are taken.

Buttons call back on the thread of the server; the callbacks only put requests into a queue. What
other programs have written is escaped in HTML, and plain text everywhere else on the page. It is
never part of Markdown, which has links, images and HTML.
"""

import html
import math
import queue
import time
from collections.abc import Callable
from typing import Any

import viser

from sphere_sim.output import colours
from sphere_sim.output.round_numbers import round_down
from sphere_sim.viewer import source
from sphere_sim.viewer.goal import GOAL_PRESETS
from sphere_sim.viewer.source import Capabilities, Frame, PageRequest

_PICK = "pick a goal …"
_ON_THE_WAY: dict[str, source.Enable | source.Cancel] = {
    "Stop": source.Enable(False), "Continue": source.Enable(True), "Cancel": source.Cancel(),
}
"""Requests of the buttons that concern the way to the goal."""
_SEEK_HOLD = 0.7
"""Time for which a slider that a user has moved is not updated [s]."""
_LEGEND = """
- **blue panels**: the sphere; translucent, so that the rotors are visible
- **orange disc**: rotor 1, about body x; **green disc**: rotor 2, about body y; drawn turning ten
  times slower than they do. Caps of the same colours: ends of their axes; black: body z
- **red-orange circle**: Γ, the circle through the rotors
- **black line** on the shell: past contact points
- **blue line**: path; **light blue**: predicted plan with its knots
- **pink sphere**: the goal; **pink line**: the path to follow
{estimate}- **floor**: a line every {cell:g} m{walls}
"""
_NUMBERS = "padding:0 12px 10px;font-size:14px;line-height:1.55;overflow-wrap:anywhere"
_SETUP = "padding-top:6px;font-size:12px;line-height:1.4;color:#666"
_STATUS = "padding:6px 10px;margin:6px 0;border-radius:4px;color:white;font-weight:600"


class Choice:
    """Value of a widget, from which each change by a user makes one request.

    The server sets the value on a thread of its own as soon as a page sends one. A value that
    differs from what the program has set is therefore a user's: it is not overwritten before it
    has been taken.

    `make` returns the request for a value; None if the value is invalid.
    """

    def __init__(self, handle: Any, make: Callable[[Any], PageRequest | None]) -> None:
        self.handle = handle
        """The widget."""
        self._make = make
        self._known = handle.value

    def take(self) -> PageRequest | None:
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


class ControlPanel:
    """Widgets of the panel, each visible while the source can fulfil its request.

    The source is `live`, or a recording.
    """

    def __init__(self, server: viser.ViserServer, live: bool) -> None:
        self._requests: queue.SimpleQueue[PageRequest] = queue.SimpleQueue()
        self.put = self._requests.put
        """Adds a request to the queue, from any thread."""
        gui = server.gui
        self._status = gui.add_html("")
        self._numbers = gui.add_html("")
        self._live = live
        with gui.add_folder("Goal", visible=live):
            gui.add_markdown("Drag the arrows, turn the rings, or pick:")
            self._preset = Choice(
                gui.add_dropdown("goal", (_PICK, *GOAL_PRESETS), initial_value=_PICK),
                lambda name: source.ChooseGoal(name) if name in GOAL_PRESETS else None,
            )
            self.at_once = gui.add_checkbox(
                "send at once", True, hint="Send a goal when the mouse is released, or only with "
                "the button"
            )
            send = gui.add_button("Send goal", icon=viser.Icon.TARGET_ARROW)
            self.clickable = gui.add_checkbox(
                "point by click", False, hint="A click on the floor sends that position as a "
                "goal, with any orientation; dragging still turns the view"
            )
            self.drawable = gui.add_checkbox(
                "draw a path", False, hint="A path drawn on the floor with the mouse is sent when "
                "it is released; dragging does not turn the view meanwhile"
            )
            self._way = gui.add_button_group(
                "on the way", tuple(_ON_THE_WAY), visible=False,
                hint="Stop keeps the goal; Cancel stops, without a goal from then on",
            )
        with gui.add_folder("Time" if live else "Recording"):
            # Two buttons, so that a click has the meaning of the label that the user read.
            self._pause = gui.add_button("Pause")
            self._resume = gui.add_button("Resume" if live else "Play", visible=False)
            self._seek = Choice(
                gui.add_slider("time [s]", 0.0, 1.0, 1e-3, 0.0, visible=False), self._seek_to
            )
            self._speed = Choice(
                gui.add_number("speed", 1.0, min=0.0, max=1000.0, step=0.1),
                lambda factor: source.SetSpeed(factor) if math.isfinite(factor) else None,
            )
            self._reset = gui.add_button("Reset", hint="Return to the start")
        with gui.add_folder("Disturbance", visible=False) as self._disturbance:
            self._impulse = gui.add_number("impulse [N s]", 0.0, min=0.0)
            self._impulse_step = 0.0
            self._direction = gui.add_number(
                "direction [°]", 0.0, min=-360.0, max=360.0, step=15.0,
                hint="From the x axis; 90 is along the y axis",
            )
            push = gui.add_button("Push")
        with gui.add_folder("Strategy", visible=live):
            self._strategy = Choice(
                gui.add_dropdown("strategy", ("-",), initial_value="-"), self._choose_strategy
            )
        find = gui.add_button("Find the sphere", icon=viser.Icon.FOCUS_2)
        with gui.add_folder("Legend", expand_by_default=False):
            self._legend = gui.add_markdown("")
        self._sought_at = float("-inf")
        self._capabilities: Capabilities | None = None
        self._on_click(send, source.SendGoal)
        self._on_click(find, source.FindSphere)
        self._on_click(self._pause, lambda: source.Pause(True))
        self._on_click(self._resume, lambda: source.Pause(False))
        self._on_click(self._reset, source.Reset)
        self._on_click(push, self._make_push)
        self._on_click(self._way, lambda: _ON_THE_WAY.get(self._way.value))

    def take(self) -> list[PageRequest]:
        """Return the requests since the last call."""
        choices = (self._preset, self._seek, self._speed, self._strategy)
        taken = [request for choice in choices if (request := choice.take()) is not None]
        while not self._requests.empty():
            taken.append(self._requests.get())
        return taken

    def reset_preset(self) -> None:
        """Clear the selected goal preset, so that it can be selected again."""
        self._preset.show(_PICK)

    def show(self, frame: Frame, cell: float) -> None:
        """Show the newest frame and the spacing of the grid [m]; for a few times a second."""
        _set(self._status, "content", _status_bar(frame, self._live))
        _set(self._numbers, "content", _number_lines(frame))
        _set(self._legend, "content", _legend(frame, cell))
        self._offer_impulses(frame)
        capabilities = frame.capabilities
        if capabilities != self._capabilities:
            self._capabilities = capabilities
            self._show_capabilities(capabilities)
        if capabilities.speed is not None:
            self._speed.show(capabilities.speed)
        held = time.monotonic() <= self._sought_at + _SEEK_HOLD
        if capabilities.duration is not None and not held:
            self._seek.show(round(min(frame.time, capabilities.duration), 3))
        self._show_strategy(frame)

    def _show_capabilities(self, capabilities: Capabilities) -> None:
        for handle, visible in (
            (self._pause, capabilities.pause and not capabilities.paused),
            (self._resume, capabilities.pause and capabilities.paused),
            (self._reset, capabilities.reset),
            (self._way, capabilities.stop),
            (self._disturbance, capabilities.push),
            (self._speed.handle, capabilities.speed is not None),
            (self._seek.handle, capabilities.duration is not None),
        ):
            _set(handle, "visible", visible)
        if capabilities.duration is not None:
            _set(self._seek.handle, "max", max(capabilities.duration, 1e-3))

    def _offer_impulses(self, frame: Frame) -> None:
        """Offer impulses in proportion to what the rotors can take up; at first 0.5 N s."""
        # A push at the centre has the momentum of the impulse times the radius.
        step = round_down(0.0375 * source.rotor_momentum(frame.robot) / frame.radius)
        if step != self._impulse_step:
            self._impulse_step = step
            digits = max(0, -math.floor(math.log10(step)))
            for name, value in (("precision", digits), ("step", step), ("max", 200.0 * step),
                                ("value", 5.0 * step)):
                _set(self._impulse, name, value)

    def _show_strategy(self, frame: Frame) -> None:
        # A strategy that cannot be changed is shown as a list of one.
        options = frame.capabilities.strategies or ((frame.strategy or "-"),)
        self._strategy.offer(options)
        if frame.strategy in options:
            self._strategy.show(frame.strategy)
        _set(self._strategy.handle, "disabled", len(options) < 2)

    def _choose_strategy(self, name: str) -> source.SetStrategy | None:
        return source.SetStrategy(name) if name in self._strategy.handle.options else None

    def _seek_to(self, moment: float) -> source.Seek | None:
        self._sought_at = time.monotonic()
        return source.Seek(moment) if math.isfinite(moment) else None

    def _make_push(self) -> source.ApplyPush | None:
        impulse, direction = self._impulse.value, math.radians(self._direction.value)
        if not (math.isfinite(impulse) and math.isfinite(direction)):
            return None
        return source.ApplyPush((impulse * math.cos(direction), impulse * math.sin(direction)))

    def _on_click(self, button: Any, make: Callable[[], PageRequest | None]) -> None:
        # In the event loop: of several clicks each has the values of its own moment.
        async def click(_: viser.GuiEvent) -> None:
            request = make()
            if request is not None:
                self.put(request)

        button.on_click(click)


def _set(handle: Any, name: str, value: object) -> None:
    """Set a property if it differs; each assignment is sent to every page."""
    if getattr(handle, name) != value:
        setattr(handle, name, value)


def _legend(frame: Frame, cell: float) -> str:
    walls = "; **grey walls**: not to be touched" if frame.floor is not None else ""
    seen = "- **yellow sphere**: its pose as odometry estimates it\n"
    return _LEGEND.format(
        cell=cell, walls=walls, estimate="" if frame.estimate is None else seen
    )


def _status_bar(frame: Frame, live: bool) -> str:
    """Return the status bar as HTML: the alerts, or whether time is running."""
    if frame.alerts:
        colour, text = colours.VERMILION, "<br>".join(map(html.escape, frame.alerts))
    elif frame.capabilities.paused:
        colour, text = colours.INK, "paused" if live else "recording, stopped"
    else:
        colour, text = colours.BLUE, "recording, playing"
        if live:
            colour, text = colours.GREEN, "live"
    return f'<div style="{_STATUS};background:{colours.css(colour)}">{text}</div>'


def _number_lines(frame: Frame) -> str:
    """Return time, mode, errors, what is left of the way, and who drives what as HTML.

    There are always four lines, and one more on a floor that is not free everywhere, and with
    odometry: the widgets below must not move under the mouse pointer.
    """
    distance, left = "to the goal: –", "left: –"
    away, angle = source.errors_of(frame)
    if frame.goal is not None and math.isfinite(away):
        turn = f"<b>{math.degrees(angle):.2f}°</b>" if math.isfinite(angle) else ""
        parts = f"<b>{away:.3f} m</b>", turn, frame.goal.orientation.remark
        distance = f"to the goal: {', '.join(filter(None, parts))}"
    progress = frame.progress
    if math.isfinite(progress.time_left):
        left = f"left: <b>{progress.time_left:.1f} s</b>"
        if math.isfinite(progress.distance_left):
            left += f", <b>{progress.distance_left:.2f} m</b> of path"
    if math.isfinite(progress.deviation):
        left += f", <b>{1e3 * progress.deviation:.0f} mm</b> off it"
    if progress.count > 1:
        left += f"; goal <b>{progress.index + 1} of {progress.count}</b>"
    mode = html.escape(frame.mode or "no plan yet")
    lines = [f"t = <b>{frame.time:.2f} s</b>", mode, distance, left]
    if frame.floor is not None:
        clear = f"<b>{frame.clearance:.3f} m</b>" if math.isfinite(frame.clearance) else "–"
        lines.append(f"clearance of the plan {clear}")
    if frame.estimate is not None:
        away, angle = frame.estimate_error
        lines.append(
            f"odometry off by <b>{1e3 * away:.1f} mm</b>, <b>{math.degrees(angle):.2f}°</b>"
            if math.isfinite(away) else "odometry off by –"
        )
    setup = f'<div style="{_SETUP}">{html.escape(frame.setup)}</div>'
    return f'<div style="{_NUMBERS}">{"<br>".join(lines)}{setup}</div>'
