# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The faults of the campaign by name, and the selection of those to try."""

import itertools
import math
import signal
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any

import actions
import floors
import numpy as np
import tries
from relay import (
    Disturbance,
    ahead,
    delayed,
    dropped,
    duplicated,
    framed,
    not_finite,
    scaled,
    shuffled,
    sign_flipped,
)


@dataclass(frozen=True)
class Fault:
    """One fault, which lasts for a while."""

    name: str
    group: str
    """Its group; the quick campaign tries one fault or two of each group."""
    action: Callable[..., actions.Action]
    """Causes it."""
    options: dict[str, Any] = field(default_factory=dict)
    """Options of the action."""
    duration: float = 3.0
    """How long it lasts [s], simulated."""
    named_by: tuple[str, ...] = ()
    """Words of which one has to appear in a log line, a diagnostic or the end of a process; empty
    for a fault that does no harm."""
    blind: bool = False
    """Whether the controller gets no usable pose, so that the rotors have to come to rest."""
    goal_again: bool = False
    """Whether the goal is lost by it and has to be sent again, as a supervisor would."""
    continuous: bool = True
    """Whether each command has to start from the speeds that were in force; not where another
    controller takes over, one is restarted or commands are lost, and the drives alone limit the
    slew."""
    upright: bool = False
    """Whether the goal has to be upright: with momentum no other can be held for certain."""
    quick: bool = False
    """Whether the quick campaign includes it."""


_REFUSED = ("pose refused",)
_BLIND = ("no fresh pose",)
_LATE = ("late poses rose",)
_FAILED = ("solve failed",)
_STILL = ("clock stands still", "paused")
_OTHER = ("other publisher",)
_WORKER = ("worker replaced",)


def _pose(name: str, disturbance: Disturbance, **more: Any) -> Fault:
    given = {"disturbance": disturbance}
    return Fault(f"pose_{name}", "pose", actions.disturb_poses, given, **more)


def _goal(name: str, options: dict[str, Any], **more: Any) -> Fault:
    return Fault(f"goal_{name}", "goal", actions.bad_goals, options, goal_again=True, **more)


def _kill(node: str, **more: Any) -> Fault:
    name = f"{node}_killed"
    return Fault(name, "process", actions.kill, {"node": node}, named_by=("SIGKILL",), **more)


def _burst(name: str, *lost: str, **more: Any) -> Fault:
    # A controller knows by measurement only which of its commands were lost.
    known = "rotor_trajectory" not in lost
    given = {"of": lost}
    return Fault(f"burst_{name}", "burst", actions.lose, given, 2.0, continuous=known, **more)


def _two_poses(name: str, **options: Any) -> Fault:
    # As for two controllers, the graph is checked by wall time.
    return Fault(f"two_poses_{name}", "rival", actions.two_poses, options, 6.0, _OTHER)


def _solver(name: str, mode: str, **more: Any) -> Fault:
    return Fault(f"solver_{name}", "solver", actions.bad_solver, {"mode": mode}, **more)


_POSES = ("pose", "joint_states")
_COMMANDS = ("rotor_trajectory", "rotor_commands")
_ALL = (
    _pose("dropped_10", dropped(0.1)),
    _pose("dropped_50", dropped(0.5)),
    _pose("dropped_100", dropped(1.0), named_by=_BLIND, blind=True, quick=True),
    _pose("delayed_0.2", delayed(0.2)),
    _pose("delayed_1.0", delayed(1.0), named_by=_BLIND, blind=True),
    _pose("out_of_order", shuffled(0.15), named_by=_LATE),
    _pose("duplicated", duplicated(3), named_by=_LATE),
    _pose("future_0.3", ahead(0.3)),
    _pose("future_10", ahead(10.0), named_by=_REFUSED, blind=True),
    _pose("nan", not_finite(), named_by=_REFUSED, blind=True, quick=True),
    _pose("some_nan", not_finite(0.3), named_by=_REFUSED),
    _pose("sign", sign_flipped()),
    _pose("norm", scaled(2.0), named_by=_REFUSED, blind=True),
    _pose("frame", framed("map"), named_by=_REFUSED, blind=True),
    _burst("poses", *_POSES, named_by=_BLIND, blind=True),
    # Without `named_by`: where the plan did not change meanwhile, nothing was lost.
    _burst("commands", *_COMMANDS),
    # Not blind: the command to rest is lost, too.
    _burst("both", *_POSES, *_COMMANDS, named_by=_BLIND, quick=True),
    _burst("clock", "/clock", named_by=(*_STILL, *_REFUSED)),
    _goal("burst", {"kinds": ("valid",), "period": 0.01}),
    _goal("unreachable", {"kinds": ("far",)}, named_by=("goal_pose refused", *_FAILED)),
    _goal("malformed", {"kinds": ("number", "frame", "norm")}, named_by=("goal_pose refused",),
          quick=True),
    Fault("clock_paused", "clock", actions.pause, duration=1.5, named_by=_STILL),
    Fault("clock_lost", "clock", actions.lose, {"of": ("/clock",)},
          named_by=(*_STILL, *_REFUSED)),
    Fault("clock_back", "clock", actions.clock_back, {"by": 3.0}, 1.0, ("clock jumped",),
          continuous=False, quick=True),
    Fault("clock_0.1x", "clock", actions.pace, {"factor": 0.1}, 0.5),
    Fault("clock_20x", "clock", actions.pace, {"factor": 20.0}, 3.0),
    _kill("controller", goal_again=True, continuous=False, quick=True),
    _kill("simulator", continuous=False),
    _kill("recorder"),
    Fault("controller_stopped", "process", actions.stop, {"node": "controller"},
          named_by=("missed ticks rose",)),
    Fault("simulator_stopped", "process", actions.stop, {"node": "simulator"},
          named_by=("clock stopped", *_STILL)),
    Fault("worker_killed", "worker", actions.signal_worker, {"number": signal.SIGKILL},
          named_by=_WORKER, quick=True),
    # Longer than the controller waits for a result, by wall time.
    Fault("worker_stopped", "worker", actions.signal_worker, {"number": signal.SIGSTOP}, 8.0,
          _WORKER),
    _solver("raises", "raise", named_by=_FAILED, quick=True),
    _solver("not_finite", "nan", named_by=_FAILED),
    _solver("wild", "wild"),
    _solver("nothing", "nothing", named_by=_FAILED),
    _solver("exits", "exit", named_by=_FAILED),
    _solver("interrupts", "interrupt", named_by=_FAILED),
    _solver("writes", "write", named_by=_FAILED),
    _solver("knots", "knots", named_by=_FAILED),
    _solver("reset_exits", "reset"),
    _solver("late", "late", named_by=("missed ticks rose", "longer than the control period")),
    # Without `named_by`: often each tick is still in time, and there is nothing to report.
    Fault("cpu_starved", "cpu", actions.throttle, {"share": 0.1}, quick=True),
    Fault("cpu_shared", "cpu", actions.hog, {"number": 4}),
    Fault("disk_full", "disk", actions.disk_full, named_by=("recording stopped",), quick=True),
    # Diagnostics detect a second controller by wall time, once every 0.5 s.
    Fault("two_controllers", "rival", actions.second_controller, duration=6.0, named_by=_OTHER,
          continuous=False, quick=True),
    _two_poses("near", offset=0.1),
    _two_poses("far", offset=2.0),
    _two_poses("other_sphere"),
    Fault("parameters_at_start", "parameters", actions.bad_start, duration=0.0,
          named_by=("expected",), goal_again=True, continuous=False),
    Fault("parameters_live", "parameters", actions.bad_live, duration=1.0,
          named_by=("refused live",), quick=True),
    Fault("map_obstacle", "map", actions.new_obstacle, duration=6.0, named_by=("map refused",),
          quick=True),
    Fault("push", "disturbance", actions.push, {"impulse": 0.5}, 0.0, upright=True, quick=True),
    Fault("tilt", "disturbance", actions.tilt, {"slope": math.radians(0.2)}, upright=True),
)

