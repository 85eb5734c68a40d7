# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""``sphere_nmpc identify``: the parameters of a robot from a recorded bag."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from sphere_nmpc.estimation.imu import ImuSettings
from sphere_nmpc.foreign_text import printable_line
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.settings import ControllerSettings
from sphere_sim.output.arguments import positive
from sphere_sim.output.files import printable, write_atomically

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
    from sphere_sim.identification.bag import read_recorded
    from sphere_sim.identification.identify import Given, Row, identified
    from sphere_sim.identification.robot_file import parameters_of, taken, written

    def say(text: str) -> None:
        print(printable_line(f"identify: {text}"), file=sys.stderr, flush=True)

    def shown(row: Row) -> tuple[str, str, str, str]:
        def numbers(values: Sequence[float], digits: int) -> str:
            return " ".join(f"{one:.{digits}g}" for one in values if one == one)

        unit = f" {row.unit}" if row.unit else ""
        deviation = f"+- {numbers(row.deviation, 2)}" if row.deviation else "not seen"
        nominal = f"given {numbers(row.given, 5)}" if row.given else ""
        remark = f"({row.remark})" if row.remark else ""
        return row.name, f"{numbers(row.value, 6)}{unit}", deviation, f"{nominal} {remark}".strip()

    recorded = read_recorded(given.bag, given.namespace, given.pose_topic)
    for note in recorded.notes:
        say(note)
    known = parameters_of(given.params_file) if given.params_file else recorded.parameters
    start = Given(
        taken(RobotParameters(), "robot.", known), taken(ControllerSettings(), "", known),
        taken(ImuSettings(), "imu.", known),
    )
    found = identified(recorded, start, given.distance, given.tape, say)
    rows = [shown(row) for row in found.rows]
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
