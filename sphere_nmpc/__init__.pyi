# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
from sphere_nmpc.control.controller import Controller as Controller
from sphere_nmpc.estimation.odometry.odometry import Odometry as Odometry
from sphere_nmpc.model.course import Course as Course
from sphere_nmpc.model.first_order_hold import FirstOrderHold as FirstOrderHold
from sphere_nmpc.model.goal import Goal as Goal
from sphere_nmpc.model.integrator import step_function as step_function
from sphere_nmpc.model.parameters import RobotParameters as RobotParameters
from sphere_nmpc.quantities import quantity as quantity
from sphere_nmpc.settings import ControllerSettings as ControllerSettings
from sphere_nmpc.solver.problem import LeastSquaresProblem as LeastSquaresProblem
from sphere_nmpc.solver.problem import MinimumTimeProblem as MinimumTimeProblem
from sphere_nmpc.solver.roll_out import roll_out as roll_out
from sphere_nmpc.solver.solve import solve as solve
from sphere_nmpc.strategy.contract import Situation as Situation
from sphere_nmpc.strategy.plan import Plan as Plan
from sphere_sim.study.suite import score as score

__version__: str
