# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Texts of the control panel: status bar, numbers and legend.

What other programs have written is escaped here, and plain text everywhere else on the page. It is
never part of Markdown, which has links, images and HTML.
"""

import html

from sphere_nmpc.model.state import angle_error, position_error
from sphere_sim.viewer import colours
from sphere_sim.viewer.colours import Colour, css
from sphere_sim.viewer.frame import Frame

_LEGEND = """
- **blue panels**: the sphere; translucent, so that the rotors are visible
- **orange disc**: rotor 1, about body x; **green disc**: rotor 2, about body y; drawn turning ten
  times slower than they do. Caps of the same colours: ends of their axes; black: body z
- **red-orange circle**: Γ, the circle through the rotors
- **black line** on the shell: past contact points
- **blue line**: path; **light blue**: predicted plan with its knots
- **pink sphere**: the goal
- **floor**: a line every {cell:g} m
"""
_NUMBERS = "padding:0 12px 10px;font-size:14px;line-height:1.55;overflow-wrap:anywhere"


def legend(cell: float) -> str:
    """Return the legend as Markdown, for a grid of this spacing [m]."""
    return _LEGEND.format(cell=cell)


def status_bar(frame: Frame, live: bool) -> str:
    """Return the status bar as HTML: the alerts, or whether time is running."""
    if frame.alerts:
        return _box(colours.VERMILION, "<br>".join(map(html.escape, frame.alerts)))
    if frame.capabilities.paused:
        return _box(colours.INK, "paused" if live else "recording, stopped")
    return _box(colours.GREEN, "live") if live else _box(colours.BLUE, "recording, playing")


def numbers(frame: Frame) -> str:
    """Return time, mode and distance to the goal as HTML.

    There are always three lines: the widgets below must not move under the mouse pointer.
    """
    distance = "–"
    if frame.state is not None and frame.goal is not None:
        distance = (
            f"to the goal: <b>{position_error(frame.state, frame.goal):.3f} m</b>, "
            f"<b>{angle_error(frame.state, frame.goal):.3f} rad</b>"
        )
    lines = f"t = <b>{frame.time:.2f} s</b>", html.escape(frame.mode or "–"), distance
    return f'<div style="{_NUMBERS}">{"<br>".join(lines)}</div>'


def _box(colour: Colour, text: str) -> str:
    style = "padding:6px 10px;margin:6px 0;border-radius:4px;color:white;font-weight:600"
    return f'<div style="{style};background:{css(colour)}">{text}</div>'
