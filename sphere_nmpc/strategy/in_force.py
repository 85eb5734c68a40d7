# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Plan in force with what it was made for: it stands while nothing is new.

It is a chain: the plan of the leg that is followed, and that of the next leg from its end on.
"""

import operator
from dataclasses import dataclass, replace
from functools import cached_property

from sphere_nmpc.model.course import Course, LegEnd
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import POSE, Vector, state_error
from sphere_nmpc.reporting.conditions import Condition, Kind
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.plan import Plan, PlanStatus


@dataclass(frozen=True, eq=False)
class InForce:
    """Plan in force.

    Attributes
    ----------
    plan : Plan
        The plan, in control time.
    situation : Situation
        What it was made for last: plant, floor, course and the command in force before it.
    robot : RobotParameters
        Limits of the drives that it keeps.
    rested : ndarray of shape (2,), or None
        Where the sphere has rested before it and those that it has taken the place of [m].
    after : InForce or None
        Plan of the next leg, which begins where this one ends; None while there is none.
    """

    plan: Plan
    situation: Situation
    robot: RobotParameters
    rested: Vector | None = None
    after: "InForce | None" = None

    @cached_property
    def inputs(self) -> tuple[object, ...]:
        """Leg, floor, plant and disturbance that it was made for, compared by identity."""
        made_for = self.situation
        leg = made_for.course.legs[made_for.leg]
        return leg, made_for.floor, made_for.plant, made_for.disturbance

    @cached_property
    def conditions(self) -> tuple[Condition, ...]:
        """How things stand while it is followed."""
        is_saturated = self.plan.status is PlanStatus.SATURATED
        return (Kind.SATURATED if is_saturated else Kind.TRACKING).conditions

    @property
    def is_certified(self) -> bool:
        """Whether the motion that is planned has been certified to keep clear."""
        return not self.situation.floor.is_empty and not self.plan.stops

    def is_for(self, course: Course, leg: int) -> bool:
        """Return whether it leads to the end of a leg of a course, wherever that is now."""
        made_for = self.situation
        return made_for.course.origin is course.origin and made_for.leg == leg

    def has_passed(self, course: Course, leg: int, time: float) -> bool:
        """Return whether it predicts that the end of a leg of a course lies behind at `time` [s].

        One that ends on the way there, or outside of the dead band, does not.
        """
        plan = self.plan
        if plan.leg.end is not LegEnd.REST or plan.status is not PlanStatus.SOLVED:
            return False
        return plan.end <= time and self.is_for(course, leg)

    def on_leg(self, situation: Situation) -> "InForce":
        """Return the plan of the leg that is followed: the next one's where that has begun."""
        after = self.after
        if after is None or not after.is_for(situation.course, situation.leg):
            return self
        return replace(after, plan=self.plan.continued(after.plan))

    def at(self, time: float) -> Vector:
        """Return the state that it predicts for a control time [s], shape (9,)."""
        made_for = self.situation
        return self.plan.at(time, made_for.plant.constants, made_for.disturbance)

    def stands(
        self, time: float, state: Vector, uncertainty: float, inputs: tuple[object, ...]
    ) -> bool:
        """Return whether nothing is new at `time` [s], so that no other plan is wanted.

        That is while the `inputs` are those that it was made for, and the sphere moves as it
        predicts: up to the standard deviation of the estimated state in R^6.
        """
        plan = self.plan
        if not self.situation.time < time < plan.until:
            return False
        if not all(map(operator.is_, inputs, self.inputs)):
            return False
        error = state_error(state, self.at(time)[POSE])
        return error <= plan.tolerance or error <= uncertainty
