# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The odometry on a recorded bag, and the test of the sensors of a recorded robot."""

import json
import re
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from document_commands import FENCE, ROOT
from inertial_runs import IMU, Run, random_run
from sensor_bags import EPOCH, PARAMETERS, Entry, sensor_entries, uncertain_pose, write_sensors

from sphere_nmpc.model.state import Vector
from sphere_nmpc.ros.cdr import Imu, Joints, Pose
from sphere_sim.cli.main import main
from sphere_sim.evaluation.metrics import estimate_errors
from sphere_sim.evaluation.series import Series

pytestmark = pytest.mark.slow

NEAR = 0.005
"""Error of the position after a metre [m]: some parts in a thousand of the way."""


@pytest.fixture(scope="module")
def run() -> Run:
    return random_run(3, 5.0)


@pytest.fixture
def parameters(tmp_path) -> Path:
    file = tmp_path / "my_robot.yaml"
    file.write_text(PARAMETERS)
    return file


def estimate(
    folder: Path, entries: Iterable[Entry], *words: str, custom: Mapping[str, str] = {}
) -> tuple[int, Path]:
    """Return exit code and table of the command for a bag of these messages."""
    bag, out = write_sensors(folder / "bag", entries, custom), folder / "poses.csv"
    return main(["estimate", str(bag), "--out", str(out), *words]), out


def errors(run: Run, out: Path) -> Vector:
    """Return the distances of a table's poses from the true ones [m]."""
    table = np.loadtxt(out, delimiter=",", skiprows=1)
    stamps = np.array(sorted(run.states))
    states = np.array([run.states[stamp] for stamp in stamps.tolist()])
    begin = 1e-9 * run.readings[0].stamp
    estimates = Series(table[:, 0] + begin, table[:, 1:7])
    return estimate_errors(estimates, Series(1e-9 * stamps, states))[:, 0]


@pytest.fixture
def near(run, parameters, tmp_path, capsys) -> Callable[..., Any]:
    """Return a function that runs the command, whose poses have to be near the true ones.

    It is given a file of parameters, and returns what is printed.
    """
    def near(entries: Iterable[Entry], *words: str, custom: Mapping[str, str] = {}) -> Any:
        given = "--params-file", str(parameters), *words
        code, out = estimate(tmp_path, entries, *given, custom=custom)
        assert code == 0 and np.nanmax(errors(run, out)) < NEAR
        return capsys.readouterr()

    return near


def test_poses_of_a_bag_are_near_the_true_ones_with_table_figure_and_report(
    run, near, tmp_path
) -> None:
    printed = near(sensor_entries(run))
    header, *rows = (tmp_path / "poses.csv").read_text().splitlines()
    assert header == "time_s,x,y,qw,qx,qy,qz,position_deviation_m,heading_deviation_rad," \
        "tilt_deviation_rad"
    assert len(rows) > 700 and all((tmp_path / f"poses.{kind}").stat().st_size
                                   for kind in ("png", "svg"))
    assert "from /ground_truth/pose: " in printed.out and "% of the way)" in printed.out
    assert "s: calibrating at rest: given at rest for" in printed.out
    assert printed.err == "estimate: initial_state is the first pose of /ground_truth/pose\n"


def test_fixes_and_given_poses_are_used_when_they_were_received(run, parameters, near) -> None:
    parameters.write_text(PARAMETERS + "    initial_state: [5.0, 0.0, 1.0, 0.0, 0.0, 0.0]\n")
    start, later = run.states[0], run.states[4 * 10**9]
    entries = [one for one in sensor_entries(run, truth="/elsewhere") if one[1] is not Pose]
    placed = uncertain_pose("/initialpose", start, -0.2, late=0.0)
    fix = uncertain_pose("/pose_fix", later, 4.0)
    printed = near([*entries, placed, fix]).out
    assert "fixes: 1 used, 0 left out" in printed and "from /pose_fix: " in printed