HOSTILE = tuple(
    Fault(action.__name__, "hostile", action, goal_again=True, continuous=False)
    for action in (
        tries.malformed, tries.extremes, tries.parameters, tries.services, tries.clock_jump,
        tries.ended, tries.strategies,
    )
) + tuple(
    Fault(action.__name__, "floor", action, duration=12.0, goal_again=True)
    for action in (floors.areas, floors.maps, floors.goal_lists)
)
"""Faults of the fuzzing, which need a session with everything."""
FAULTS = {fault.name: fault for fault in _ALL}
"""All faults by name, in the order in which they are tried."""

_EXCLUSIVE = (
    {"controller_killed", "controller_stopped", "worker_killed", "worker_stopped", "cpu_starved",
     "parameters_at_start", "parameters_live"},
    {"simulator_killed", "simulator_stopped", "push", "tilt", "parameters_live"},
    *({"map_obstacle", name} for name in (
        "simulator_killed", "push", "tilt", "two_controllers", "two_poses_near", "two_poses_far",
        "two_poses_other_sphere",
    )),
    {"recorder_killed", "disk_full"},
)
"""Faults of one process, of which one would undo or hide the other, and such as may put or drive
the sphere into an obstacle."""


def chosen(names: Iterable[str] = (), quick: bool = False) -> list[Fault]:
    """Return those of some names or groups; without names all, or those of the quick campaign."""
    names = set(names)
    if names:
        return [fault for fault in _ALL if {fault.name, fault.group} & names]
    return [fault for fault in _ALL if fault.quick or not quick]


def combined(
    faults: Iterable[Fault], size: int, number: int, seed: int
) -> list[tuple[Fault, ...]]:
    """Return some combinations of faults that can coincide, drawn without repetition."""
    possible = [
        several for several in itertools.combinations(faults, size)
        if all(_can_coincide(one, other) for one, other in itertools.combinations(several, 2))
    ]
    order = np.random.default_rng([seed, size]).permutation(len(possible))
    return [possible[i] for i in order[:number]]


def fuzzed(seed: int, number: int) -> tuple[Fault, ...]:
    """Return the hostile fault of a number, sometimes with one that leaves the nodes running."""
    rng = np.random.default_rng([seed, number])
    faults = (HOSTILE[rng.integers(len(HOSTILE))],)
    # A controller without poses or time cannot avoid what is put on the floor meanwhile.
    groups = ("goal",) if faults[0].group == "floor" else ("pose", "goal", "burst", "clock")
    others = [fault for fault in _ALL if fault.group in groups]
    return (*faults, others[rng.integers(len(others))]) if rng.random() < 0.3 else faults


def _can_coincide(one: Fault, other: Fault) -> bool:
    # Two disturbances of poses can be combined; two paces or two solver failures cannot.
    if one.action is other.action and one.group != "pose":
        return False
    return not any({one.name, other.name} <= several for several in _EXCLUSIVE)


def name_of(faults: Iterable[Fault]) -> str:
    """Return the name of one fault, or of several together."""
    return " + ".join(fault.name for fault in faults)
