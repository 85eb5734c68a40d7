# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""``sphere_nmpc demo``: a run from start to goal over ROS 2, recorded and drawn."""

import contextlib
import json
import re
import select
import shlex
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from matplotlib.figure import Figure
from rich.console import Console
from ruamel.yaml import YAML

from sphere_nmpc.errors import SphereNmpcError
from sphere_nmpc.model.parameters import RobotParameters
from sphere_sim.atomic_write import write_atomically
from sphere_sim.cli.exits import if_interrupted
from sphere_sim.demo.comparison import compute_other
from sphere_sim.demo.plan import DemoPlan, parse
from sphere_sim.demo.progress_display import ProgressDisplay
from sphere_sim.demo.summary import summarise, table
from sphere_sim.optional_figure import draw_or_warn
from sphere_sim.recording.errors import BagError
from sphere_sim.recording.run import Run
from sphere_sim.recording.run_reader import read_run
from sphere_sim.report.figures.paper_panels import paper_panels
from sphere_sim.report.figures.side_by_side import side_by_side
from sphere_sim.report.figures.style import save
from sphere_sim.result_folder import prepare_folder
from sphere_sim.ros.session.children import Children
from sphere_sim.ros.session.demo_director import DemoDirector, directing
from sphere_sim.ros.session.domain import own_domain

_READY_TIMEOUT = 45.0
"""How long the nodes may take to come together [s]; a busy machine needs some ten."""
_PAGE_TIMEOUT = 10.0
"""How long the viewer may take to show a page before the run starts without it [s]."""
_STALLED = 30.0
"""Wall time without progress of simulated time after which the run is given up [s]."""


class StalledError(SphereNmpcError):
    """Simulated time stands still."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the demo.

    Returns
    -------
    int
        0 when the sphere has arrived, 1 when it has not.

    Raises
    ------
    SphereNmpcError
        If the run cannot be made.
    """
    plan = parse(arguments)

    def left() -> str:
        kept = f"; {plan.bag} keeps what was recorded" if plan.bag.exists() else ""
        return f"all nodes are stopped{kept}"

    with if_interrupted(left), own_domain() as domain:
        return _demonstrate(plan, domain, Console())


def _demonstrate(plan: DemoPlan, domain: int, console: Console) -> int:
    if plan.bag.exists():
        raise BagError(plan.bag, "exists already and is not overwritten; choose another --out")
    prepare_folder(plan.folder)
    parameters = _write_parameters(plan)
    console.print(f"[bold]{plan.title}[/bold] (ROS domain {domain})")
    began = time.monotonic()
    with Children(plan.folder) as children, Children(plan.folder) as onlookers:
        for verb in ("controller", "simulator", "recorder"):
            children.start(verb, ["--ros-args", "--params-file", str(parameters)])
        if plan.viewer:
            # Nobody checks on it: the run must not end because nothing can be shown.
            onlookers.start("viewer", ["--ros-args", "-p", "use_sim_time:=true"])
        radius = RobotParameters().shell_radius
        with directing(plan.scenario.goal, radius, children.check) as director:
            director.prepare(_READY_TIMEOUT)
            console.print(f"nodes are up after {time.monotonic() - began:.1f} s")
            page = _tell_page(plan, console)
            director.start()
            arrived = _watch(plan, director, console)
            director.halt()
            children.stop("recorder")
            if page and plan.stays:
                director.start()
                code = _conclude(plan, arrived, console)
                _stay(page, director, console)
                return code
            children.stop("controller", "simulator")
    return _conclude(plan, arrived, console)


def _stay(page: str, director: DemoDirector, console: Console) -> None:
    """Leave the sphere to whoever watches, until Enter or Ctrl-C."""
    told = f"the sphere is yours: drag its goal at {page}; Enter ends"
    console.print(told, soft_wrap=True)
    with contextlib.suppress(KeyboardInterrupt):
        while not select.select([sys.stdin], [], [], 0.0)[0]:
            director.spin()


