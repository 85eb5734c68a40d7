# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Settings of the controller, and the table of strategies."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.foreign.entry_table import Entry, EntryTable
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.units import DEFAULT_MAX_STEP, TABLE_1_UNITS, RobotUnits
from sphere_nmpc.quantities import quantity, validate


@dataclass(frozen=True)
class StrategyEntry(Entry):
    """A strategy that can be chosen by name."""

    sample_period: float = 0.25
    """Spacing of the knots of the input that suits it [s; for the robot of Table 1]."""


STRATEGIES = EntryTable(
    "strategy", "sphere_nmpc.strategies", "sphere_nmpc.strategy.contract:Strategy",
    {
        "time_optimal": StrategyEntry(
            "sphere_nmpc.strategy.time_optimal.strategy:TimeOptimalStrategy"
        ),
        "plan_keeping": StrategyEntry(
            "sphere_nmpc.strategy.plan_keeping:PlanKeepingStrategy", sample_period=0.5
        ),
        "paper": StrategyEntry("sphere_nmpc.strategy.paper:PaperStrategy", sample_period=0.5),
    },
    StrategyEntry,
)
"""All strategies by name, which are the choices of the parameter ``strategy``."""

SHORTEST_PERIOD = 1e-2
"""Shortest sample period [s], also where it follows from the robot."""
_MIN_PERIODS = {"sample_period": SHORTEST_PERIOD, "integration_step": 1e-3}
"""Least values of times that are given [s]."""
_INPUT_WEIGHT = 0.5
"""The paper's alpha [s^2/rad^2; for the robot of Table 1]."""


S = TypeVar("S", bound="ControllerSettings")


