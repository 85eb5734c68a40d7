# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Plan of a demo: scenario, parameters of its nodes, and its end."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import as_state
from sphere_nmpc.quantities import quantities
from sphere_nmpc.settings import STRATEGIES, ControllerSettings
from sphere_sim.evaluation.metrics import LOOSELY_SETTLED, SETTLED_ERROR
from sphere_sim.scenario.perturbation import perturbed
from sphere_sim.scenario.scenarios import PAPER_CASES, Scenario
from sphere_sim.study.conditions import StudyConditions
from sphere_sim.world.settings import SimulatorSettings

DISTURBED_CASE = 4
PROCESS_NOISE = 3e-4
"""Standard deviation of W(k) in case 4 [m, -].

The paper does not give its value. With this one Algorithm 1 keeps the sphere near the goal, as in
the paper; with 1e-3 it does not.
"""
PERTURBATION = 0.03
"""Largest relative error of a parameter in case 4."""
HOLD = 2.0
"""How long the error has to stay below the tolerance for a run to have arrived [s]."""
LINGER = 10.0
"""How long a disturbed run continues after it has arrived [s]."""


@dataclass(frozen=True)
class DemoPlan:
    """One run to show; `InvalidStateError` or `InvalidParameterError` where it cannot be made."""

    folder: Path
    """Folder of all results."""
    case: int = 1
    start: Sequence[float] | None = None
    """State in place of the start of the case, shape (6,)."""
    goal: Sequence[float] | None = None
    """State in place of the goal of the case, shape (6,)."""
    real_time_factor: float = 1.0
    """Simulated over wall time; 0 is lockstep, as fast as the nodes can."""
    lockstep: bool = False
    """Whether time waits for the controller."""
    strategy: str = ControllerSettings.strategy
    seed: int = 0
    settings: Sequence[tuple[str, str]] = ()
    """Names and values of other settings, as `StudyConditions.with_settings` takes them."""
    duration: float = 60.0
    """Simulated time after which the run is given up [s]."""
    compare: bool = True
    """Whether to compare with the other strategy."""
    viewer: bool = False
    """Whether to show the run in the browser."""
    interactive: bool = False
    """Whether a user can end the run at a terminal."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "lockstep", self.lockstep or self.real_time_factor == 0.0)
        if self.strategy not in STRATEGIES:
            raise InvalidParameterError("--strategy", self.strategy, " or ".join(STRATEGIES))
        _ = self.scenario
        if self.conditions.simulator.has_odometry:
            expected = "pose, as a demo starts no odometry"
            raise InvalidParameterError("pose_source", "odometry", expected)

    @cached_property
    def scenario(self) -> Scenario:
        """Start, goal and seed."""
        paper = PAPER_CASES[self.case]
        return Scenario(
            paper.start if self.start is None else as_state(self.start),
            paper.goal if self.goal is None else as_state(self.goal),
            self.seed,
        )

    @property
    def scenario_title(self) -> str:
        """What is run, whatever the strategy."""
        if self._is_own:
            return "own start and goal"
        title = f"case {self.case} of the paper"
        if self.disturbed:
            title += f" (noise {PROCESS_NOISE:g} a sample, parameters wrong by up to 3 %)"
        return title

    @property
    def title(self) -> str:
        """Scenario and strategy."""
        return f"{self.scenario_title}, strategy {self.strategy}"

    @property
    def bag(self) -> Path:
        """Folder of the recording."""
        return self.folder / "bag"

    @property
    def disturbed(self) -> bool:
        """Whether there is noise, under which the error does not settle below `SETTLED_ERROR`."""
        return self.case == DISTURBED_CASE and not self._is_own

    @property
    def tolerance(self) -> float:
        """Error below which the run has arrived when it stays there [mixed units]."""
        return LOOSELY_SETTLED if self.disturbed else SETTLED_ERROR

    @property
    def linger(self) -> float:
        """How long the run continues after it has arrived [s, simulated]."""
        return LINGER if self.disturbed else 0.0

    @property
    def stays(self) -> bool:
        """Whether the nodes run on after the measured run, so that the user can move the goal."""
        return self.viewer and self.interactive and not self.lockstep

    @property
    def other_strategy(self) -> str:
        """The strategy with which it is compared."""
        return "paper" if self.strategy == "time_optimal" else "time_optimal"

    @cached_property
    def conditions(self) -> StudyConditions:
        """Settings of simulation and controller, which has the nominal robot."""
        given = [("controller.strategy", self.strategy), *self.settings]
        simulator = SimulatorSettings(process_noise=PROCESS_NOISE if self.disturbed else 0.0)
        return StudyConditions(simulator=simulator).with_settings(given)

    @cached_property
    def robot(self) -> RobotParameters:
        """The simulated robot."""
        if not self.disturbed:
            return self.conditions.robot
        rng = np.random.default_rng(self.seed)
        return perturbed(self.conditions.robot, PERTURBATION, rng)

    @property
    def simulator(self) -> dict[str, Any]:
        """Parameters of the simulator node."""
        conditions = self.conditions
        plant = conditions.simulator.plant
        return {
            **_changed(conditions.simulator), **_changed(conditions.disturbances),
            **_changed(conditions.of_plant, f"{plant}."), **self._floor("clearance"),
            "initial_state": self.scenario.start.tolist(), "seed": self.seed,
            "real_time_factor": self.real_time_factor, "lockstep": self.lockstep,
            "start_paused": True, **_changed(self.robot, "robot."),
        }

    @property
    def controller(self) -> dict[str, Any]:
        """Parameters of the controller node.

        Another controller in the domain must not continue to the goal of a demo, nor this one to
        an old goal.
        """
        return {
            "use_sim_time": True, "lockstep": self.lockstep, "goal_memory": 0.0,
            **_changed(self.conditions.controller), "strategy": self.strategy,
            **_changed(self.conditions.robot, "robot."), **self._floor(),
        }

    @property
    def recorder(self) -> dict[str, Any]:
        """Parameters of the recorder node."""
        return {"use_sim_time": True, "output": str(self.bag)}

    def _floor(self, *omitted: str) -> dict[str, Any]:
        """Return the parameters of the floor but those that a node does not have."""
        changed = _changed(self.conditions.floor)
        return {name: value for name, value in changed.items() if name not in omitted}

    @property
    def _is_own(self) -> bool:
        return self.start is not None or self.goal is not None


def _changed(settings: Any, prefix: str = "") -> dict[str, Any]:
    """Return the parameters of a node, by names with a prefix, that are not the defaults."""
    values = {name: getattr(settings, name) for name in quantities(settings)}
    return {
        f"{prefix}{name}": list(value) if isinstance(value, tuple) else value
        for name, value in values.items() if value != getattr(type(settings), name)
    }
