# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Plan in force with what it was made for: it stands while nothing is new."""

from dataclasses import dataclass

from sphere_nmpc.conditions import Condition
from sphere_nmpc.estimation.pose_filter import Estimate, PlantEstimate
from sphere_nmpc.floor.floor import Floor
from sphere_nmpc.model.goal import Goal
from sphere_nmpc.model.state import POSE, state_error
from sphere_nmpc.strategy.contract import Situation
from sphere_nmpc.strategy.plan import Plan


@dataclass(frozen=True, eq=False)
class Planned:
    """Plan of the strategy with what it was made for."""

    conditions: tuple[Condition, ...]
    plan: Plan
    situation: Situation
    aim: Goal
    plant: PlantEstimate

    @property
    def is_certified(self) -> bool:
        """Whether the motion that is planned has been certified to keep clear."""
        return not self.situation.floor.is_empty and not self.plan.stops

    def stands(
        self, time: float, estimate: Estimate, aim: Goal, floor: Floor
    ) -> bool:
        """Return whether nothing is new at `time` [s], so that no other plan is wanted.

        That is while goal, floor and plant are those that it was made for, and the sphere moves as
        it predicts.
        """
        plan, made_for = self.plan, self.situation
        if not made_for.time < time < plan.until or aim is not self.aim:
            return False
        if floor is not made_for.floor or estimate.plant is not self.plant:
            return False
        if estimate.disturbance is not made_for.disturbance:
            return False
        predicted = plan.state_at(time, made_for.constants.as_array(), made_for.disturbance)
        error = state_error(estimate.state, predicted[POSE])
        return error <= plan.tolerance or error <= estimate.uncertainty
