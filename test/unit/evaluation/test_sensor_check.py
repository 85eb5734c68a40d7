# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Checks of the sensors of a robot that stands still."""

from collections.abc import Callable

import numpy as np
import pytest

from sphere_nmpc.estimation.imu import ImuSettings
from sphere_nmpc.model.state import upright_state
from sphere_sim.evaluation.sensor_check import FAIL, PASS, WARN, Finding, Sensor, check_sensors

SETTINGS = ImuSettings()
RATE, NUMBER, START = 100.0, 1500, 1_800_000_000 * 10**9
GYRO, FORCE, SPEEDS = slice(3), slice(3, 6), slice(2, 4)
Change = Callable[[Sensor], Sensor | None]


def sensors() -> dict[str, Sensor]:
    """Return IMU, encoders and poses of an upright robot for 15 s, received 2 ms late."""
    rng = np.random.default_rng(11)
    stamps = START + (np.arange(NUMBER) * 1e9 / RATE).astype(np.int64)
    noise = np.repeat([SETTINGS.gyro_noise, SETTINGS.accelerometer_noise], 3) * np.sqrt(RATE)
    true = np.array([0.004, -0.006, 0.002, 0.02, -0.1, 9.86])
    values = true + noise * rng.normal(size=(NUMBER, 6))
    states = np.tile(upright_state(1.0, 2.0, 0.3), (NUMBER, 1))
    states[:, :2] += 1e-3 * rng.normal(size=(NUMBER, 2))
    joints = np.tile([0.3, -1.2, 0.0, 0.0], (NUMBER, 1))
    rows = {"imu": values, "joints": joints, "pose": states}
    return {name: Sensor(stamps + 2_000_000, stamps, row) for name, row in rows.items()}


def checked(changes: dict[str, Change]) -> list[Finding]:
    given = {name: changes.get(name, lambda one: one)(one) for name, one in sensors().items()}
    return check_sensors(given["imu"], given["joints"], given["pose"], SETTINGS)


def values(change: Callable[[np.ndarray], object]) -> Change:
    """Return a change of what messages hold, in place."""
    def changed(sensor: Sensor) -> Sensor:
        held = sensor.values.copy()
        change(held)
        return sensor._replace(values=held)

    return changed


def scaled(part: slice, factor: float) -> Change:
    return values(lambda held: held[:, part].__imul__(factor))


def put(part: object, given: object) -> Change:
    return values(lambda held: held.__setitem__(part, given))


def ahead(seconds: float) -> Change:
    return lambda one: one._replace(stamps=one.stamps + round(seconds * 1e9))


def turning(held: np.ndarray) -> None:
    """Let the sphere roll at 1 rad/s about y, with all else as at rest."""
    angle = np.arange(NUMBER) / RATE
    held[:, 1] += 1.0
    held[:, 3], held[:, 5] = -9.81 * np.sin(angle), 9.81 * np.cos(angle)


def nudged(held: np.ndarray) -> None:
    held[700:760, 0] += 0.05


def test_sensors_as_they_are_expected_pass_every_check() -> None:
    found = checked({})
    assert {one.verdict for one in found} == {PASS}, found
    texts = {one.name: one.text for one in found}
    assert texts["imu rate"] == "100 Hz" and texts["imu stamps"].startswith("2.0 ms old")
    assert texts["up"] == "(+0.00, -0.01, +1.00) in the body, with imu.orientation, as pose has it"
    noise = float(texts["gyro noise"].split()[0])
    assert noise == pytest.approx(SETTINGS.gyro_noise, rel=0.3)
    assert float(texts["pose noise"].split()[0]) == pytest.approx(1.0, rel=0.1)


