# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Comparison of the plant with contact, the ideal rolling plant and the printed Eq. (12).

``python bench/documents/compare_plants.py --out docs`` writes ``rigid_body_figures.md`` and
``rigid_body.png``; docs/rigid_body.md explains them.
"""

import argparse
import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib
import mujoco
import numpy as np
from matplotlib.axes import Axes
from plant_runs import KNOT_PERIOD, STEP, deviation, ramped, run
from printed_model import PrintedModel
from tables import header, row

from sphere_nmpc.model.disturbance import GRAVITY
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.rotation import random_quaternion, vertical
from sphere_nmpc.model.state import QUATERNION, Vector, angle_error, position_error
from sphere_nmpc.model.torque import rotor_acceleration
from sphere_sim.evaluation.metrics import angle_errors
from sphere_sim.world.disturbances import DisturbanceSettings
from sphere_sim.world.plant.rigid_body.rigid_body_plant import RigidBodyPlant
from sphere_sim.world.plant.rigid_body.settings import RigidBodySettings
from sphere_sim.world.plant.rolling_plant import RollingPlant

matplotlib.use("Agg")
from matplotlib import pyplot as plt

ROBOT = RobotParameters()
KNOTS = 10
DEFAULT = RigidBodySettings()
IDEAL = RigidBodySettings(drive_bandwidth=1e6, drive_feedforward=True, torque_limit=1e3)
"""Drives without lag or limit, so that only contact and integration differ."""
TIME_CONSTANTS = (0.002, 0.004, 0.008, 0.016, 0.032, 0.064)
TIME_STEPS = (0.0005, 0.001, 0.002, 0.004, 0.008)
SLIPPING = 1e-3
"""Speed of the shell over the floor from which it counts as slipping [m/s]."""
HEADER = header("plant", "position, median [mm]", "worst", "angle, median [mrad]", "worst",
                "slipping [% of time]", "cost [ms/s]")


class Sequence(NamedTuple):
    """A start at rest, shape (6,), and the rotor speeds of `ramped`, (steps + 1, 2)."""

    start: Vector
    speeds: Vector


def draw_sequence(seed: int, number: int) -> Sequence:
    """Draw an orientation uniform on SO(3) and knots uniform in +-u_max."""
    rng = np.random.default_rng([seed, number])
    start = np.concatenate(([0.0, 0.0], random_quaternion(rng)))
    limit = ROBOT.max_rotor_speed
    return Sequence(start, ramped(rng.uniform(-limit, limit, (KNOTS, 2))))


@dataclass(frozen=True)
class Variant:
    """Settings of the plant with contact; `alter` changes its compiled MuJoCo model in place."""

    settings: RigidBodySettings = DEFAULT
    disturbances: DisturbanceSettings | None = None
    alter: Callable[[Any], None] = lambda model: None


def engine_options() -> dict[str, Variant]:
    """Return variants with other options of the engine."""

    def option(name: str, value: object) -> Variant:
        return Variant(IDEAL, alter=lambda model: setattr(model.opt, name, value))

    return {
        "Runge-Kutta, elliptic cone, ratio 10 (chosen)": Variant(IDEAL),
        "semi-implicit Euler": option("integrator", mujoco.mjtIntegrator.mjINT_EULER),
        "implicitfast": option("integrator", mujoco.mjtIntegrator.mjINT_IMPLICITFAST),
        "implicit": option("integrator", mujoco.mjtIntegrator.mjINT_IMPLICIT),
        "pyramidal cone": option("cone", mujoco.mjtCone.mjCONE_PYRAMIDAL),
        "impedance ratio 1": option("impratio", 1.0),
        "impedance ratio 100": option("impratio", 100.0),
    }


def floors() -> dict[str, Variant]:
    """Return variants with other floors."""
    found: dict[str, Variant] = {}
    for mu in (0.8, 0.4, 0.3, 0.2, 0.1):
        found[f"friction {mu:g}"] = Variant(replace(DEFAULT, friction=mu))
    small = (1e-5, 1e-4, 1e-3)
    for value in small:
        friction = DisturbanceSettings(rolling_friction=value)
        found[f"rolling friction {1e3 * value:g} mm"] = Variant(disturbances=friction)
    for value in small:
        friction = DisturbanceSettings(torsional_friction=value)
        found[f"torsional friction {1e3 * value:g} mm"] = Variant(disturbances=friction)
    for value in small:
        rough = replace(DEFAULT, floor_roughness=value)
        found[f"roughness {1e3 * value:g} mm, bumps 0.5 m apart"] = Variant(rough)
    for degrees in (0.1, 1):
        tilted = DisturbanceSettings(slope=math.radians(degrees))
        found[f"slope {degrees} degree"] = Variant(disturbances=tilted)
    return found


class Study:
    """All comparisons on one set of sequences; each method returns Markdown."""

    def __init__(self, number: int, seed: int) -> None:
        self.sequences = [draw_sequence(seed, i) for i in range(number)]
        self.reference = [run(RollingPlant(ROBOT, s.start), s.speeds) for s in self.sequences]
        self.figure, self.axes = plt.subplots(1, 3, figsize=(13, 4), constrained_layout=True)

    def compare(self, variant: Variant) -> tuple[list[float], np.ndarray]:
        """Return numbers of a row but its name, and the largest angle in each sequence [rad]."""
        plant = RigidBodyPlant(
            ROBOT, self.sequences[0].start, variant.settings, variant.disturbances
        )
        variant.alter(plant._model)
        found, slips, wall = [], [], 0.0
        for sequence, ideal in zip(self.sequences, self.reference, strict=True):
            plant.reset(sequence.start)
            states = []
            for speeds in sequence.speeds[1:]:
                began = time.perf_counter()
                plant.advance(speeds, STEP)
                wall += time.perf_counter() - began
                states.append(plant.state)
                slips.append(np.linalg.norm(plant.slip) > SLIPPING)
            found.append(deviation(np.array(states), ideal))
        position, angle = np.array(found).T
        simulated = len(self.sequences) * KNOTS * KNOT_PERIOD
        numbers = [
            *(1e3 * float(of(part)) for part in (position, angle) for of in (np.median, np.max)),
            100.0 * float(np.mean(slips)), 1e3 * wall / simulated,
        ]
        return numbers, angle

    def table(self, variants: dict[str, Variant]) -> tuple[list[str], list[np.ndarray]]:
        """Return the rows of variants, and the angles of `compare` of each."""
        rows, angles = [], []
        for name, variant in variants.items():
            (*lengths, slipping, wall), angle = self.compare(variant)
            cells = (*(f"{length:.3g}" for length in lengths), f"{slipping:.1f}", f"{wall:.0f}")
            rows.append(row(name, *cells))
            print(rows[-1], flush=True)
            angles.append(angle)
        return rows, angles

    def section(self, title: str, variants: dict[str, Variant]) -> str:
        return "\n".join([f"## {title}\n", HEADER, *self.table(variants)[0], ""])

    def drives(self) -> str:
        return self.section("Drives", {
            "ideal drives": Variant(IDEAL),
            "default (300 rad/s, 3.2 N m)": Variant(),
            "default with feed-forward": Variant(replace(DEFAULT, drive_feedforward=True)),
            "100 rad/s": Variant(replace(DEFAULT, drive_bandwidth=100.0)),
            "torque limit 1.6 N m": Variant(replace(DEFAULT, torque_limit=1.6)),
            "torque limit 0.8 N m": Variant(replace(DEFAULT, torque_limit=0.8)),
        })

    def stiffness(self) -> str:
        every = []
        for impedance in (0.9, 0.999):
            variants = {}
            for constant in TIME_CONSTANTS:
                settings = replace(
                    IDEAL, time_step=0.001, contact_time_constant=constant,
                    contact_impedance=impedance,
                )
                # Penetration of the contact under the weight at rest.
                sunk = (1 - impedance) / impedance * GRAVITY * constant**2
                about = f"impedance {impedance:g} (sinks {1e6 * sunk:.2g} um)"
                variants[f"{1e3 * constant:g} ms, {about}"] = Variant(settings)
            rows, angles = self.table(variants)
            every += rows
            plot(self.axes[0], TIME_CONSTANTS, angles, f"impedance {impedance:g}")
        finish(self.axes[0], "contact time constant [ms], time step 1 ms")
        title = "## Contact stiffness (ideal drives, time step 1 ms)\n"
        return "\n".join([title, HEADER, *every, ""])

    def time_step(self) -> str:
        every = []
        for label, constant_of in (
            ("contact 16 ms", lambda _: 0.016),
            ("contact 2 time steps", lambda h: 2.0 * h),
        ):
            rows, angles = self.table({
                f"{1e3 * step:g} ms, {label}": Variant(
                    replace(IDEAL, time_step=step, contact_time_constant=constant_of(step))
                )
                for step in TIME_STEPS
            })
            every += rows
            plot(self.axes[1], TIME_STEPS, angles, label)
        finish(self.axes[1], "time step [ms]")
        return "\n".join(["## Time step (ideal drives)\n", HEADER, *every, ""])

    def erratum(self) -> str:
        rigid = [run(RigidBodyPlant(ROBOT, s.start, IDEAL), s.speeds) for s in self.sequences]
        lines = [
            "## Eq. (12) against the plant with contact (ideal drives)\n",
            header("model", "position, median [mm]", "worst", "angle, median [mrad]", "worst"),
        ]
        times = np.arange(1, rigid[0].shape[0] + 1) * 0.01
        models = {
            "rolling plant": lambda s: RollingPlant(ROBOT, s.start),
            "Eqs. (7), (12), sign of the third line corrected": lambda s: PrintedModel(
                ROBOT, s.start, corrected=True
            ),
            "Eqs. (7), (12) as printed": lambda s: PrintedModel(ROBOT, s.start, corrected=False),
        }
        for name, make in models.items():
            runs = [run(make(s), s.speeds) for s in self.sequences]
            pairs = [deviation(a, b) for a, b in zip(runs, rigid, strict=True)]
            position, angle = 1e3 * np.array(pairs).T
            numbers = (of(part) for part in (position, angle) for of in (np.median, np.max))
            lines.append(row(name, *(f"{number:.3g}" for number in numbers)))
            print(lines[-1], flush=True)
            angles = [angle_errors(a, b) for a, b in zip(runs, rigid, strict=True)]
            label = {"corrected": "sign corrected", "printed": "as printed"}.get(name.split()[-1])
            if label:
                self.axes[2].semilogy(times, 1e3 * np.median(angles, axis=0), label=label)
        self.axes[2].set_xlabel("time [s]")
        self.axes[2].set_ylabel("median angle from the plant with contact [mrad]")
        self.axes[2].set_title("Eq. (12)")
        self.axes[2].grid(alpha=0.3)
        self.axes[2].legend(fontsize=8)
        return "\n".join([*lines, ""])

    def torque(self) -> str:
        lines = [
            "## Rotor torque, Eqs. (44) to (46), predicted less measured\n",
            header("drives", "rms [N m]", "99 %", "worst", "worst, 30 ms after a knot left out",
                   "largest measured [N m]", "Eq. (46) over an interval, worst"),
        ]
        for name, settings in (("ideal", IDEAL), ("default", DEFAULT)):
            errors, settled, largest, means = [], [], 0.0, []
            for sequence in self.sequences:
                plant = RigidBodyPlant(ROBOT, sequence.start, settings)
                interval: list[np.ndarray] = []
                before: np.ndarray = np.zeros(4)
                slopes = np.diff(sequence.speeds, axis=0) / STEP
                for i, (speeds, slope) in enumerate(zip(sequence.speeds[1:], slopes, strict=True)):
                    plant.advance(speeds, STEP)
                    measured = plant.rotor_torques
                    predicted = eq45(plant.state, plant.rotor_speeds, slope)
                    error = np.abs(predicted - measured)
                    errors.append(error)
                    if i % 50 >= 3:
                        settled.append(error)
                    interval.append(measured)
                    largest = max(largest, float(np.abs(measured).max()))
                    if i % 50 == 49:
                        after = np.concatenate((plant.body_rate[:2], plant.rotor_speeds))
                        change = (after - before) / KNOT_PERIOD
                        eq46 = ROBOT.rotor_axial_inertia * (change[:2] + change[2:])
                        means.append(np.abs(eq46 - np.mean(interval, axis=0)))
                        interval, before = [], after
            error = np.array(errors)
            numbers = (np.sqrt(np.mean(error**2)), np.percentile(error, 99), error.max(),
                       np.max(settled))
            lines.append(row(name, *(f"{number:.2g}" for number in numbers), f"{largest:.3g}",
                             f"{np.max(means):.2g}"))
            print(lines[-1], flush=True)
        return "\n".join([*lines, ""])

    def push(self) -> str:
        rest = RigidBodyPlant(ROBOT, np.array([0, 0, 1.0, 0, 0, 0]), DEFAULT)
        rest.push([1.0, 0.0])
        slipped = 0.0
        start_velocity = rest.velocity[0]
        while np.linalg.norm(rest.slip) > 1e-3:
            rest.advance(np.zeros(2), 0.001)
            slipped += 0.001
        at_roll = rest.velocity[0]
        rest.advance(np.zeros(2), 5.0 - slipped)
        moved, turned, momenta = [], [], []
        for sequence in self.sequences:
            ends = []
            for impulse in (0.0, 1.0):
                plant = RigidBodyPlant(ROBOT, sequence.start, DEFAULT)
                for i, speeds in enumerate(sequence.speeds[1:]):
                    if i == 250:
                        plant.push([impulse, 0.0])
                    plant.advance(speeds, STEP)
                ends.append(plant.state)
            momenta.append(plant.momentum)
            moved.append(position_error(*ends))
            turned.append(angle_error(*ends))
        spread = np.abs(np.array(momenta) - [0.0, ROBOT.shell_radius, 0.0]).max()
        return "\n".join([
            "## A push of 1 N s along x (default settings)\n",
            f"- At rest, rotors held: {start_velocity:.4f} m/s at first, slips for "
            f"{1e3 * slipped:.0f} ms, rolls on at {at_roll:.4f} m/s; after 5 s it is at "
            f"x = {rest.state[0]:.3f} m and rolls at {rest.velocity[0]:.4f} m/s.",
            f"- In motion, pushed at 2.5 s of each sequence: 2.5 s later {np.median(moved):.3f} m "
            f"(median; worst {np.max(moved):.3f} m) and {np.median(turned):.2f} rad (worst "
            f"{np.max(turned):.2f} rad) from the run without a push.",
            "- Angular momentum about the contact point then differs from Rs J = "
            f"{ROBOT.shell_radius:.2f} N m s about y by {spread:.1e} N m s at most.",
            "",
        ])

    def slope(self) -> str:
        plant = RigidBodyPlant(
            ROBOT, np.array([0, 0, 1.0, 0, 0, 0]), DEFAULT,
            DisturbanceSettings(slope=math.radians(1.0)),
        )
        plant.advance(np.zeros(2), 5.0)
        gain = ROBOT.total_mass * GRAVITY * math.sin(math.radians(1.0)) * ROBOT.shell_radius
        full = ROBOT.rotor_axial_inertia * ROBOT.max_rotor_speed
        return (
            "## A slope of 1 degree (default settings)\n\n"
            f"- Rotors held: after 5 s {plant.state[0]:.3f} m downhill at "
            f"{plant.velocity[0]:.3f} m/s.\n"
            f"- Gravity adds {gain:.3f} N m s of angular momentum each second; a rotor stores "
            f"{full:.2f} N m s at full speed, so one rotor alone holds the sphere for "
            f"{full / gain:.1f} s (computed).\n"
        )


def eq45(state: Vector, u: Vector, du: Vector) -> Vector:
    """Return the torques of Eq. (45) at a state, shape (2,) [N m]."""
    up = vertical(state[None, QUATERNION])
    found = rotor_acceleration(up, u[None], du[None], ROBOT.lumped.as_array())
    torque: Vector = ROBOT.rotor_axial_inertia * found[0]
    return torque


def plot(axes: Axes, times: tuple[float, ...], angles: list[np.ndarray], label: str) -> None:
    x = 1e3 * np.array(times)
    line = axes.loglog(x, [1e3 * np.median(each) for each in angles], "o-", label=label)[0]
    axes.loglog(x, [1e3 * each.max() for each in angles], ":", color=line.get_color())


def finish(axes: Axes, label: str) -> None:
    axes.set_xlabel(label)
    axes.set_ylabel("angle from the rolling plant [mrad]")
    axes.set_title("median (line) and worst (dotted)")
    axes.grid(alpha=0.3, which="both")
    axes.legend(fontsize=8)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, required=True, help="folder for table and figure")
    parser.add_argument("--sequences", type=int, default=100, help="input sequences of 5 s")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    study = Study(given.sequences, given.seed)
    parts = [
        "# Figures of the plant with contact\n",
        f"Written by bench/documents/compare_plants.py: {given.sequences} sequences of 5 s, "
        f"seed {given.seed}.\n",
        study.drives(), study.stiffness(), study.time_step(),
        study.section(
            "Options of the engine (ideal drives, default contact, 2 ms)", engine_options()
        ),
        study.erratum(), study.torque(),
        study.section("Floors (default drives, open loop)", floors()),
        study.push(), study.slope(),
    ]
    given.out.mkdir(parents=True, exist_ok=True)
    (given.out / "rigid_body_figures.md").write_text("\n".join(parts).rstrip() + "\n")
    study.figure.savefig(given.out / "rigid_body.png", dpi=120)


if __name__ == "__main__":
    main()
