# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Comparison of the plant with contact, the ideal rolling plant and the printed Eq. (12).

``python bench/documents/compare_plants.py --out docs`` writes ``rigid_body_figures.md`` and
``rigid_body.png``; docs/rigid_body.md explains them.
"""

import argparse
import math
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib
import mujoco
import numpy as np
from matplotlib.axes import Axes
from model_tables import KNOT_PERIOD, ROBOT, STEP, deviation, ramped, run
from printed_model import PrintedModel
from tables import conditions_of, header, row

from sphere_nmpc.model.disturbance import GRAVITY
from sphere_nmpc.model.rotation import random_quaternion, vertical
from sphere_nmpc.model.state import (
    QUATERNION,
    Vector,
    angle_error,
    position_error,
    upright_state,
)
from sphere_nmpc.model.torque import rotor_acceleration
from sphere_sim.evaluation.metrics import angle_errors
from sphere_sim.world.disturbances import Push
from sphere_sim.world.plant.rigid_body.rigid_body_plant import RigidBodyPlant
from sphere_sim.world.plant.rolling_plant import RollingPlant

matplotlib.use("Agg")
from matplotlib import pyplot as plt

KNOTS = 10
IDEAL = "drive_bandwidth=1e6 drive_feedforward=true torque_limit=1e3 "
"""Drives without lag or limit, so that only contact and integration differ."""
SLIPPING = 1e-3
"""Speed of the shell over the floor from which it counts as slipping [m/s]."""
ERRORS = ("position, median [mm]", "worst", "angle, median [mrad]", "worst")
OF_VARIANTS = ("plant", *ERRORS, "slipping [% of time]", "cost [ms/s]")

DRIVES = {
    "ideal drives": IDEAL,
    "default (300 rad/s, 3.2 N m)": "",
    "default with feed-forward": "drive_feedforward=true",
    "100 rad/s": "drive_bandwidth=100",
    "torque limit 1.6 N m": "torque_limit=1.6",
    "torque limit 0.8 N m": "torque_limit=0.8",
}
"""Settings of variants of the plant with contact, by name."""
_SMALL = (1e-5, 1e-4, 1e-3)
FLOORS = {
    **{f"friction {mu:g}": f"rigid_body.friction={mu}" for mu in (0.8, 0.4, 0.3, 0.2, 0.1)},
    **{f"{kind} friction {1e3 * value:g} mm": f"{kind}_friction={value}"
       for kind in ("rolling", "torsional") for value in _SMALL},
    **{f"roughness {1e3 * value:g} mm, bumps 0.5 m apart": f"floor_roughness={value}"
       for value in _SMALL},
    **{f"slope {degrees} degree": f"disturbances.slope={math.radians(degrees)}"
       for degrees in (0.1, 1)},
}
TIME_CONSTANTS = (0.002, 0.004, 0.008, 0.016, 0.032, 0.064)


def _stiffness(impedance: float) -> dict[str, str]:
    found = {}
    for constant in TIME_CONSTANTS:
        # Penetration of the contact under the weight at rest.
        sunk = (1 - impedance) / impedance * GRAVITY * constant**2
        about = f"impedance {impedance:g} (sinks {1e6 * sunk:.2g} um)"
        found[f"{1e3 * constant:g} ms, {about}"] = (
            f"{IDEAL}time_step=0.001 contact_time_constant={constant} "
            f"contact_impedance={impedance}"
        )
    return found


STIFFNESS = {f"impedance {value:g}": _stiffness(value) for value in (0.9, 0.999)}
"""Variants of each curve of the figure."""
TIME_STEPS = (0.0005, 0.001, 0.002, 0.004, 0.008)
STEPS = {
    label: {f"{1e3 * step:g} ms, {label}": f"{IDEAL}time_step={step} contact_time_constant="
            f"{constant or 2.0 * step}" for step in TIME_STEPS}
    for label, constant in (("contact 16 ms", 0.016), ("contact 2 time steps", 0.0))
}
OPTIONS: dict[str, tuple[str, object]] = {
    "Runge-Kutta, elliptic cone, ratio 10 (chosen)": ("impratio", 10.0),
    "semi-implicit Euler": ("integrator", mujoco.mjtIntegrator.mjINT_EULER),
    "implicitfast": ("integrator", mujoco.mjtIntegrator.mjINT_IMPLICITFAST),
    "implicit": ("integrator", mujoco.mjtIntegrator.mjINT_IMPLICIT),
    "pyramidal cone": ("cone", mujoco.mjtCone.mjCONE_PYRAMIDAL),
    "impedance ratio 1": ("impratio", 1.0),
    "impedance ratio 100": ("impratio", 100.0),
}
"""Option of the engine that is set in each variant."""


class Drawn(NamedTuple):
    """A start at rest, (6,), rotor speeds of `ramped`, and the states of ideal rolling."""

    start: Vector
    speeds: Vector
    ideal: Vector

    @classmethod
    def of(cls, seed: int, number: int) -> "Drawn":
        """Draw an orientation uniform on SO(3) and knots uniform in +-u_max."""
        rng = np.random.default_rng([seed, number])
        start = np.concatenate(([0.0, 0.0], random_quaternion(rng)))
        limit = ROBOT.max_rotor_speed
        speeds = ramped(rng.uniform(-limit, limit, (KNOTS, 2)))
        return cls(start, speeds, run(RollingPlant(ROBOT, start), speeds))


def contact(start: Vector, settings: str = "") -> RigidBodyPlant:
    """Return the plant with contact with settings as of a study, at a start, (6,)."""
    conditions = conditions_of(f"simulator.plant=rigid_body {settings}", 1.0)
    own: Any = conditions.of_plant
    return RigidBodyPlant(ROBOT, start, own, conditions.disturbances)


def spread(pairs: Sequence[tuple[float, float]]) -> list[str]:
    """Return median and largest distance [mm] and angle [mrad] of deviations [m, rad]."""
    return [f"{1e3 * of(part):.3g}" for part in np.array(pairs).T for of in (np.median, np.max)]


class Comparison:
    """All comparisons on one set of sequences; each method returns lines of Markdown."""

    def __init__(self, number: int, seed: int) -> None:
        self.drawn = [Drawn.of(seed, i) for i in range(number)]
        self.figure, self.axes = plt.subplots(1, 3, figsize=(13, 4), constrained_layout=True)

    def variant(self, name: str, settings: str, option: tuple[str, object] | None = None
                ) -> tuple[str, Vector]:
        """Return the row of a variant and the largest angle in each sequence [rad]."""
        plant = contact(self.drawn[0].start, settings)
        if option is not None:
            setattr(plant._model.opt, *option)
        found, slips, wall = [], [], 0.0
        for start, speeds, ideal in self.drawn:
            plant.reset(start)
            states = []
            for there in speeds[1:]:
                began = time.perf_counter()
                plant.advance(there, STEP)
                wall += time.perf_counter() - began
                states.append(plant.state)
                slips.append(np.linalg.norm(plant.slip) > SLIPPING)
            found.append(deviation(np.array(states), ideal))
        cost = 1e3 * wall / (len(self.drawn) * KNOTS * KNOT_PERIOD)
        line = row(name, *spread(found), f"{100.0 * np.mean(slips):.1f}", f"{cost:.0f}")
        print(line, flush=True)
        return line, np.array(found)[:, 1]

    def section(
        self, title: str, curves: dict[str, dict[str, str]], axes: Axes | None = None,
        times: Sequence[float] = (), label: str = "",
    ) -> list[str]:
        """Return a section, and draw the angles of each curve over times [s]."""
        lines = heading(title, *OF_VARIANTS)
        for name, variants in curves.items():
            found = [self.variant(*each) for each in variants.items()]
            lines += [line for line, _ in found]
            if axes is not None:
                angles = 1e3 * np.array([angle for _, angle in found])
                x = 1e3 * np.array(times)
                curve = axes.loglog(x, np.median(angles, axis=1), "o-", label=name)[0]
                axes.loglog(x, angles.max(axis=1), ":", color=curve.get_color())
        if axes is not None:
            finish(axes, label, "angle from the rolling plant [mrad]",
                   "median (line) and worst (dotted)")
        return lines

    def options(self) -> list[str]:
        title = "Options of the engine (ideal drives, default contact, 2 ms)"
        return [*heading(title, *OF_VARIANTS), *(
            self.variant(name, IDEAL, option)[0] for name, option in OPTIONS.items()
        )]

    def erratum(self) -> list[str]:
        rigid = [run(contact(s.start, IDEAL), s.speeds) for s in self.drawn]
        times = np.arange(1, rigid[0].shape[0] + 1) * STEP
        printed = {
            "Eqs. (7), (12), sign of the third line corrected": ("sign corrected", True),
            "Eqs. (7), (12) as printed": ("as printed", False),
        }
        runs = {"rolling plant": [s.ideal for s in self.drawn]} | {
            name: [run(PrintedModel(ROBOT, s.start, corrected), s.speeds) for s in self.drawn]
            for name, (_, corrected) in printed.items()
        }
        lines = heading("Eq. (12) against the plant with contact (ideal drives)", "model", *ERRORS)
        for name, found in runs.items():
            pairs = list(zip(found, rigid, strict=True))
            lines.append(row(name, *spread([deviation(*pair) for pair in pairs])))
            print(lines[-1], flush=True)
            if name in printed:
                angles = np.median([angle_errors(*pair) for pair in pairs], axis=0)
                self.axes[2].semilogy(times, 1e3 * angles, label=printed[name][0])
        finish(self.axes[2], "time [s]", "median angle from the plant with contact [mrad]",
               "Eq. (12)")
        return lines

    def torque(self) -> list[str]:
        lines = heading(
            "Rotor torque, Eqs. (44) to (46), predicted less measured",
            "drives", "rms [N m]", "99 %", "worst", "worst, 30 ms after a knot left out",
            "largest measured [N m]", "Eq. (46) over an interval, worst",
        )
        steps = round(KNOT_PERIOD / STEP)
        for name, settings in (("ideal", IDEAL), ("default", "")):
            found, means = [], []
            for start, speeds, _ in self.drawn:
                plant, measured, predicted = contact(start, settings), [], []
                rates: list[Vector] = [np.zeros(4)]
                slopes = np.diff(speeds, axis=0) / STEP
                for there, slope in zip(speeds[1:], slopes, strict=True):
                    plant.advance(there, STEP)
                    measured.append(plant.rotor_torques)
                    rates.append(np.concatenate((plant.body_rate[:2], plant.rotor_speeds)))
                    predicted.append(eq45(plant.state, plant.rotor_speeds, slope))
                found.append((measured, predicted))
                change = np.diff(rates[::steps], axis=0) / KNOT_PERIOD
                eq46 = ROBOT.rotor_axial_inertia * (change[:, :2] + change[:, 2:])
                intervals = np.reshape(measured, (KNOTS, steps, 2))
                means.append(np.abs(eq46 - np.mean(intervals, axis=1)))
            torques = np.array(found)  # sequence, measured or predicted, step, rotor
            error = np.abs(torques[:, 1] - torques[:, 0])
            settled = error[:, np.arange(error.shape[1]) % steps >= 3]
            numbers = (np.sqrt(np.mean(error**2)), np.percentile(error, 99), error.max(),
                       settled.max())
            lines.append(row(name, *(f"{number:.2g}" for number in numbers),
                             f"{np.abs(torques[:, 0]).max():.3g}", f"{np.max(means):.2g}"))
            print(lines[-1], flush=True)
        return lines

    def push(self) -> list[str]:
        rest = contact(upright_state(0.0, 0.0, 0.0))
        rest.push([1.0, 0.0])
        slipped, start_velocity = 0.0, rest.velocity[0]
        while np.linalg.norm(rest.slip) > SLIPPING:
            rest.advance(np.zeros(2), 0.001)
            slipped += 0.001
        at_roll = rest.velocity[0]
        rest.advance(np.zeros(2), 5.0 - slipped)
        ends, momenta = [], []
        for start, speeds, _ in self.drawn:
            plant = contact(start)
            pushed = run(plant, speeds, push=Push(2.5, (1.0, 0.0)))
            ends.append((run(contact(start), speeds)[-1], pushed[-1]))
            momenta.append(plant.momentum)
        moved, turned = ([of(*pair) for pair in ends] for of in (position_error, angle_error))
        spread = np.abs(np.array(momenta) - [0.0, ROBOT.shell_radius, 0.0]).max()
        return [
            "## A push of 1 N s along x (default settings)\n",
            f"- At rest, rotors held: {start_velocity:.4f} m/s at first, slips for "
            f"{1e3 * slipped:.0f} ms, rolls on at {at_roll:.4f} m/s; after 5 s it is at "
            f"x = {rest.state[0]:.3f} m and rolls at {rest.velocity[0]:.4f} m/s.",
            f"- In motion, pushed at 2.5 s of each sequence: 2.5 s later {np.median(moved):.3f} m "
            f"(median; worst {np.max(moved):.3f} m) and {np.median(turned):.2f} rad (worst "
            f"{np.max(turned):.2f} rad) from the run without a push.",
            "- Angular momentum about the contact point then differs from Rs J = "
            f"{ROBOT.shell_radius:.2f} N m s about y by {spread:.1e} N m s at most.",
        ]


def slope() -> list[str]:
    angle = math.radians(1.0)
    plant = contact(upright_state(0.0, 0.0, 0.0), f"disturbances.slope={angle}")
    plant.advance(np.zeros(2), 5.0)
    gain = ROBOT.total_mass * GRAVITY * math.sin(angle) * ROBOT.shell_radius
    full = ROBOT.rotor_axial_inertia * ROBOT.max_rotor_speed
    return [
        "## A slope of 1 degree (default settings)\n",
        f"- Rotors held: after 5 s {plant.state[0]:.3f} m downhill at "
        f"{plant.velocity[0]:.3f} m/s.",
        f"- Gravity adds {gain:.3f} N m s of angular momentum each second; a rotor stores "
        f"{full:.2f} N m s at full speed, so one rotor alone holds the sphere for "
        f"{full / gain:.1f} s (computed).",
    ]


def eq45(state: Vector, u: Vector, du: Vector) -> Vector:
    """Return the torques of Eq. (45) at a state, shape (2,) [N m]."""
    up = vertical(state[None, QUATERNION])
    found = rotor_acceleration(up, u[None], du[None], ROBOT.lumped.as_array())
    torque: Vector = ROBOT.rotor_axial_inertia * found[0]
    return torque


def heading(title: str, *columns: str) -> list[str]:
    """Return the lines at the beginning of a section with a table."""
    return [f"## {title}\n", header(*columns)]


def finish(axes: Axes, x: str, y: str, title: str) -> None:
    axes.set(xlabel=x, ylabel=y, title=title)
    axes.grid(alpha=0.3, which="both" if axes.get_xscale() == "log" else "major")
    axes.legend(fontsize=8)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, required=True, help="folder for table and figure")
    parser.add_argument("--sequences", type=int, default=100, help="input sequences of 5 s")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    of = Comparison(given.sequences, given.seed)
    parts = [
        ["# Figures of the plant with contact"],
        [f"Written by bench/documents/compare_plants.py: {given.sequences} sequences of 5 s, "
         f"seed {given.seed}."],
        of.section("Drives", {"": DRIVES}),
        of.section("Contact stiffness (ideal drives, time step 1 ms)", STIFFNESS, of.axes[0],
                  TIME_CONSTANTS, "contact time constant [ms], time step 1 ms"),
        of.section("Time step (ideal drives)", STEPS, of.axes[1], TIME_STEPS, "time step [ms]"),
        of.options(), of.erratum(), of.torque(),
        of.section("Floors (default drives, open loop)", {"": FLOORS}), of.push(), slope(),
    ]
    given.out.mkdir(parents=True, exist_ok=True)
    text = "\n\n".join("\n".join(lines) for lines in parts)
    (given.out / "rigid_body_figures.md").write_text(f"{text}\n")
    of.figure.savefig(given.out / "rigid_body.png", dpi=120)


if __name__ == "__main__":
    main()