@pytest.mark.parametrize(("changes", "verdict", "name", "words"), [
    ({"imu": put((slice(None), FORCE), 0.01 * np.random.default_rng(2).normal(size=(NUMBER, 3)))},
     FAIL, "specific force", "gravity removed"),
    ({"imu": scaled(FORCE, 1.0 / 9.81)}, FAIL, "specific force", "in g"),
    ({"imu": scaled(FORCE, 1e3 / 9.81)}, FAIL, "specific force", "in mg"),
    ({"imu": scaled(FORCE, 1e3)}, FAIL, "specific force", "in mm/s^2"),
    ({"imu": scaled(FORCE, 4096.0 / 9.81)}, FAIL, "specific force", "in raw counts"),
    ({"imu": scaled(FORCE, 2.0)}, FAIL, "specific force", "gravity added twice"),
    ({"imu": scaled(FORCE, 1.2)}, WARN, "specific force", "imu.accelerometer_scale"),
    ({"imu": scaled(FORCE, -1.0)}, FAIL, "up", "opposite sign"),
    ({"imu": scaled(GYRO, 57.3)}, FAIL, "gyro bias", "in deg/s"),
    ({"imu": scaled(GYRO, 57.3)}, FAIL, "gyro noise", "in deg/s"),
    ({"imu": scaled(GYRO, 5.0)}, WARN, "gyro noise", "expected imu.gyro_noise: 0.000"),
    ({"imu": put((slice(400, None), slice(None)), 1.0)}, FAIL, "imu readings", "stuck"),
    ({"imu": values(lambda held: held[1::2].__setitem__(slice(None), held[::2]))},
     WARN, "imu readings", "published faster than measured"),
    ({"imu": put((7, 2), np.nan)}, FAIL, "imu readings", "not finite"),
    ({"imu": values(turning)}, FAIL, "imu rest", "expected a robot left alone"),
    ({"imu": values(nudged)}, FAIL, "imu rest", "expected a robot left alone"),
    ({"imu": lambda one: one._replace(stamps=0 * one.stamps)}, FAIL, "imu stamps", "given 0 in"),
    ({"imu": ahead(18.0)}, FAIL, "imu stamps", "18 s ahead of the clock, expected that of the "
     "machine that receives them: GPS time"),
    ({"joints": ahead(1000.0)}, FAIL, "joint_states stamps", "1e+03 s ahead"),
    ({"imu": ahead(-3.0)}, FAIL, "imu stamps", "3 s behind"),
    ({"imu": lambda one: one._replace(stamps=np.roll(one.stamps, 5))}, FAIL, "imu stamps",
     "go back"),
    ({"imu": lambda one: one._replace(stamps=one.stamps // 10**8 * 10**8)}, FAIL, "imu stamps",
     "equal to the one before"),
    ({"imu": lambda one: Sensor(*(column[:5] for column in one))}, FAIL, "imu rate",
     "given 5 messages"),
    ({"imu": lambda one: Sensor(*(column[::4] for column in one))}, WARN, "imu rate",
     "given 25 Hz"),
    ({"joints": lambda one: None}, WARN, "joint_states", "no encoders"),
    ({"joints": lambda one: Sensor(*(column[:0] for column in one))}, FAIL, "joint_states rate",
     "given 0 messages"),
    ({"joints": put((slice(None), SPEEDS), np.nan)}, FAIL, "rotor speeds", "empty velocity"),
    ({"joints": put((slice(None), 0), np.linspace(0.0, 5.0, NUMBER))}, FAIL, "rotor speeds",
     "given 0 while the angles change by 5 rad"),
    ({"joints": put((slice(None), 2), 3.0)}, FAIL, "rotor speeds", "expected rest"),
    ({"joints": put((slice(None), 0), 0.3 + 0.0015 * (np.arange(NUMBER) % 7 > 3))}, WARN,
     "rotor angles", "toggle by 0.0015 rad"),
    ({"joints": put((slice(None), 2), 0.05 * np.random.default_rng(3).normal(size=NUMBER))}, WARN,
     "rotor speeds", "noise of 0.0"),
    ({"joints": put((slice(None), slice(2)), np.nan)}, WARN, "rotor angles", "given none"),
])
def test_wrong_convention_is_found_and_named(changes, verdict, name, words) -> None:
    found = [one for one in checked(changes) if one.name == name]
    assert [one.verdict for one in found] == [verdict], checked(changes)
    assert words in found[0].text


def test_vibration_that_averages_out_is_rest() -> None:
    shaken = np.sin(2.0 * np.pi * 33.3 * np.arange(NUMBER) / RATE)[:, None]

    def vibrating(held: np.ndarray) -> None:
        held[:, GYRO] += 0.02 * shaken
        held[:, FORCE] += 2.0 * shaken

    found = {one.name: one.verdict for one in checked({"imu": values(vibrating)})}
    assert found["imu rest"] == PASS and FAIL not in found.values()


def test_nothing_of_the_imu_is_said_without_readings() -> None:
    found = checked({"imu": lambda one: Sensor(*(column[:0] for column in one))})
    assert [one.name for one in found if one.name.startswith(("imu", "gyro"))] == ["imu rate"]
