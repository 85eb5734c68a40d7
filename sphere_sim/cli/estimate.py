# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""``sphere_nmpc estimate``: the odometry on a recorded bag, and a test of the sensors at rest."""

import argparse
import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from sphere_nmpc.errors import InvalidInputError, printable_line, shown
from sphere_nmpc.estimation.imu import ImuSettings
from sphere_nmpc.estimation.mounting import RobotFrames
from sphere_nmpc.estimation.odometry import Odometry
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import Vector
from sphere_nmpc.quantities import NANOSECONDS, counted, quantities
from sphere_nmpc.ros.cdr import BODY_FRAME, JOINT_NAMES
from sphere_nmpc.ros.settings import FrameSettings, OdometryNodeSettings, SchedulingSettings
from sphere_sim.evaluation.followed_odometry import FollowedOdometry, estimate_table
from sphere_sim.evaluation.metrics import estimate_errors
from sphere_sim.evaluation.sensor_check import FAIL, WARN, Finding, Sensor, check_sensors
from sphere_sim.evaluation.series import Series
from sphere_sim.output.arguments import number
from sphere_sim.output.files import prepare_folder, printable
from sphere_sim.output.round_numbers import length
from sphere_sim.recording.bag_files import BagError
from sphere_sim.recording.node_parameters import (
    bag_parameters,
    file_parameters,
    with_parameters,
)
from sphere_sim.recording.run import without_sign_jumps
from sphere_sim.recording.sensor_bag import SensorBag, feed, read_sensor_bag

_NODE, _ROS = "odometry", "--ros-args"
_SETTINGS = (
    ("", OdometryNodeSettings), ("", FrameSettings), ("", SchedulingSettings),
    ("imu.", ImuSettings), ("robot.", RobotParameters),
)
"""Settings of the node, with the prefixes of their names."""
_WAY = 0.1
"""Shortest way of which errors are a share [m]."""
_LISTED = 5
"""Times of one condition that are listed."""
_TESTS = 2.0, 600.0
"""Least and largest duration of a test [s]."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the poses and return 0; with ``--self-test`` return 1 where a check fails."""
    given = parse(sys.argv[1:] if arguments is None else arguments)
    if given.bag is None:
        from sphere_sim.ros.session.sensor_listener import listen

        texts = _given_parameters(given.params_file, f"/{_NODE}")
        print(f"the robot has to stand still for {given.self_test:g} s", file=sys.stderr)
        remapped = (("imu", given.imu), ("pose", given.pose_topic))
        words = [word for name, topic in remapped if topic for word in ("-r", f"{name}:={topic}")]
        ros = [*(given.ros or [_ROS]), *words]
        return _test(listen(given.self_test, ros), texts, "")
    bag = read_sensor_bag(given.bag, given.imu, given.pose_topic)
    node = f"{bag.namespace}/{_NODE}"
    texts = bag_parameters(bag.messages.custom_data, node)
    texts |= _given_parameters(given.params_file, node)
    if given.self_test is None:
        return _estimate(bag, texts, given.out)
    end = bag.of(bag.imu)[0][0] + round(given.self_test * NANOSECONDS)
    roles = {"imu": bag.imu, "joint_states": bag.joints, "pose": bag.reference}
    return _test({
        role: [entry for entry in bag.of(topic) if entry[0] <= end]
        for role, topic in roles.items() if topic
    }, texts, bag.namespace)


def _given_parameters(file: Path | None, node: str) -> dict[str, str]:
    """Return the texts of parameters in a file, and print which of them the node does not have."""
    texts = {} if file is None else file_parameters(file, node)
    known = {f"{prefix}{name}" for prefix, settings in _SETTINGS for name in quantities(settings)}
    if unknown := sorted(texts.keys() - known - {"use_sim_time"}):
        named = shown(", ".join(unknown))
        print(f"estimate: {file}: unknown parameters, ignored: {named}", file=sys.stderr)
    return texts


