# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The demo's run: nodes as child processes, progress on the terminal, then the results."""

import contextlib
import re
import select
import sys
import time
from pathlib import Path

from rich.console import Console
from ruamel.yaml import YAML

from sphere_nmpc.model.parameters import RobotParameters
from sphere_sim.demo.plan import DemoPlan
from sphere_sim.demo.progress_display import ProgressDisplay
from sphere_sim.demo.results import write_results
from sphere_sim.ros.session.child_process import ChildProcess
from sphere_sim.ros.session.demo_session import DemoSession, demo_session
from sphere_sim.ros.session.goal_run import GoalRun, wait_until, wait_until_settled
from sphere_sim.ros.session.process_set import ProcessSet

_READY_TIMEOUT = 45.0
"""How long the nodes may take to be ready [s]; a busy machine needs some ten."""
_PAGE_TIMEOUT = 10.0
"""How long the viewer may take to show a page before the run starts without it [s]."""


def run_demo(plan: DemoPlan, domain: int, console: Console) -> bool:
    """Run the plan and write its results.

    Parameters
    ----------
    plan : DemoPlan
        What is run; its folder exists.
    domain : int
        ROS domain, for the first line.
    console : Console
        Where progress is shown.

    Returns
    -------
    bool
        Whether the sphere has arrived at its goal.

    Raises
    ------
    SphereNmpcError
        If a node ends or is not ready in time, or if simulated time stands still.
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
        run = GoalRun(plan.scenario.goal, plan.tolerance, plan.hold)
        with demo_session(run, RobotParameters().shell_radius, nodes.check) as session:
            session.prepare(_READY_TIMEOUT)
            console.print(f"nodes are up after {time.monotonic() - began:.1f} s")
            page = _page(viewer, console) if viewer else ""
            session.start()
            arrived = _follow(plan, session, console)
            session.halt()
            nodes.stop("recorder")
            if page and plan.stays:
                session.start()
                write_results(plan, arrived, console)
                _run_on(page, session, console)
                return arrived
            nodes.stop("controller", "simulator")
    write_results(plan, arrived, console)
    return arrived


def _page(viewer: ChildProcess, console: Console) -> str:
    """Print and return the address of the viewer's page; empty if it does not appear in time."""
    end = time.monotonic() + _PAGE_TIMEOUT
    while time.monotonic() < end:
        page = re.search(r"http://\S+", viewer.output)
        if page:
            console.print(f"watch it at {page.group()}")
            return page.group()
        time.sleep(0.1)
    return ""


def _follow(plan: DemoPlan, session: DemoSession, console: Console) -> bool:
    """Show the run until it has arrived, or its time is up; return whether it has arrived."""
    with ProgressDisplay(console, plan) as display:

        def spin() -> None:
            session.spin()
            display.show(session.progress)

        if wait_until_settled(session.run, spin, plan.duration) is None:
            return False
        wait_until(session.run, spin, min(session.run.time + plan.linger, plan.duration))
        return True


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
