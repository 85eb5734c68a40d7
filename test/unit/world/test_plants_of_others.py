# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Plants of other packages: what they give wrong is an error that names plant and quantity."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.foreign.entry_table import Entry
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.quantities import quantity
from sphere_sim.scenario.scenarios import PAPER_CASES
from sphere_sim.study.conditions import StudyConditions
from sphere_sim.study.single_run import run_scenario
from sphere_sim.world.disturbances import DisturbanceSettings, Push
from sphere_sim.world.plant.contract import PlantError, PlantSettings
from sphere_sim.world.plant.factory import make_plant
from sphere_sim.world.plant.rolling_plant import RollingPlant
from sphere_sim.world.settings import PLANTS, SimulatorSettings

ROBOT = RobotParameters()
START = PAPER_CASES[1].start
CONDITIONS = StudyConditions(duration=1.0).with_settings(
    [("strategy", "paper"), ("plant", "rolling")]
)
FAULT = {"kind": "", "at": np.inf}
"""What the plant does wrong from its simulated time on."""


@dataclass(frozen=True)
class OwnSettings(PlantSettings):
    lag: float = quantity(0.1, "s", "A lag")


class Own(RollingPlant):
    """Ideal plant that fails on demand."""

    Settings = OwnSettings

    def __init__(self, robot, state, disturbances, walls, settings) -> None:
        self.settings, self.time = settings, 0.0
        if FAULT["kind"] == "refuses":
            raise InvalidParameterError("mass_offset", 1, "0")
        super().__init__(robot, state, disturbances, walls)
        if FAULT["kind"] == "contact":
            self.contact = None

    def advance(self, speeds_end, duration) -> None:
        super().advance(speeds_end, duration)
        self.time += duration
        if self.fails("raises"):
            raise OSError("no\nfile")

    def fails(self, kind: str) -> bool:
        return FAULT["kind"] == kind and self.time >= FAULT["at"]

    @property
    def state(self):
        found = super().state
        if self.fails("nan"):
            found[1] = np.nan
        return 2.0 * found if self.fails("quaternion") else found

    @property
    def rotor_torques(self):
        return np.zeros(3) if self.fails("shape") else super().rotor_torques

    def push(self, impulse) -> None:
        raise NotImplementedError


@pytest.fixture(autouse=True)
def own(monkeypatch):
    monkeypatch.setitem(globals(), "FAULT", {"kind": "", "at": 0.0})
    monkeypatch.setitem(PLANTS, "own", Entry(f"{__name__}:Own"))


def failing(kind: str, at: float = 0.0) -> None:
    FAULT.update(kind=kind, at=at)


FAULTS = {
    "raises": "plant own: advance: OSError 'no\\nfile'",
    "nan": "plant own: state: given [",
    "quaternion": "plant own: state: quaternion",
    "shape": "plant own: rotor_torques: given the shape (3,), expected 2 finite numbers",
}


def test_plant_of_others_gives_the_results_of_the_same_plant_of_this_package() -> None:
    run, other = (
        run_scenario(replace(CONDITIONS, simulator=SimulatorSettings(plant=name)), PAPER_CASES[1])
        for name in ("rolling", "own")
    )
    assert run.results["final_error"] == other.results["final_error"]
    np.testing.assert_array_equal(run.speeds, other.speeds)


@pytest.mark.parametrize("kind", FAULTS)
def test_run_with_a_plant_that_fails_is_recorded_with_the_reason(kind: str) -> None:
    conditions = CONDITIONS.with_settings([("plant", "own")])
    failing(kind, at=0.5)
    record = run_scenario(conditions, PAPER_CASES[1])
    assert record.results["crash"].startswith(f"PlantError: {FAULTS[kind]}")
    assert "\n" not in record.results["crash"]
    assert not record.results["settled"] and not record.times.size


def test_push_that_a_plant_does_not_have_ends_the_run_with_the_reason() -> None:
    pushed = replace(PAPER_CASES[1], push=Push(0.5, (0.1, 0.0)))
    results = run_scenario(CONDITIONS.with_settings([("plant", "own")]), pushed).results
    assert results["crash"] == "PlantError: plant own: push: NotImplementedError ''"


@pytest.mark.parametrize(
    ("kind", "words", "code"),
    [
        ("refuses", "plant own: cannot be made: mass_offset: given 1, expected 0", 2),
        ("contact", "plant own: contact: given NoneType, expected Contact", 1),
        ("nan", "plant own: state: given [2.0, nan", 1),
    ],
)
def test_plant_that_cannot_be_made_is_named(kind: str, words: str, code: int) -> None:
    failing(kind)
    with pytest.raises(PlantError) as caught:
        make_plant("own", ROBOT, START, None, DisturbanceSettings(), None)
    assert str(caught.value).startswith(words) and caught.value.exit_code == code


def test_settings_of_a_plant_are_those_of_its_name() -> None:
    conditions = CONDITIONS.with_settings([("own.lag", "0.3"), ("plant", "own")])
    assert conditions.of_plant == OwnSettings(0.3) and hash(conditions)
    made = make_plant("own", ROBOT, START, conditions.of_plant)
    assert made._plant.settings == OwnSettings(0.3)
    assert CONDITIONS.with_settings([("plant", "own")]).of_plant == OwnSettings(0.1)
    assert conditions.with_settings([("plant", "rolling")]).of_plant == PlantSettings()
    with pytest.raises(InvalidParameterError, match="floor, imu, odometry, own, rigid_body"):
        CONDITIONS.with_settings([("own.mass", "1")])
    with pytest.raises(InvalidParameterError, match="a setting of controller"):
        CONDITIONS.with_settings([("lag", "0.3")])


def test_settings_of_another_kind_are_refused(monkeypatch) -> None:
    monkeypatch.setattr(Own, "Settings", int)
    with pytest.raises(InvalidParameterError, match=r"plant: given 'own'.*PlantSettings"):
        make_plant("own", ROBOT, START)
