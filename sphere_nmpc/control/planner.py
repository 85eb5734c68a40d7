# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Strategy in use, which may be of another package, and the plan in force.

Whatever a strategy does there is one: an error of it is recorded, and a new one takes its place.
"""

from collections.abc import Callable
from typing import cast

from sphere_nmpc.foreign.code import called, foreign_error
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.settings import STRATEGIES, ControllerSettings
from sphere_nmpc.strategy.contract import (
    SearchingStrategy,
    Situation,
    Strategy,
    make_strategy,
    plan_of,
)
from sphere_nmpc.strategy.in_force import InForce
from sphere_nmpc.strategy.path_following import PathFollowing
from sphere_nmpc.strategy.plan import Plan
from sphere_nmpc.worker.contract import Worker


class Planner:
    """Owner of the strategy in use.

    Parameters
    ----------
    settings : ControllerSettings
        Names the strategy, with the units of the robot.
    robot : RobotParameters
        Robot with the limits of its drives.
    record : callable
        Records an error.
    strategy : Strategy, optional
        Defaults to the one named in `settings`. `InvalidParameterError` is raised if it lacks a
        method.
    worker : Worker, optional
        Searches for plans beside the control loop.
    """

    def __init__(
        self, settings: ControllerSettings, robot: RobotParameters,
        record: Callable[[Exception], object], strategy: Strategy | None = None,
        worker: Worker | None = None,
    ) -> None:
        if strategy is not None:
            STRATEGIES.check(strategy, strategy)
        self._settings, self._robot, self._worker = settings, robot, worker
        self._record = record
        self._searching: SearchingStrategy | None = None
        self.compares_goals = False
        """Whether the strategy finds another goal by itself, and needs no reset."""
        self._prepared: tuple[ControllerSettings, Strategy] | None = None
        """A strategy that was made for other settings, which are not in force yet."""
        self.strategy = strategy or self._make()
        """The strategy in use, but along paths."""
        self.paths = PathFollowing(settings, robot)
        """What plans along paths."""
        self._follows = False
        self.in_force: InForce | None = None
        """The newest plan, with what it was made for; None after a decision without one."""

    def plan(self, situation: Situation) -> Plan:
        """Return the plan of the strategy; what it raises is for the caller to record."""
        leg = situation.course.legs[situation.leg]
        follows = leg.follows is not None and self.paths.leads(situation)
        if follows and not self._follows:
            self.reset()  # what it searches for is not needed
        self._follows = follows
        return plan_of(self.paths if follows else self.strategy, situation, self._robot)

    def reset(self) -> None:
        """Have the strategy act like a new one; how far a path is followed stays."""
        self._call(lambda: self.strategy.reset())

    def prepare(self, settings: ControllerSettings) -> None:
        """Make the strategy of settings that `change` is given next, where it is another one.

        `InvalidParameterError` is raised if it cannot be made.
        """
        is_prepared = self._prepared is not None and self._prepared[0] == settings
        if self._is_other(settings) and not is_prepared:
            self._prepared = settings, make_strategy(settings, self._robot, self._worker)

    def change(self, settings: ControllerSettings) -> None:
        """Use other settings: by another strategy, see `prepare`, or by the one in use."""
        self.prepare(settings)
        is_other, self._settings = self._is_other(settings), settings
        self.paths.change(settings)
        if is_other:
            self._renew()
        else:
            self._call(lambda: self.strategy.change(settings))

    @property
    def searches(self) -> bool:
        """Whether a plan is being searched for beside the loop."""
        try:
            return self._searching is not None and self._searching.searches
        except BaseException as error:
            return self._ask_no_more(error)

    def is_due(self, now: float) -> bool:
        """Return whether there is a plan that begins at `now` [s] or before."""
        try:
            return self._searching is not None and self._searching.is_due(now)
        except BaseException as error:
            return self._ask_no_more(error)

    def _ask_no_more(self, error: BaseException) -> bool:
        """Record an error of a strategy that searches, which counts as another one from now on."""
        self._searching = None
        self._record(foreign_error(error))
        return False

    def _is_other(self, settings: ControllerSettings) -> bool:
        in_force = self._settings
        return (settings.strategy, settings.period) != (in_force.strategy, in_force.period)

    def _call(self, call: Callable[[], object]) -> None:
        """Call the strategy; where that fails, a new one takes its place, without what it kept."""
        self.in_force = None
        try:
            called(call)
        except Exception as error:
            self._record(error)
            self._renew()

    def _renew(self) -> None:
        """Put a new strategy in use; where it cannot be made, the one before stays."""
        self.in_force = None
        try:
            self.strategy = self._make()
        except Exception as error:
            self._record(error)

    def _make(self) -> Strategy:
        """Return a new strategy that searches beside the loop if it can, and there is a worker."""
        prepared, self._prepared = self._prepared, None
        if prepared is not None and prepared[0] == self._settings:
            strategy = prepared[1]
        else:
            strategy = make_strategy(self._settings, self._robot, self._worker)
        self.compares_goals = called(isinstance, strategy, SearchingStrategy)
        searches = self._worker is not None and self.compares_goals
        self._searching = cast(SearchingStrategy, strategy) if searches else None
        return strategy
