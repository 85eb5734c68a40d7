# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
from sphere_sim.evaluation.closed_loop import run_closed_loop as run_closed_loop
from sphere_sim.scenario.scenarios import PAPER_CASES as PAPER_CASES
from sphere_sim.scenario.scenarios import draw_scenarios as draw_scenarios
from sphere_sim.study.conditions import StudyConditions as StudyConditions
from sphere_sim.study.study import Study as Study
from sphere_sim.world.plant.contract import Plant as Plant
from sphere_sim.world.plant.contract import PlantSettings as PlantSettings
from sphere_sim.world.settings import SimulatorSettings as SimulatorSettings
from sphere_sim.world.simulator import Simulator as Simulator