def test_message_that_the_node_refuses_is_left_out_and_named(run, near) -> None:
    fix = uncertain_pose("/pose_fix", np.ones(6), 2.0, variance=-1.0)
    elsewhere = *fix[:3], fix[3].replace(b"world", b"wurld")
    entries = [*sensor_entries(run), fix, elsewhere]
    large = np.array([1e300, np.nan]).tobytes()
    entries[900] = *entries[900][:3], entries[900][3][:-96] + large + entries[900][3][-80:]
    assert entries[900][1] is Imu
    lines = near(entries).err.splitlines()
    assert "estimate: /imu: 1 readings that are not finite were ignored" in lines
    told = [line for line in lines if "/pose_fix" in line]
    assert len(told) == 1
    assert told[0].startswith("estimate: /pose_fix: 2 messages were refused; quaternion: ")


def test_recorded_parameters_are_used_and_those_of_a_file_come_first(
    run, parameters, near
) -> None:
    recorded = {"imu.position": IMU.position, "imu.orientation": IMU.orientation,
                "calibration_time": 600.0}
    custom = {"parameters:/odometry": json.dumps(recorded)}
    parameters.write_text("odometry: {ros__parameters: {calibration_time: 2, imu.gyro_nose: 1}}")
    told = near(sensor_entries(run), custom=custom).err
    assert "my_robot.yaml: unknown parameters, ignored: 'imu.gyro_nose'" in told


def test_longest_run_of_a_bag_is_used_whatever_it_has(run, near) -> None:
    other = uncertain_pose("/pose_fix", np.ones(6), -4.9)
    later = [(*one[:2], one[2] + 20 * 10**9, one[3]) for one in sensor_entries(run)]
    before = [one for one in sensor_entries(random_run(3, 2.0)) if one[2] < EPOCH]
    told = near([*before, other, *later]).err
    assert "/imu: time goes back, so the bag holds several runs" in told


