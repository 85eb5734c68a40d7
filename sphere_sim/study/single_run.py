# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""One run of a study: the closed loop of a scenario and its results."""

from dataclasses import asdict, replace

import numpy as np

from sphere_nmpc.control.controller import Controller
from sphere_nmpc.model.first_order_hold import FirstOrderHold
from sphere_nmpc.model.state import Vector
from sphere_sim.evaluation.closed_loop import Trajectory, run_closed_loop
from sphere_sim.evaluation.metrics import measure, settling_index, state_errors
from sphere_sim.scenario.perturbation import perturbed
from sphere_sim.scenario.scenarios import Scenario
from sphere_sim.study.conditions import StudyConditions
from sphere_sim.study.followed_inputs import followed_inputs
from sphere_sim.study.record import RunRecord, Value, finite
from sphere_sim.study.stability import stability_of
from sphere_sim.world.plant.factory import make_plant
from sphere_sim.world.simulator import Simulator

LOOSELY_SETTLED = 5e-2
"""Error within which a run with process noise can be expected to stay [mixed units]."""


def prepare(conditions: StudyConditions, scenario: Scenario) -> tuple[Simulator, Controller]:
    """Return simulator and controller of a run; the controller has the nominal parameters.

    Raises
    ------
    InvalidParameterError, MissingEngineError
        If the settings do not fit together or the plant's package is not installed.
    """
    simulation = replace(
        conditions.simulator, initial_state=tuple(scenario.start), seed=scenario.seed
    )
    # Streams 0, 1 and 3 of this seed belong to the simulator.
    rng = np.random.default_rng([scenario.seed, 2])
    robot = perturbed(conditions.robot, conditions.perturbation / 100.0, rng)
    disturbances = replace(conditions.disturbances, **scenario.disturbances)
    # The limits of the drives are those of the nominal robot.
    body = conditions.rigid_body.for_robot(conditions.robot)
    plant = make_plant(simulation.plant, robot, scenario.start, body, disturbances)
    return Simulator(simulation, robot, plant), Controller(conditions.controller, conditions.robot)


def run_scenario(conditions: StudyConditions, scenario: Scenario) -> RunRecord:
    """Run a scenario and evaluate the run.

    A run that crashes is recorded as such, so that the study continues with the others.

    Raises
    ------
    MemoryError, OSError
        If the machine cannot make the run; that is no result of the run.
    """
    strategy = conditions.controller.strategy
    try:
        simulator, controller = prepare(conditions, scenario)
        trajectory = run_closed_loop(
            simulator,
            controller,
            scenario.goal,
            conditions.duration,
            conditions.controller.control_period,
            latency=conditions.latency,
            push=scenario.push,
        )
        inputs = followed_inputs(trajectory.holds, conditions.duration)
        results = _results(trajectory, scenario.goal, inputs)
        settling = results["settle_time_s"]
        if scenario.push is not None and trajectory.at_push.size and settling is not None:
            results["recover_s"] = max(0.0, float(settling) - scenario.push.time)
    except (MemoryError, OSError):
        raise
    except Exception as error:
        crash = f"{type(error).__name__}: {error}"
        return RunRecord({"strategy": strategy, "settled": False, "crash": crash})
    results |= stability_of(trajectory.decisions, scenario.goal, conditions)
    results = {"strategy": strategy, **results, "failures": controller.failures}
    return RunRecord(results, inputs.times, inputs.speeds, trajectory.at_push)


def _results(trajectory: Trajectory, goal: Vector, inputs: FirstOrderHold) -> dict[str, Value]:
    planned = [d.plan.solve_time for d in trajectory.decisions if d.solved]
    solve_times = np.array(planned)
    speeds = np.vstack((trajectory.speeds, inputs.speeds))
    measured = measure(
        trajectory.times, trajectory.states, goal, speeds, trajectory.torques, solve_times
    )
    results = {name: finite(value) for name, value in asdict(measured).items()}
    errors = state_errors(trajectory.states, goal)
    index = settling_index(errors, LOOSELY_SETTLED)
    if index is not None:
        results["loose_settle_time_s"] = float(trajectory.times[index])
        results["tail_error_p95"] = float(np.percentile(errors[index:], 95.0))
    results["max_rotor_speed"] = _rounded(float(np.max(np.abs(speeds))))
    results["max_rotor_acceleration"] = _rounded(
        max(
            _largest_slope(inputs.times, inputs.speeds),
            _largest_slope(trajectory.times, trajectory.speeds),
        )
    )
    if planned:
        results["solve_ms_max"] = 1e3 * max(planned)
    return results


def _largest_slope(times: Vector, speeds: Vector) -> float:
    if times.size < 2:
        return 0.0
    slopes = np.diff(speeds, axis=0) / np.diff(times)[:, None]
    return float(np.max(np.abs(slopes)))


def _rounded(value: float) -> float:
    """Return the value without the digits in which difference quotients are inaccurate."""
    return float(f"{value:.9g}")
