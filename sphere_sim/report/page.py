# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Self-contained HTML page of a report."""

import base64
import math
from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path

import numpy as np

from sphere_nmpc import __version__
from sphere_nmpc.model.goal import Orientation
from sphere_nmpc.model.state import POSITION, QUATERNION, Vector
from sphere_sim.output.files import write_atomically
from sphere_sim.output.round_numbers import length, three_digits
from sphere_sim.recording.run import Run
from sphere_sim.report.reported import Reported, floor_metrics, odometry_metrics

_STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; color: #1a1a1a; background: #fff;
       max-width: 72rem; margin: 2rem auto; padding: 0 1rem; }
h1, h2, p { overflow-wrap: anywhere; }
h1 { font-size: 1.6rem; } h2 { font-size: 1.2rem; margin-top: 2.5rem; }
table { border-collapse: collapse; } caption { text-align: left; color: #555; }
th, td { text-align: left; padding: .3rem 1.2rem .3rem 0; border-bottom: 1px solid #ddd; }
td { font-variant-numeric: tabular-nums; }
figure { margin: 1.2rem 0; overflow-x: auto; }
/* On a phone each of two panels beside another has the width of the screen. */
img { display: block; width: 100%; min-width: 44rem; max-width: 60rem; height: auto; }
figcaption { position: sticky; left: 0; }
.wide { overflow-x: auto; font-size: .85rem; margin-top: 1.5rem; }
.wide th, .wide td { padding-right: .7rem; vertical-align: top; }
.wide td { white-space: pre; }
figcaption, .note { color: #555; font-size: .9rem; }
"""
_ALARM = "font-weight: 600; color: #b3261e"


def write_page(
    path: Path, reported: Sequence[Reported], figures: Sequence[tuple[str, str, Path]]
) -> None:
    """Write the page of recordings with figures: heading, caption and SVG or GIF file of each.

    Figures with equal headings share one.
    """
    title = "Run report: " + ", ".join(one.recording.name for one in reported)
    runs = [run for one in reported for run in one.runs.values()]
    parts = [f"<h1>{escape(title)}</h1>", *_setups(reported), *_alarms(reported)]
    parts += [_table(runs), *_notes(reported)]
    parts += [_goals(one) for one in reported if one.recording.goals]
    heading = ""
    for figure_heading, caption, file in figures:
        if figure_heading != heading:
            heading = figure_heading
            parts.append(f"<h2>{escape(heading)}</h2>")
        parts.append(_figure(caption, file))
    parts.append(f'<p class="note">Made by sphere_nmpc {escape(__version__)}.</p>')
    body = "\n".join(parts)
    write_atomically(
        path,
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>{_STYLE}</style>\n</head>\n"
        f"<body>\n{body}\n</body>\n</html>\n",
    )


def results(run: Run) -> list[tuple[str, str]]:
    """Return name and value of each result as text; those of the goal only with one."""
    return [
        *_motion_results(run), *_momentum_results(run), *_floor_results(run),
        *_odometry_results(run),
    ]


def _motion_results(run: Run) -> list[tuple[str, str]]:
    metrics = run.metrics()
    if metrics is None:
        return []
    settled = _number(metrics.settle_time_s, "s") if metrics.settled else "not settled"
    orientation = run.goals.values[-1].orientation
    angle = f"{three_digits(math.degrees(metrics.final_orientation_error_rad))} deg"
    if orientation is Orientation.ANY:
        angle = "free"
    elif orientation is Orientation.ANY_HEADING:
        angle += f", {orientation.remark}"
    return [
        ("settling time (error < 1e-2)", settled),
        ("final error", f"{metrics.final_error:.2e}"),
        ("final distance", length(metrics.final_position_error_m)),
        ("final angle", angle),
        ("largest rotor speed", _number(metrics.max_rotor_speed, "rad/s")),
        ("largest rotor torque", _number(metrics.max_rotor_torque_nm, "N m")),
        ("heat, integral of torque squared", _number(metrics.heat, "N² m² s")),
        ("energy, integral of |torque times speed|", _number(metrics.energy_j, "J")),
        ("solve time, median", _number(metrics.solve_ms_p50, "ms")),
        ("solve time, p99", _number(metrics.solve_ms_p99, "ms")),
    ]


def _momentum_results(run: Run) -> list[tuple[str, str]]:
    """Return the results of a run with momentum or pushes; empty for others."""
    if not run.has_momentum:
        return []
    rows = [
        (f"push {i}", f"{np.linalg.norm(impulse):.3g} N s at {time:.3g} s")
        for i, (time, impulse) in enumerate(
            zip(run.pushes.times, run.pushes.values, strict=True), start=1
        )
    ]
    if run.momentum:
        final = np.linalg.norm(run.momentum.values[-1])
        rows.append(("momentum at the end, estimated", _number(float(final), "N m s")))
    return rows


def _floor_results(run: Run) -> list[tuple[str, str]]:
    """Return the results of a run on a floor that is not free; empty for others."""
    found = floor_metrics(run)
    if not found:
        return []
    clearance = found["least_clearance_m"]
    return [
        ("least clearance", length(clearance) if math.isfinite(clearance) else "not recorded"),
        ("touches of what is occupied", _contacts(found)),
    ]


def _odometry_results(run: Run) -> list[tuple[str, str]]:
    """Return the errors of odometry at the end of a run; empty for one without estimates."""
    found = odometry_metrics(run)
    if not found:
        return []
    distance, angle = found.values()
    return [("odometry, error at the end", f"{length(distance)}, {three_digits(angle)} deg")]


def _contacts(floor: dict[str, float]) -> str:
    """Return the number of touches, and when the first one was."""
    count = f"{floor['contacts']:.0f}"
    first = _number(floor["first_contact_s"], "s")
    return f"{count}, the first at {first}" if floor["contacts"] else count


def _setups(reported: Sequence[Reported]) -> list[str]:
    """Return a paragraph for each recording with its strategy, robot and plant."""
    several = len(reported) > 1
    return [
        f"<p>{escape(f'{one.recording.name}: ' * several + one.recording.setup)}</p>"
        for one in reported
    ]


def _alarms(reported: Sequence[Reported]) -> list[str]:
    """Return a paragraph for each recording in which the sphere touched what is occupied."""
    return [
        f'<p style="{_ALARM}">{escape(one.recording.name)}: the sphere touched what is occupied '
        f"on the floor: {_contacts(floor)}</p>"
        for one in reported
        if (floor := floor_metrics(one.recording)) and floor["contacts"]
    ]


def _table(runs: Sequence[Run]) -> str:
    columns = [dict(results(run)) for run in runs]
    names = list(dict.fromkeys(name for column in columns for name in column))
    if not names:
        return '<p class="note">Without a goal there are no metrics.</p>'
    head = "<th></th>" + _cells([run.name for run in runs], 'th scope="col"')
    rows = [
        _cells([name], 'th scope="row"') + _cells([column.get(name, "–") for column in columns])
        for name in names
    ]
    return _rows(head, *rows)


def _notes(reported: Sequence[Reported]) -> list[str]:
    return [
        f'<p class="note">{escape(one.recording.name)}: {escape(note)}</p>'
        for one in reported
        for note in (one.hint, *one.recording.notes)
        if note
    ]


def _goals(one: Reported) -> str:
    """Return the table with a row for each goal of a recording."""
    rows = []
    for columns, run in one.rows():
        goal = run.goals.values[0]
        quaternion = [] if goal.orientation is Orientation.ANY else [_list(goal.pose[QUATERNION])]
        target = _list(goal.pose[POSITION]), *quaternion, goal.orientation.remark
        start = _list(run.states[0, POSITION]), _list(run.states[0, QUATERNION])
        rows.append({
            "goal": str(columns["goal"]), "given at": f"{columns['time_s']:.3g} s",
            "start": "\n".join(start), "target": "\n".join(filter(None, target)),
            # Of a single goal the summary has the results.
            **(dict(_motion_results(run)) if len(one.recording.goals) > 1 else {}),
        })
    caption = f"{one.recording.name}: goals; states as x, y [m], below quaternion w, x, y, z"
    head = _cells(rows[0], 'th scope="col"')
    table = _rows(head, *(_cells(row.values()) for row in rows), caption=caption)
    return f'<div class="wide">{table}</div>'


def _list(values: Vector) -> str:
    """Return components of a state as text, to a tenth of a millimetre."""
    return ", ".join(three_digits(round(value, 4) + 0.0) for value in values.tolist())


def _cells(texts: Iterable[str], tag: str = "td") -> str:
    return "".join(f"<{tag}>{escape(text)}</{tag[:2]}>" for text in texts)


def _rows(*rows: str, caption: str = "") -> str:
    """Return a table of rows of cells."""
    above = f"<caption>{escape(caption)}</caption>\n" if caption else ""
    body = "\n".join(f"<tr>{row}</tr>" for row in rows)
    return f"<table>\n{above}{body}\n</table>"


def _figure(caption: str, file: Path) -> str:
    data = base64.b64encode(file.read_bytes()).decode()
    kind = {".svg": "svg+xml", ".gif": "gif"}[file.suffix]
    return (
        f'<figure><img alt="{escape(caption)}" src="data:image/{kind};base64,{data}">'
        f"<figcaption>{escape(caption)}</figcaption></figure>"
    )


def _number(value: float, unit: str) -> str:
    return "not recorded" if math.isnan(value) else f"{three_digits(value)} {unit}"
