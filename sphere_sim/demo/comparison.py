# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The demo's scenario with the other strategy, in the closed loop without ROS."""

import dataclasses
from pathlib import Path

import numpy as np

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.quantity import quantities
from sphere_nmpc.settings import ControllerSettings
from sphere_sim.demo.plan import DemoPlan
from sphere_sim.evaluation.closed_loop import Trajectory, run_closed_loop
from sphere_sim.recording.run import Run, Solves, without_sign_jumps
from sphere_sim.world.settings import SimulatorSettings
from sphere_sim.world.simulator import Simulator

_AT_LEAST = 20.0
"""Shortest duration of the other run [s]: the paper's cases need up to 13."""


def compute_other(plan: DemoPlan, recorded: Run) -> Run:
    """Run the other strategy in the closed loop without ROS, on the same plant and seed.

    Parameters
    ----------
    plan : DemoPlan
        What was run.
    recorded : Run
        Its recording; the other run is at least as long.

    Returns
    -------
    Run
        The computed run, with the fields of a recorded one.
    """
    prefix = "robot."
    known = quantities(SimulatorSettings)  # without those of the node, such as its pace
    own = {k: v for k, v in plan.simulator.items() if k in known}
    true = {k.removeprefix(prefix): v for k, v in plan.simulator.items() if k.startswith(prefix)}
    controller = ControllerSettings(strategy=plan.other_strategy)
    settings = dataclasses.replace(
        SimulatorSettings(**own),
        initial_state=tuple(plan.scenario.start),
    )
    trajectory = run_closed_loop(
        Simulator(settings, RobotParameters(**true)),
        Controller(controller, RobotParameters()),
        plan.scenario.goal,
        max(_AT_LEAST, float(np.ceil(recorded.times[-1]))),
        controller.control_period,
    )
    return _as_run(trajectory, plan, f"{plan.other_strategy}, computed without ROS")


def _as_run(trajectory: Trajectory, plan: DemoPlan, name: str) -> Run:
    tracked = [d for d in trajectory.decisions if d.solved]
    starts = [decision.plan.hold.start for decision in tracked]
    return Run(
        name=name,
        path=Path(),
        times=trajectory.times,
        states=without_sign_jumps(trajectory.states),
        joint_times=trajectory.times,
        rotor_speeds=trajectory.speeds,
        rotor_torques=trajectory.torques,
        goal_times=np.zeros(1),
        goals=plan.scenario.goal[None, :],
        plans=tuple(trajectory.holds),
        solves=Solves(
            np.array(starts),
            np.array([decision.plan.solve_time for decision in tracked]),
            np.array([decision.plan.cost for decision in tracked]),
            tuple(decision.plan.status.value for decision in tracked),
            np.array([decision.plan.arrival for decision in tracked]) - np.array(starts),
        ),
    )