def test_stamps_of_another_clock_are_replaced_by_log_times(run, near) -> None:
    entries = list(sensor_entries(run))
    late = 10**12

    def shifted(entry: Entry, number: int) -> Entry:
        topic, record, log, message = entry
        moved = divmod(log + late, 10**9)
        stamp = np.array(moved, "<i4").tobytes()
        is_wrong = (topic == "/imu" and number == 500) or topic == "/joint_states"
        return topic, record, log, message[:4] + stamp + message[12:] if is_wrong else message

    shifted_entries = [shifted(entry, i // 3) for i, entry in enumerate(entries)]
    told = near(shifted_entries).err
    assert "/joint_states: " in told and "the log times are used" in told


def test_log_times_of_another_clock_and_pace_make_no_difference(run, near) -> None:
    fix = uncertain_pose("/pose_fix", run.states[3 * 10**9], 3.0)
    # Logged by the system clock, of a simulation that is 2.5 times as fast.
    entries = [(*one[:2], 1_800_000_000 * 10**9 + one[2] * 2 // 5, one[3])
               for one in (*sensor_entries(run), fix)]
    printed = near(entries)
    assert "fixes: 1 used" in printed.out and "stamps" not in printed.err


def test_topics_are_those_of_the_robot_of_the_imu(run, parameters, near) -> None:
    entries = [(f"/{robot}{one[0]}", *one[1:]) for robot, motion in
               (("a", random_run(4, 5.0)), ("b", run), ("c", random_run(5, 5.0)))
               for one in sensor_entries(motion)]
    parameters.write_text(PARAMETERS.replace("/**", "/b/odometry"))
    assert "from /b/ground_truth/pose: " in near(entries, "--imu", "b/imu").out


MOVING = [one for one in sensor_entries(random_run(3, 2.0)) if one[2] > EPOCH + 500_000_000]


def without(record: type) -> list[Entry]:
    return [one for one in sensor_entries(random_run(3, 2.0)) if one[1] is not record]


def not_measured() -> list[Entry]:
    """Return an IMU's readings whose covariance says that it does not measure the force."""
    return [(topic, record, log, message[:-72] + np.float64(-1.0).tobytes() + message[-64:])
            for topic, record, log, message in without(Joints) if record is Imu]


@pytest.mark.parametrize(("entries", "words", "code", "told"), [
    (without(Imu), (), 1, "no message of type sensor_msgs/msg/Imu; it has: /ground_truth/pose, /"),
    (MOVING, ("--imu", "other"), 1, "no message of type sensor_msgs/msg/Imu on /other; it has: "),
    ([*MOVING, *sensor_entries(random_run(3, 2.0), imu="/second")], (), 1,
     "has several IMUs, choose one with --imu: /imu, /second"),
    (MOVING, ("--pose-topic", "seen"), 1, "no poses on /seen; it has: /ground_truth/pose"),
    (not_measured(), (), 1, "/imu: linear_acceleration_covariance: given -1.0, expected one that"),
    (MOVING[:600], (), 1, "s: calibrating at rest: "),
    (MOVING[:3], (), 1, "1 finite reading, expected"),
    (MOVING, ("--params-file", "none.yaml"), 2, "none.yaml: given no such file, expected an exi"),
])
def test_bag_without_what_is_needed_is_one_line(
    entries, words, code, told, tmp_path, capsys
) -> None:
    assert estimate(tmp_path, entries, *words)[0] == code
    line = [one for one in capsys.readouterr().err.splitlines() if one.startswith("sphere_nmpc")]
    assert len(line) == 1 and told in line[0], line
    assert not (tmp_path / "poses.csv").exists()


@pytest.mark.parametrize("words", [
    (), ("bag",), ("bag", "--self-test", "1"), ("--out", "a.csv"), ("bag", "--out", "a.png"),
])
def test_arguments_that_do_not_say_what_to_do_are_refused(words, capsys) -> None:
    with pytest.raises(SystemExit) as end:
        main(["estimate", *words])
    assert end.value.code == 2 and "expected" in capsys.readouterr().err


def test_self_test_of_a_bag_passes_at_rest_and_fails_in_motion(
    run, parameters, tmp_path, capsys
) -> None:
    bag = str(write_sensors(tmp_path / "bag", sensor_entries(run)))
    given = "estimate", bag, "--params-file", str(parameters), "--self-test"
    assert main([*given, "2.3"]) == 0
    assert capsys.readouterr().out.splitlines()[-1].startswith("PASS; ")
    assert main([*given, "5"]) == 1
    last = capsys.readouterr().out.splitlines()[-1]
    assert last.startswith("FAIL: imu rest, ") and "rotor speeds" in last


def test_document_shows_what_is_printed(run, parameters, tmp_path, capsys) -> None:
    text = (ROOT / "docs" / "porting.md").read_text()
    section = text[text.index("\n## Check the sensors") : text.index("\n## Processor")]
    tested, estimated = [block for kind, block in FENCE.findall(section) if kind == "text"]
    bag = str(write_sensors(tmp_path / "bag", sensor_entries(run)))
    given = "estimate", bag, "--params-file", str(parameters)
    main([*given, "--self-test", "2.3"])
    assert forms(tested) == forms(capsys.readouterr().out)
    main([*given, "--out", str(tmp_path / "poses.csv")])
    # What an odometry has found at rest and its conditions are its own words.
    begins = ("deviation", "from")
    printed = forms(capsys.readouterr().out)
    assert [line for line in forms(estimated) if line.startswith(begins)] == [
        line for line in printed if line.startswith(begins)
    ]


def forms(text: str) -> list[str]:
    """Return the lines of an output with # for each number."""
    return [re.sub(r"[-+]?\d[\d.]*(e[-+]\d+)?", "#", line) for line in text.splitlines()]


@pytest.mark.parametrize(("change", "told"), [
    (lambda message: message.replace(b"rotor_", b"wheel_"),
     "FAIL  joint_states names   given ['wheel_1_joint', 'wheel_2_joint'], expected rotor_1"),
    (lambda message: message[:-72] + np.float64(-1.0).tobytes() + message[-64:],
     "FAIL  imu readings         linear_acceleration_covariance: given -1.0, expected one"),
])
def test_self_test_names_messages_that_do_not_measure(
    change, told, run, tmp_path, capsys
) -> None:
    record = Imu if "imu" in told else Joints
    entries = [(*one[:3], change(one[3]) if one[1] is record else one[3])
               for one in sensor_entries(run)]
    bag = str(write_sensors(tmp_path / "bag", entries))
    assert main(["estimate", bag, "--self-test", "2"]) == 1
    assert told in capsys.readouterr().out