@dataclass(frozen=True)
class ControllerSettings:
    """Parameters of the controller: problem, rates, estimation and limits.

    Where 0 stands for the strategy's own value, that is the one of the paper in the units of the
    robot, `units`, which `of` sets; other values are in SI units and used as they are.
    """

    strategy: str = quantity(
        "time_optimal", "-",
        "Problem solved at each sample: least time to the goal, the paper's problem with plans "
        "that are carried out, or Algorithm 1 of the paper as printed",
        choices=STRATEGIES.keys(), live=True,
    )
    sample_period: float = quantity(
        0.0, "s",
        "Spacing of the knots of the first-order hold (T); 0 is the strategy's own for the robot",
        minimum=0.0, maximum=10.0,
    )
    control_rate: float = quantity(
        0.0, "Hz",
        "Rate at which the plan is solved again; 0 is once a sample period",
        minimum=0.0, maximum=1000.0,
    )
    horizon: int = quantity(
        4, "-", "Knots that are planned ahead (N)", minimum=1, maximum=60
    )
    terminal_weight: float = quantity(
        1e8, "-", "Weight of the squared error at the end of the horizon (beta)",
        minimum=1.0, maximum=1e16, live=True,
    )
    input_weight: float = quantity(
        0.0, "s^2/rad^2",
        "Weight of the squared rotor speeds (alpha); 0 is 0.5 for Table 1, by 1/u_max^2 otherwise",
        minimum=0.0, maximum=1e6, live=True,
    )
    max_iterations: int = quantity(
        100, "-", "Cap on solver iterations a sample", minimum=1, maximum=10000, live=True
    )
    time_budget: float = quantity(
        0.0, "s", "Wall time a plan may take; 0 is no limit, results are then repeatable",
        minimum=0.0, maximum=10.0, live=True,
    )
    planning_effort: int = quantity(
        50_000, "-",
        "Effort of the search for an early arrival: solver iterations times intervals, 1 us each",
        minimum=1000, maximum=100_000_000, live=True,
    )
    time_margin: float = quantity(
        0.0, "-",
        "Share of the least time by which time_optimal may arrive later, to spare the motors",
        minimum=0.0, maximum=1.0, live=True,
    )
    arrive_at: float = quantity(
        0.0, "s",
        "Time that it is to take from when a goal has come in, or the leg has begun; 0 is what "
        "time_margin says",
        minimum=0.0, maximum=3600.0, live=True,
    )
    learning: bool = quantity(
        True, "-", "Estimate the plant's constants from its motion", live=True
    )
    momentum: bool = quantity(
        True, "-", "Estimate momentum, slope and imbalance, and plan with them", live=True
    )
    pose_position_noise: float = quantity(
        0.0, "m",
        "Standard deviation of measured positions; with 0 in both noises poses count as exact "
        "until they show noise",
        minimum=0.0, maximum=1.0, live=True,
    )
    pose_orientation_noise: float = quantity(
        0.0, "rad",
        "Standard deviation of measured orientations about each axis",
        minimum=0.0, maximum=1.0, live=True,
    )
    drive_lag: float = quantity(
        0.0, "s",
        "Lag of the rotors behind their commands; with learning, the initial estimate of it",
        minimum=0.0, maximum=0.05, live=True,
    )
    integration_step: float = quantity(
        0.0, "s",
        "Longest step of the prediction's integrator; 0 is 0.1 s for Table 1, in the robot's time",
        minimum=0.0, maximum=0.5,
    )
    pose_timeout: float = quantity(
        0.5, "s", "Age of the newest pose at which the rotors are ramped to rest",
        minimum=1e-3, maximum=60.0, live=True,
    )
    goal_tolerance: float = quantity(
        1e-2, "-", "Error in R^6 below which, for a sample period, the goal counts as reached",
        minimum=1e-9, maximum=10.0, live=True,
    )
    position_tolerance: float = quantity(
        0.0, "m",
        "Tolerance of the position by itself; 0 is goal_tolerance, and the error in R^6 where "
        "orientation_tolerance is 0, too",
        minimum=0.0, maximum=10.0, live=True,
    )
    orientation_tolerance: float = quantity(
        0.0, "rad",
        "Tolerance of the orientation by itself; 0 is twice goal_tolerance, and the error in R^6 "
        "where position_tolerance is 0, too",
        minimum=0.0, maximum=3.2, live=True,
    )
    path_speed: float = quantity(
        0.0, "m/s",
        "Speed along a path, where path and rotors allow it; 0 is as fast as they allow",
        minimum=0.0, maximum=100.0, live=True,
    )
    path_tolerance: float = quantity(
        0.02, "m", "Largest distance of the centre from a path: corners are cut by less",
        minimum=1e-4, maximum=10.0, live=True,
    )
    units: RobotUnits = TABLE_1_UNITS

    def __post_init__(self) -> None:
        validate(self)
        for name, least in _MIN_PERIODS.items():
            given = getattr(self, name)
            if 0.0 < given < least:
                raise InvalidParameterError(name, given, f"0 or at least {least:g} s")

    def of(self: S, robot: RobotParameters) -> S:
        """Return the settings with the units of a robot."""
        return replace(self, units=RobotUnits.of(robot))

    @cached_property
    def period(self) -> float:
        """Spacing of the knots [s]: as given, or the strategy's own, to two digits."""
        own = STRATEGIES[self.strategy].sample_period * self.units.time
        return self.sample_period or max(float(f"{own:.2g}"), SHORTEST_PERIOD)

    @cached_property
    def tolerances(self) -> tuple[float, float]:
        """Tolerances of position [m] and orientation [rad] where they count by themselves."""
        # An angle counts half in R^6.
        least = self.goal_tolerance, 2.0 * self.goal_tolerance
        return self.position_tolerance or least[0], self.orientation_tolerance or least[1]

    @property
    def alpha(self) -> float:
        """Weight of the squared rotor speeds [s^2/rad^2]: as given, or the paper's."""
        return self.input_weight or _INPUT_WEIGHT / self.units.speed**2

    @property
    def longest_step(self) -> float:
        """Longest step of the prediction [s]: as given, or in proportion to the robot's time."""
        return self.integration_step or DEFAULT_MAX_STEP * self.units.time

    @cached_property
    def control_period(self) -> float:
        """Time between two solves [s]: the sample period, or less at a high control rate."""
        if self.control_rate <= 0.0:
            return self.period
        return min(self.period, 1.0 / self.control_rate)
