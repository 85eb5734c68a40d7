# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The demo's run: nodes as child processes, progress on the terminal, then the results."""

import contextlib
import math
import re
import select
import sys
import time
from pathlib import Path

from rich.console import Console, Group
from rich.progress_bar import ProgressBar
from rich.table import Table
from ruamel.yaml import YAML

from sphere_nmpc.model.state import angle_error, position_error
from sphere_nmpc.process.child import Child
from sphere_sim.demo.plan import HOLD, DemoPlan
from sphere_sim.demo.results import hints_of, write_results
from sphere_sim.evaluation.metrics import GoalRun
from sphere_sim.output.live_display import LiveDisplay
from sphere_sim.recording.message_fields import number
from sphere_sim.ros.session.demo_session import DemoSession
from sphere_sim.ros.session.goal_run import wait_until_settled
from sphere_sim.ros.session.process_set import ProcessSet

_READY_TIMEOUT = 45.0
"""How long the nodes may take to be ready [s]; a busy machine needs some ten."""
_PAGE_TIMEOUT = 10.0
"""How long the viewer may take to show a page before the run starts without it [s]."""


def run_demo(plan: DemoPlan, domain: int, console: Console) -> bool:
    """Run the plan, whose folder exists, and write its results.

    Returns whether the sphere has arrived at its goal. `SphereNmpcError` is raised if a node ends
    or is not ready in time, or if simulated time stands still.
    """
    parameters = _write_parameters(plan)
    console.print(f"[bold]{plan.title}[/bold] (ROS domain {domain})")
    began = time.monotonic()
    with ProcessSet(plan.folder) as nodes, ProcessSet(plan.folder) as unchecked:
        for verb in ("controller", "simulator", "recorder"):
            nodes.start(verb, ["--ros-args", "--params-file", str(parameters)])
        viewer = None
        if plan.viewer:
            # Not checked on: the run must not end because nothing can be shown.
            arguments = ["--ros-args", "-p", "use_sim_time:=true"]
            viewer = unchecked.start("viewer", arguments)
        with DemoSession(nodes.check) as session:
            run = session.prepare(plan.scenario.goal, plan.tolerance, HOLD, _READY_TIMEOUT)
            console.print(f"nodes are up after {time.monotonic() - began:.1f} s")
            page = _page(viewer, console) if viewer else ""
            session.pause(False)
            with _Display(console, session, run) as display:

                def spin() -> None:
                    session.spin()
                    display.update()

                arrived = (
                    wait_until_settled(run, spin, plan.duration, linger=plan.linger) is not None
                )
            missed = number(session.sender.values, "missed_ticks")
            hints = hints_of(plan, missed, session.sender.obstacle(), run.time)
            session.pause(True)
            nodes.stop("recorder")
            if page and plan.stays:
                session.pause(False)
                write_results(plan, arrived, console, hints)
                _run_on(page, session, console)
                return arrived
            nodes.stop("controller", "simulator")
    write_results(plan, arrived, console, hints)
    return arrived


def _page(viewer: Child, console: Console) -> str:
    """Print and return the address of the viewer's page; empty if it does not appear in time."""
    end = time.monotonic() + _PAGE_TIMEOUT
    while time.monotonic() < end:
        page = re.search(r"http://\S+", viewer.output)
        if page:
            console.print(f"watch it at {page.group()}")
            return page.group()
        time.sleep(0.1)
    return ""


def _run_on(page: str, session: DemoSession, console: Console) -> None:
    """Keep the nodes running for the user until Enter or Ctrl-C."""
    console.print(f"the nodes run on: drag the goal at {page}; Enter ends", soft_wrap=True)
    with contextlib.suppress(KeyboardInterrupt):
        while not select.select([sys.stdin], [], [], 0.0)[0]:
            session.spin()


def _write_parameters(plan: DemoPlan) -> Path:
    """Write the parameters of the nodes to a file with which they can be started again."""
    path = plan.folder / "parameters.yaml"
    nodes = {"simulator": plan.simulator, "controller": plan.controller, "recorder": plan.recorder}
    yaml = YAML(typ="safe")
    yaml.default_flow_style = False
    with path.open("w", encoding="utf-8") as stream:
        yaml.dump({f"/**/{name}": {"ros__parameters": own} for name, own in nodes.items()}, stream)
    return path


class _Display(LiveDisplay):
    """Display of the newest values of a run."""

    def __init__(self, console: Console, session: DemoSession, run: GoalRun) -> None:
        super().__init__(console)
        self._session = session
        self._run = run
        self._first: float | None = None

    def update(self) -> None:
        """Show the newest values."""
        if not math.isnan(self._run.time):
            self.show(lambda: Group(self._table(), self._bar()), self._line)

    def _line(self) -> str:
        run, session = self._run, self._session
        speeds = ", ".join(f"{speed:.1f}" for speed in session.rotor_speeds)
        return (
            f"t {run.time:6.2f} s  distance {position_error(run.state, run.goal):.4f} m  "
            f"angle {math.degrees(angle_error(run.state, run.goal)):.3f} deg  "
            f"rotors {speeds} rad/s  solve {1e3 * session.solve_time:.2f} ms"
        )

    def _table(self) -> Table:
        run, session = self._run, self._session
        table = Table.grid(padding=(0, 3))
        speeds = "  ".join(f"{speed:7.1f}" for speed in session.rotor_speeds)
        for name, value in (
            ("time", f"{run.time:8.2f} s"),
            ("distance", f"{position_error(run.state, run.goal):8.4f} m"),
            ("angle", f"{math.degrees(angle_error(run.state, run.goal)):8.3f} deg"),
            ("rotor speeds", f"{speeds} rad/s"),
            ("solve time", f"{1e3 * session.solve_time:8.2f} ms"),
        ):
            table.add_row(f"[dim]{name}[/dim]", value)
        return table

    def _bar(self) -> ProgressBar:
        """Return a bar of the error between start and tolerance, on a logarithmic scale."""
        error, tolerance = max(self._run.error, 1e-12), self._run.tolerance
        if self._first is None:
            self._first = max(error, 2.0 * tolerance)
        way = math.log(self._first / error) / math.log(self._first / tolerance)
        return ProgressBar(total=1.0, completed=min(max(way, 0.0), 1.0), width=50)
