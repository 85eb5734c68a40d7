# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""``sphere_nmpc identify``: the parameters of a robot from a recorded bag."""

import argparse
import math
import sys
from collections.abc import Sequence
from pathlib import Path

from sphere_nmpc.errors import printable_line
from sphere_nmpc.estimation.imu import ImuSettings
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.settings import ControllerSettings
from sphere_sim.identification.bag import read_recorded
from sphere_sim.identification.identify import Given, Row, identified
from sphere_sim.identification.robot_file import written
from sphere_sim.output.arguments import positive
from sphere_sim.output.files import printable, write_atomically
from sphere_sim.recording.node_parameters import file_parameters, with_parameters

_HEAD = """\
Robot of {bag}, by sphere_nmpc identify: each value with its standard deviation.
The constants of the motion are ratios of inertias. The masses are kept as they are given; changed
are radius, inertias of a rotor (the transverse one in proportion), inertia of the shell and
rotor_offset, such that radius, c1 = I1 / (It1 + m), r1 = m / (It1 + m) and r3 = m / (It2 + m) are
those identified.
{summary}"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table and write the file of parameters; return 0."""
    given = parse(sys.argv[1:] if arguments is None else arguments)

    def say(text: str) -> None:
        print(printable_line(f"identify: {text}"), file=sys.stderr, flush=True)

    recorded = read_recorded(given.bag, given.namespace, given.pose_topic)
    for note in recorded.notes:
        say(note)
    known, node = recorded.parameters, recorded.controller
    if given.params_file is not None:
        known = file_parameters(given.params_file, node, f"{node.rpartition('/')[0]}/odometry")
    start = Given(
        with_parameters(RobotParameters(), known, "robot."),
        with_parameters(ControllerSettings(), known),
        with_parameters(ImuSettings(), known, "imu."),
    )
    found = identified(recorded, start, given.distance, given.tape, say)
    rows = [_cells(row) for row in found.rows]
    widths = [max(len(row[i]) for row in rows) for i in range(3)]
    for row in rows:
        cells = [f"{text:<{width}}" for text, width in zip(row[:3], widths, strict=True)]
        print("  ".join((*cells, row[3])).rstrip())
    print(found.summary)
    if given.out is not None:
        head = _HEAD.format(bag=printable_line(printable(given.bag)), summary=found.summary)
        write_atomically(given.out, written(found.sections, head))
        print(f"parameters in {printable(given.out)}")
    return 0


def _cells(row: Row) -> tuple[str, str, str, str]:
    """Return name, value, deviation, and what else is to be said of a quantity."""
    known = [one for one in row.deviation if 0.0 < one < math.inf]
    # Two digits of the least deviation; six where there is none.
    places = 1 - math.floor(math.log10(min(known))) if known else 0

    def numbers(values: Sequence[float]) -> str:
        return " ".join(f"{one:.{max(places, 0)}f}" if known else f"{one:.6g}" for one in values)

    deviation = f"+- {numbers(row.deviation)}" if row.deviation else "not seen"
    nominal = f"given {' '.join(f'{one:.5g}' for one in row.given)}" if row.given else ""
    remark = f"({row.remark})" if row.remark else ""
    value = f"{numbers(row.value)} {row.unit}".rstrip()
    return row.name, value, deviation, f"{nominal} {remark}".strip()


def parse(arguments: Sequence[str]) -> argparse.Namespace:
    """Return the arguments."""
    parser = argparse.ArgumentParser(
        prog="sphere_nmpc identify",
        description="Find the constants of masses and inertias, the radius, lag and limits of the "
        "drives, offsets of stamps, noises and the mounting of an IMU from a recorded motion, and "
        "write them as parameters that all nodes take.",
    )
    parser.add_argument("bag", type=Path, metavar="BAG",
                        help="folder of a bag, or a .mcap or .db3 file, also with suffix .zstd")
    parser.add_argument("--out", type=Path, metavar="FILE.yaml",
                        help="file of parameters to write")
    parser.add_argument("--params-file", type=Path, metavar="FILE.yaml",
                        help="parameters as they are given (default: those of the controller in "
                        "the bag)")
    parser.add_argument("--distance", type=positive, metavar="METRES",
                        help="length of a straight way, from rest to rest, that was measured: "
                        "gives the radius where poses are those of an odometry without pose_fix")
    parser.add_argument("--tape", type=positive, default=1e-3, metavar="METRES",
                        help="standard deviation of that (default: %(default)g)")
    parser.add_argument("--namespace", metavar="NS",
                        help="namespace of the robot, if a bag has several")
    parser.add_argument("--pose-topic", metavar="TOPIC",
                        help="topic of poses from outside, if a bag does not say which it is")
    return parser.parse_args(arguments)