def _test(
    seen: Mapping[str, list[tuple[int, Any]]], texts: Mapping[str, str], namespace: str
) -> int:
    """Print the checks of what was received by role, and the result; return 1 if one fails."""
    readings = seen.get("imu", [])
    imu = _imu_settings(texts, readings[0][1].frame if readings else "", namespace)
    joints, pose, found = None, None, list[Finding]()
    if "joint_states" in seen:
        others = [one.names for _, one in seen["joint_states"] if one.of_rotors() is None]
        rotors = [(at, one) for at, one in seen["joint_states"] if one.of_rotors() is not None]
        joints = Sensor.of(rotors, lambda one: one.of_rotors()[:2].ravel())
        if others and not rotors:
            text = f"given {shown(others[0])}, expected {' and '.join(JOINT_NAMES)}"
            found.append(Finding(FAIL, "joint_states names", text))
    if seen.get("pose"):
        pose = Sensor.of(seen["pose"], lambda one: one.state)
    try:
        for _, reading in readings[:1]:
            reading.check_measured()
    except InvalidInputError as error:
        found.append(Finding(FAIL, "imu readings", str(error)))
    found += check_sensors(
        Sensor.of(readings, lambda one: (*one.rate, *one.force)), joints, pose, imu
    )
    for one in found:
        print(f"{one.verdict}  {one.name:<20} {one.text}")
    failed, warned = ([one.name for one in found if one.verdict == kind] for kind in (FAIL, WARN))
    result = f"FAIL: {', '.join(failed)}" if failed else "PASS"
    print(f"{result}; {counted(len(found), 'check')}, {counted(len(warned), 'warning')}")
    return int(bool(failed))


def _imu_settings(texts: Mapping[str, str], frame: str, namespace: str) -> ImuSettings:
    """Return the settings of an IMU, mounted where a description of the robot has its frame."""
    imu = with_parameters(ImuSettings(), texts, "imu.")
    node = with_parameters(OdometryNodeSettings(), texts)
    if not node.robot_description:
        return imu
    prefix = node.frame_prefix or f"{namespace.strip('/')}/".lstrip("/")
    frames = RobotFrames(node.robot_description)
    place, turn = frames.mounting(frame.removeprefix(prefix), BODY_FRAME)
    return replace(imu, position=tuple(place.tolist()), orientation=tuple(turn.tolist()))


def _estimate(bag: SensorBag, texts: Mapping[str, str], out: Path) -> int:
    """Write table and figure of the poses of a bag, and print what is found; return 0."""
    from rich.console import Console
    from rich.progress import Progress

    from sphere_sim.report.figures.estimate import estimated_poses
    from sphere_sim.report.figures.style import save
    from sphere_sim.report.reported import write_csv
    from sphere_sim.study.progress import shown as visible

    prepare_folder(out.parent)
    imu = _imu_settings(texts, bag.of(bag.imu)[0][1].frame, bag.namespace)
    settings = with_parameters(OdometryNodeSettings(), texts)
    frame = with_parameters(FrameSettings(), texts).world_frame
    events, references = bag.events()
    if "initial_state" not in texts and references.get(bag.reference):
        start = references[bag.reference].values[0]
        settings = replace(settings, initial_state=tuple(start.tolist()))
        bag.messages.notes.append(f"initial_state is the first pose of {bag.reference}")
    robot = with_parameters(RobotParameters(), texts, "robot.")
    followed = FollowedOdometry(Odometry(settings, imu, robot))
    console = Console(stderr=True)
    bar = Progress(console=console, transient=True, disable=not console.is_terminal)
    with visible(bar):
        refused = feed(bar.track(events, description="odometry"), followed, frame)
    bag.messages.notes += [
        f"{topic}: {len(why)} messages were refused; {why[0]}" for topic, why in refused.items()
    ]
    for note in bag.messages.notes:
        print(printable_line(f"estimate: {note}"), file=sys.stderr)
    if not followed.estimates:
        why = "; ".join(map(str, followed.odometry.conditions)) or "no reading was used"
        raise BagError(bag.messages.path, f"no pose in {events[-1][0]:.1f} s: {why}")
    table = estimate_table(followed.estimates)
    write_csv(table, out)
    poses = without_sign_jumps(np.array([one.pose for one in followed.estimates]))
    estimated = Series(table["time_s"], poses)
    compared = {topic: (one, estimate_errors(one, estimated)) for topic, one in references.items()}
    for line in _report(followed, table, compared):
        print(line)
    save(estimated_poses(followed.estimates, table, compared), out.parent, out.stem)
    print(f"poses in {printable(out)}, figure in {printable(out.with_suffix('.svg'))}")
    return 0


