# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Identification of robots that are drawn, by the motion of examples/identification_motion.py.

    python bench/identify.py --draw 100 --seed 1            # about ten minutes
    python bench/identify.py --draw 20 --seed 1 --imu       # an IMU beside the poses
    python bench/identify.py --draw 20 --seed 1 --plant rigid_body
    python bench/identify.py --seed 1 --goals 20            # a robot driven with its file
    python bench/identify.py --draw 20 --seed 1 --inside    # IMU and encoders alone

Each robot has masses, sizes and inertias that are up to 10 % (`--wrong`) off those given, as are
the limits of its drives, a lag up to 20 ms, and stamps of poses up to 20 ms early or late. Poses
have noise of 2 mm and 6 mrad, encoders of 0.05 rad/s. Errors are relative, those of times in ms,
and those of vectors the largest component in SI units.
"""

import argparse
import importlib.util
import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from sphere_nmpc.estimation.imu import ImuSettings
from sphere_nmpc.model import rotation
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.process.library_threads import limit_library_threads
from sphere_nmpc.settings import ControllerSettings
from sphere_sim.evaluation.metrics import angle_errors, position_errors
from sphere_sim.evaluation.series import Series
from sphere_sim.identification.bag import Recorded
from sphere_sim.identification.drives import Commands
from sphere_sim.identification.identify import Given, Identified, identified
from sphere_sim.identification.inertial import Readings
from sphere_sim.scenario.perturbation import perturbed
from sphere_sim.scenario.scenarios import draw_scenarios
from sphere_sim.study.conditions import StudyConditions
from sphere_sim.study.single_run import assemble, closed_loop
from sphere_sim.world.imu_sensor import SimulatedImuSettings
from sphere_sim.world.plant.rigid_body.settings import RigidBodySettings
from sphere_sim.world.settings import SimulatorSettings
from sphere_sim.world.simulator import Simulator

EXAMPLE = Path(__file__).parents[1] / "examples" / "identification_motion.py"
POSITION_NOISE, ORIENTATION_NOISE, SPEED_NOISE = 2e-3, 6e-3, 0.05
LONGEST_LAG, LONGEST_OFFSET = 0.02, 0.02
BEYOND = 1.15
"""Commands over the given speed limit, which then is reached by drives 10 % better than given."""
WITHIN = {
    "robot.shell_radius": 1e-3, "c1": 5e-3, "r1": 5e-3, "r3": 5e-3,
    "offset of pose stamps": 2.0, "lag of the drives": 2.0,
    "robot.max_rotor_acceleration": 0.02, "robot.max_rotor_speed": 0.02,
}
"""Errors to reach, relative or [ms]."""
_SECOND = 1_000_000_000


def example() -> Any:
    """Return the module of the example."""
    spec = importlib.util.spec_from_file_location(EXAMPLE.stem, EXAMPLE)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


class Drawn:
    """A robot that is drawn, and the recording of its motion.

    `given` is what is known of it; `true` the true values by the names of rows.
    """

    def __init__(
        self, seed: int, wrong: float = 0.1, plant: str = "rolling", with_imu: bool = False,
        duration: float = 60.0, inside: bool = False,
    ) -> None:
        rng = np.random.default_rng([seed, 20])
        self.given = RobotParameters()
        u, a, self.lag = *rng.uniform(1.0 - wrong, 1.0 + wrong, 2), rng.uniform(0.0, LONGEST_LAG)
        self.robot = replace(
            perturbed(self.given, wrong, rng),
            max_rotor_speed=self.given.max_rotor_speed * u,
            max_rotor_acceleration=self.given.max_rotor_acceleration * a,
        )
        self.late = rng.uniform(-LONGEST_OFFSET, LONGEST_OFFSET)
        turn = rotation.random_quaternion(rng)
        place = rng.uniform(-0.1, 0.1, 3)
        self.imu = SimulatedImuSettings(
            position=tuple(place.tolist()), orientation=tuple(turn.tolist()),
            position_deviation=0.0, orientation_deviation=0.0,
        )
        self.simulator = Simulator(
            SimulatorSettings(
                plant=plant, initial_state=(0.0, 0.0, 1.0, 0.0, 0.0, 0.0), seed=seed,
                position_noise=POSITION_NOISE, orientation_noise=ORIENTATION_NOISE,
            ),
            self.robot, imu=self.imu if with_imu else None,
        )
        own = RigidBodySettings().for_robot(self.robot)
        self._servo = 1.0 / own.drive_bandwidth if plant == "rigid_body" else 0.0
        self._speed_noise = SPEED_NOISE
        self.recorded = self._recorded(rng, duration)
        self.known_imu = self.imu if inside else ImuSettings()
        """What is known of the IMU: from inside its axes are not found."""
        if inside:
            self.recorded = replace(self.recorded, are_outside=False)

    @property
    def true(self) -> dict[str, tuple[float, ...]]:
        """True values by the names of rows."""
        names = ("robot.shell_radius", "c1", "r1", "r3")
        lumped = self.robot.lumped.as_array().tolist()
        found = {name: (value,) for name, value in zip(names, lumped, strict=True)} | {
            "offset of pose stamps": (self.late,), "lag of the drives": (self.lag + self._servo,),
            "robot.max_rotor_acceleration": (self.robot.max_rotor_acceleration,),
            "robot.max_rotor_speed": (self.robot.max_rotor_speed,),
            "slope along x and y": (0.0, 0.0), "centre of mass": (0.0, 0.0, 0.0),
            "pose_position_noise": (POSITION_NOISE,),
            "pose_orientation_noise": (ORIENTATION_NOISE,),
        }
        if self.simulator.imu is not None:
            found |= {"imu.position": self.imu.position, "imu.orientation": self.imu.orientation,
                      "offset of IMU stamps": (0.5 / self.imu.rate,)}
        return found

    def _recorded(self, rng: np.random.Generator, duration: float) -> Recorded:
        times, wanted = example().motion(BEYOND)
        times = np.round(times, 2)
        simulator, plant = self.simulator, self.simulator.plant
        stamps, poses, speeds, readings = [], [], [], simulator.imu_readings()
        for k in range(round(100 * duration) + 1):
            simulator.advance_to(k * _SECOND // 100)
            stamps.append(k / 100)
            poses.append(simulator.measured_state())
            speeds.append(plant.rotor_speeds)
            readings += simulator.imu_readings()
            now = int(np.searchsorted(times, k / 100 + 1e-9, side="right")) - 1
            simulator.follower.follow_speeds(wanted[now], k / 100)
        at = np.array(stamps)
        place = np.searchsorted(times, at + 1e-9, side="right") - 1
        inertial = Readings(
            np.array([one.stamp / _SECOND for one in readings]),
            np.array([one.rate for one in readings]), np.array([one.force for one in readings]),
        ) if readings else None
        noisy = np.array(speeds) + self._speed_noise * rng.normal(size=(at.size, 2))
        commands = Series(at - self.lag, wanted[place])
        return Recorded(
            Series(at + self.late, np.array(poses)), Series(at, noisy), Series(), True,
            self.robot.shell_radius, Commands.of_speeds(commands), inertial,
            "/controller", {}, [],
        )


def errors(drawn: Drawn, found: Identified) -> dict[str, list[float]]:
    """Return errors and errors over deviations, one after the other, by the names of rows."""
    result = {}
    for row in found.rows:
        if row.name not in drawn.true or not row.deviation:
            continue
        true = np.array(drawn.true[row.name])
        value, deviation = np.array(row.value), np.array(row.deviation)
        if row.name == "imu.orientation":
            turned = rotation.product(value, rotation.conjugate(true))
            error = rotation.logarithm(turned)
        else:
            error = value - true
        scale = 1e3 if row.unit == "s" else 1.0 if true.size > 1 else 1.0 / true[0]
        result[row.name] = [float(np.max(np.abs(error))) * scale, *(error / deviation).tolist()]
    return result


def one(number: int, arguments: argparse.Namespace) -> dict[str, Any]:
    """Return the errors of a robot."""
    drawn = Drawn(
        1000 * arguments.seed + number, arguments.wrong, arguments.plant,
        arguments.imu or arguments.inside, inside=arguments.inside,
    )
    found = identified(drawn.recorded, Given(drawn.given, imu=drawn.known_imu))
    away = np.linalg.norm(drawn.recorded.states[:, :2], axis=1)
    return {"errors": errors(drawn, found), "reach": float(np.max(away)), "check": found.check}


def drive(seed: int, goals: int) -> None:
    """Print how a drawn robot gets to goals with given, identified and true parameters.

    Poses are exact and constants are not learnt on the way; settled is within 1 cm.
    """
    drawn = Drawn(seed)
    found = identified(drawn.recorded, Given(drawn.given))
    for name, robot in (
        ("given", drawn.given), ("identified", found.robot), ("true", drawn.robot)
    ):
        learns_nothing = ControllerSettings(learning=False)
        conditions = StudyConditions(15.0, robot=robot, controller=learns_nothing)
        rows = []
        for case in draw_scenarios(goals, seed):
            run = closed_loop(conditions, case, assemble(conditions, case, drawn.robot))
            left = position_errors(run.states, case.goal)
            late = np.flatnonzero(left > 0.01)
            settled = run.times[late[-1]] if late[-1] + 1 < left.size else math.inf
            turned = np.degrees(angle_errors(run.states, case.goal)[-1])
            rows.append((settled, 1e3 * left[-1], turned))
        (time, place, turn), count = np.median(rows, axis=0), sum(row[0] < 15.0 for row in rows)
        print(f"{name:12} settled {count} of {goals}, after {time:.2f} s; at the end "
              f"{place:.2g} mm and {turn:.2g} degrees off")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draw", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--wrong", type=float, default=0.1)
    parser.add_argument("--plant", default="rolling")
    parser.add_argument("--imu", action="store_true")
    parser.add_argument("--inside", action="store_true")
    parser.add_argument("--goals", type=int, default=0)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    limit_library_threads()
    if arguments.goals:
        drive(1000 * arguments.seed, arguments.goals)
        return
    results = [one(number, arguments) for number in range(arguments.draw)]
    names = list(dict.fromkeys(name for result in results for name in result["errors"]))
    print(f"{'':30} median     largest    to reach   seen  within 2 deviations")
    for name in names:
        seen = [result["errors"][name] for result in results if name in result["errors"]]
        sizes, ratios = [one[0] for one in seen], [z for one in seen for z in one[1:]]
        share = 100.0 * np.mean(np.abs(ratios) < 2.0)
        print(f"{name:30} {np.median(sizes):<10.2g} {max(sizes):<10.2g} "
              f"{WITHIN.get(name, math.nan):<10.2g} {len(seen):<5} {share:.0f} %")
    print(f"farthest from the start: {max(result['reach'] for result in results):.2f} m")
    print(results[0]["check"].removeprefix("; "))
    if arguments.json:
        arguments.json.write_text(json.dumps(results))


if __name__ == "__main__":
    main()