def _tell_page(plan: DemoPlan, console: Console) -> str:
    """Tell where the viewer shows the run, once it does; return that too, if there is a page."""
    log, end = plan.folder / "viewer.log", time.monotonic() + _PAGE_TIMEOUT
    while plan.viewer and time.monotonic() < end:
        page = re.search(r"http://\S+", log.read_text(errors="replace"))
        if page:
            console.print(f"watch it at {page.group()}")
            return page.group()
        time.sleep(0.1)
    return ""


def _watch(plan: DemoPlan, director: DemoDirector, console: Console) -> bool:
    """Show the run until it has arrived and stayed, or its time is up; tell which."""
    inside_since: float | None = None
    arrived_at: float | None = None
    moved, last = time.monotonic(), -1.0
    with ProgressDisplay(console, plan) as display:
        while True:
            director.spin()
            progress = director.progress
            if progress.time > last:
                moved, last = time.monotonic(), progress.time
            elif time.monotonic() > moved + _STALLED:
                raise StalledError(f"simulated time stands still at {progress.time:.2f} s")
            if not progress.error < plan.tolerance:
                inside_since = None
            elif inside_since is None:
                inside_since = progress.time
            display.show(progress)
            stays = inside_since is not None and progress.time >= inside_since + plan.hold
            if stays and arrived_at is None:
                arrived_at = progress.time
            if arrived_at is not None and progress.time >= arrived_at + plan.linger:
                return True
            if progress.time >= plan.duration:
                return arrived_at is not None


def _conclude(plan: DemoPlan, arrived: bool, console: Console) -> int:
    """Measure the run from its bag, compare and draw it, and tell.

    The numbers are written before anything that takes long or may fail.
    """
    run = read_run(plan.bag, name=f"{plan.strategy}, recorded over ROS")
    metrics = run.metrics()
    if metrics is None:
        raise BagError(plan.bag, "holds no goal or no pose after it")
    runs = {plan.strategy: run}
    _write_summary(plan, arrived, runs)
    left = [_draw(paper_panels(run, plan.title), plan.folder, "panels")]
    if plan.compare:
        other = runs[plan.other_strategy] = compute_other(plan, run)
        _write_summary(plan, arrived, runs)
        figure = side_by_side(run, other, plan.scenario_title)
        left.append(_draw(figure, plan.folder, "comparison"))
    console.print(table(plan, runs))
    files = ", ".join(["bag", *filter(None, left)])
    console.print(f"{files} and summary.json are in {plan.folder}", soft_wrap=True)
    bag = shlex.quote(str(plan.bag))
    console.print(f"once more: sphere_nmpc viewer --replay {bag}", soft_wrap=True)
    if not arrived:
        print(
            f"demo: not at the goal after {run.times[-1]:.1f} s: error {metrics.final_error:.3g}, "
            f"expected below {plan.tolerance:g}",
            file=sys.stderr,
        )
    return 0 if arrived else 1


def _write_summary(plan: DemoPlan, arrived: bool, runs: dict[str, Run]) -> None:
    summary = json.dumps(summarise(plan, arrived, runs), indent=2)
    write_atomically(plan.folder / "summary.json", summary + "\n")


def _draw(figure: Figure, folder: Path, name: str) -> str:
    """Save a figure and return its file's name; empty where that is not possible."""
    saved: list[Path] = []
    draw_or_warn("demo", name, lambda: saved.extend(save(figure, folder, name)))
    return saved[0].name if saved else ""


def _write_parameters(plan: DemoPlan) -> Path:
    """Write the parameters of the nodes to a file they, and anybody later, can be started with."""
    path = plan.folder / "parameters.yaml"
    nodes = {"simulator": plan.simulator, "controller": plan.controller, "recorder": plan.recorder}
    yaml = YAML(typ="safe")
    yaml.default_flow_style = False
    with path.open("w", encoding="utf-8") as stream:
        yaml.dump({f"/**/{name}": {"ros__parameters": own} for name, own in nodes.items()}, stream)
    return path