def _report(
    followed: FollowedOdometry, table: Mapping[str, Vector],
    compared: Mapping[str, tuple[Series, Vector]],
) -> Iterator[str]:
    """Yield lines on way, deviations, errors and conditions."""
    odometry, times = followed.odometry, table["time_s"]
    way = float(np.sum(np.hypot(np.diff(table["x"]), np.diff(table["y"]))))
    place, heading, tilt = followed.estimates[-1].deviations
    yield (f"{counted(len(times), 'pose')} from {times[0]:.2f} to {times[-1]:.2f} s, way "
           f"{way:.3f} m; {odometry.calibration}")
    yield (f"deviation at the end {length(place)}, heading {math.degrees(heading):.2g} deg, tilt "
           f"{math.degrees(tilt):.2g} deg")
    for topic, (_, errors) in compared.items():
        known = errors[np.isfinite(errors[:, 0])]
        if len(known):
            rms, end = np.sqrt(np.mean(known**2, axis=0)), np.abs(known[-1])
            turned = np.degrees((rms[1], end[1]))
            share = f" ({100.0 * rms[0] / way:.2g} % of the way)" if way > _WAY else ""
            yield (f"from {topic}: {length(rms[0])} rms{share}, {length(end[0])} at the end; "
                   f"heading {turned[0]:.2g} deg rms, {turned[1]:.2g} at the end")
    if odometry.fixes_used or odometry.fixes_left_out:
        yield f"fixes: {odometry.fixes_used} used, {odometry.fixes_left_out} left out"
    for kind in dict.fromkeys(one.condition.kind for one in followed.spells):
        spells = [one for one in followed.spells if one.condition.kind is kind]
        when = ", ".join(f"{one.begin:.2f} to {one.end:.2f} s" for one in spells[:_LISTED])
        more = f" and {len(spells) - _LISTED} more times" if len(spells) > _LISTED else ""
        yield f"{when}{more}: {spells[0].condition}"


def parse(arguments: Sequence[str]) -> argparse.Namespace:
    """Return the arguments; those of ROS as `ros`."""
    parser = argparse.ArgumentParser(
        prog="sphere_nmpc estimate",
        description="Estimate the poses of a recorded robot from its IMU and encoders, or test "
        "the sensors of one that stands still: a live one by its topics, or a recorded one.",
        epilog="ROS arguments follow --ros-args, for example: --ros-args -r imu:=/imu/data",
    )
    parser.add_argument("bag", nargs="?", type=Path, metavar="BAG",
                        help="folder of a bag, or a .mcap or .db3 file, also with suffix .zstd")
    parser.add_argument("--out", type=Path, metavar="FILE.csv",
                        help="table of the poses; its figure is beside it")
    parser.add_argument("--self-test", type=number(*_TESTS), metavar="SECONDS",
                        help="test the sensors for so long, of a bag at its start")
    parser.add_argument("--params-file", type=Path, metavar="FILE.yaml",
                        help="parameters of the node odometry (default: as recorded)")
    parser.add_argument("--imu", metavar="TOPIC",
                        help="IMU, if a bag has several, or a live one is not on imu")
    parser.add_argument("--pose-topic", metavar="TOPIC",
                        help="poses to compare with (default: ground_truth/pose, or pose)")
    words = list(arguments)
    at = words.index(_ROS) if _ROS in words else len(words)
    given = parser.parse_args(words[:at])
    given.ros = words[at:]
    if given.bag is None and given.self_test is None:
        parser.error("argument BAG: given none, expected a bag, or --self-test")
    if given.self_test is None and (given.out is None or given.out.suffix != ".csv"):
        parser.error(f"argument --out: given {given.out or 'none'}, expected a .csv file")
    return given
