# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Suites: frozen scenarios with best known times, by which policies are compared."""

import inspect
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import INPUT_SIZE
from sphere_nmpc.settings import ControllerSettings
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.plan import Plan
from sphere_sim.scenario.csv_file import read_scenarios
from sphere_sim.scenario.scenarios import Scenario
from sphere_sim.study.conditions import StudyConditions
from sphere_sim.study.single_run import prepare, run_scenario
from sphere_sim.study.tables import scores, with_bounds
from sphere_sim.study.workers import Workers
from sphere_sim.world.settings import SimulatorSettings

SUITES = {
    "point-v1": StudyConditions(duration=40.0),
    "contact-v1": StudyConditions(
        duration=30.0, perturbation=20.0, simulator=SimulatorSettings(plant="rigid_body")
    ),
    "worlds-v1": StudyConditions(duration=60.0),
}
"""Conditions of each suite. They are never changed: other ones have another name."""
FOLDER = Path(__file__).parents[1] / "suites"


def scenarios_of(suite: str) -> tuple[list[Scenario], list[float]]:
    """Return the scenarios of a suite, and settling times of their best known motions [s]."""
    if suite not in SUITES:
        raise InvalidParameterError("suite", suite, " or ".join(SUITES))
    scenarios = read_scenarios(FOLDER / suite / "scenarios.csv")
    return scenarios, [float(scenario.extra["best_known_s"]) for scenario in scenarios]


@dataclass(frozen=True)
class Score:
    """Score of a policy in a suite, as text a table; for `kinds` see `tables.scores`.

    `errors` are the last ones of runs in which the policy or the control loop has failed.
    """

    suite: str
    policy: str
    kinds: dict[str, dict[str, Any]]
    errors: tuple[str, ...] = ()

    @property
    def figure(self) -> float:
        """Mean of best known over settling time of all runs, 0 to 1."""
        return float(self.kinds["all"]["score"])

    def __str__(self) -> str:
        lines = [f"{self.suite}, {self.policy}: {self.figure:.3f}",
                 "kind       runs  settled  score  median    p90  contacts"]
        for kind, of in self.kinds.items():
            ratios = [of["ratio"][name] for name in ("median", "p90")]
            median, p90 = ("-" if ratio is None else f"{ratio:.2f}" for ratio in ratios)
            lines.append(f"{kind:9}  {of['runs']:4}  {of['settled']:7}  {of['score']:.3f}  "
                         f"{median:>6}  {p90:>5}  {of['contacts']:8}")
        told = [f"runs with errors: {len(self.errors)}, such as {one}" for one in self.errors[:1]]
        return "\n".join(lines + told)


def score(
    policy: str | Callable[..., Any], suite: str = "point-v1",
    settings: ControllerSettings | None = None, jobs: int = 1,
) -> Score:
    """Return the score of a policy in a suite, which depends on nothing else.

    A policy is the name of a strategy; a function of a `Situation` that returns the rotor speeds
    [rad/s], shape (2,), to be reached at the next sampling instant; or a class or function that
    makes such a function or a `Strategy` of `ControllerSettings` and `RobotParameters`, for each
    run another one. It acts in the control loop of these settings, in so many processes.

    `InvalidParameterError` is raised if there is no such suite, or policy, or if other processes
    cannot import it.
    """
    scenarios, best_known = scenarios_of(suite)
    settings, make, name = settings or ControllerSettings(), None, str(policy)
    if isinstance(policy, str):
        settings = replace(settings, strategy=policy)
    else:
        name, make = getattr(policy, "__name__", name), partial(PolicyStrategy, policy)
        if not callable(policy) or (jobs > 1 and policy.__module__ == "__main__"):
            expected = "the name of a strategy, or a function or class, for jobs > 1 of a module"
            raise InvalidParameterError("policy", policy, expected)
    conditions = replace(SUITES[suite], controller=settings)
    prepare(conditions, scenarios[0], make)  # an error of all runs is raised here
    tasks = [(i, (conditions, scenario, make)) for i, scenario in enumerate(scenarios)]
    with Workers(jobs) as workers:
        records = dict(workers.run(run_scenario, tasks, "run"))
    found = [records[i].results for i in range(len(scenarios))]
    results = with_bounds(found, [math.nan] * len(found), best_known)
    errors = (str(run.get("crash") or run.get("last_failure") or "") for run in found)
    return Score(suite, name, scores(scenarios, results), tuple(filter(None, errors)))


class PolicyStrategy:
    """Strategy that does what a policy says, see `score`: a function is asked once a period."""

    def __init__(
        self, policy: Callable[..., Any], settings: ControllerSettings, robot: RobotParameters
    ) -> None:
        needed = [one for one in inspect.signature(policy).parameters.values()
                  if one.default is one.empty and one.kind <= one.POSITIONAL_OR_KEYWORD]
        is_made = isinstance(policy, type) or len(needed) == 2
        self._make = partial(policy, settings, robot) if is_made else lambda: policy
        self._made = self._make()
        self._period = settings.control_period

    def change(self, settings: ControllerSettings) -> None:
        """Do nothing: those of a run do not change."""

    def reset(self) -> None:
        """Have the next plan make another one: for an error here the loop changes the strategy."""
        self._made = None

    def plan(self, situation: Situation) -> Plan:
        """Return the plan of what was made, or that to the rotor speeds that it returns."""
        made = self._made = self._make() if self._made is None else self._made
        if hasattr(made, "plan"):
            plan: Plan = made.plan(situation)
            return plan
        speeds = np.asarray(made(situation), dtype=float)
        if speeds.shape != (INPUT_SIZE,):
            raise InvalidParameterError("policy", speeds, "two rotor speeds [rad/s]")
        times = situation.time + np.array([0.0, self._period])
        hold = FirstOrderHold(times, np.stack((situation.speeds, speeds)))
        return Plan(hold, situation.state[None])
