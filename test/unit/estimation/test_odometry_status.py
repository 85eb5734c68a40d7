# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Status of the odometry: which readings can be used, their rate and age, and its values."""

import math

import numpy as np
import pytest

from sphere_nmpc.errors import InvalidInputError
from sphere_nmpc.estimation.imu import ImuSettings
from sphere_nmpc.estimation.odometry import Odometry
from sphere_nmpc.estimation.odometry.status import SensorStream, status_values
from sphere_nmpc.estimation.odometry_settings import OdometrySettings
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.reporting.conditions import ERROR, OK, WARN, Condition, Kind, with_conditions

NOW = 2_000_000_000_000_000_000
STEP = 5_000_000


def accepts(stream: SensorStream, stamp: int, now: int = NOW, is_simulated: bool = False) -> bool:
    return stream.accepts(stamp, np.array([stamp]), now, is_simulated)


def test_rate_and_age_are_those_of_the_newest_stamps() -> None:
    stream = SensorStream("readings")
    assert math.isnan(stream.rate) and stream.age_at(NOW) == math.inf
    for k in (0, 1, 2, 4, 3, 5):  # one is overtaken
        assert accepts(stream, NOW + k * STEP, NOW + k * STEP)
    assert stream.rate == pytest.approx(4 / (5 * 0.005))
    assert stream.age_at(NOW + 7 * STEP) == pytest.approx(0.01)


@pytest.mark.parametrize(
    ("stamp", "now", "is_simulated", "accepted"),
    [
        (0, NOW, False, False), (0, NOW, True, False), (0, 10**8, True, True),
        (NOW + 4 * 10**8, NOW, False, True), (NOW, 10**9, True, False), (10**9, NOW, False, True),
    ],
    ids=["not set", "not set, simulated", "at the start", "a bit ahead", "system clock", "late"],
)
def test_stamp_that_can_be_no_time_of_measurement_is_not_accepted(
    stamp, now, is_simulated, accepted
) -> None:
    assert accepts(SensorStream("readings"), stamp, now, is_simulated) is accepted


def test_reading_far_ahead_of_the_clock_is_refused() -> None:
    with pytest.raises(InvalidInputError, match=r"given 0.6 s ahead .* expected at most 0.5 s"):
        accepts(SensorStream("readings"), NOW + 6 * 10**8)


def test_readings_of_before_a_new_beginning_are_left_out() -> None:
    stream = SensorStream("readings")
    accepts(stream, NOW)
    stream.begin_anew(NOW + STEP)
    assert stream.age_at(NOW) == math.inf
    assert not accepts(stream, NOW + STEP) and accepts(stream, NOW + 2 * STEP)


def test_messages_have_come_until_the_newest_stamp_or_now_if_none_is_newer() -> None:
    stream = SensorStream("readings")
    accepts(stream, NOW)
    assert stream.heard_until(NOW + STEP) == NOW
    assert stream.heard_until(NOW + 2 * STEP) == NOW + 2 * STEP


def test_values_before_a_calibration_are_not_known() -> None:
    odometry = Odometry(OdometrySettings(), ImuSettings(), RobotParameters())
    streams = [SensorStream(name) for name in ("readings", "rotor speeds")]
    values = status_values(odometry, *streams, NOW, Kind.CALIBRATING.conditions)
    assert values["calibrated"] is False and values["conditions"] == "calibrating at rest"
    assert math.isnan(values["position_deviation_m"] + values["heading_deviation_deg"])


def test_first_condition_is_the_message_of_a_report_and_the_worst_one_its_severity() -> None:
    report = OK, "estimating", {"a": 1}
    assert with_conditions(report, ()) is report
    pushed, slipped = Condition(Kind.PUSHED, "by 1 N s"), Condition(Kind.SLIPPED)
    assert with_conditions(report, (pushed, slipped)) == (WARN, "pushed: by 1 N s", {"a": 1})
    assert with_conditions((ERROR, "jumps", {}), (slipped,)) == (ERROR, "slipped", {})
