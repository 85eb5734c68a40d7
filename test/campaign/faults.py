# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Faults on running nodes, up to three at once, and fuzzing of all nodes.

    make faults ARGS="--quick --json out/faults.json"
    make faults ARGS="--json out/contact.json --plant rigid_body --triples 50"
    make faults ARGS="--fuzz --seed 12 --minutes 10"
    make faults ARGS="--fuzz --seed 12 --only 17"            # trial 17 again

Runs simulator, controller and recorder as separate ROS 2 nodes, causes a fault during a run to a
goal, and evaluates the recovery. Exits 0 when every trial was survived.
"""

import argparse
import itertools
import json
import math
import statistics
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from catalogue import FAULTS, HOSTILE, Fault, chosen, combined, fuzzed, name_of
from node_session import RATE, SERVO_ERROR, Settings
from trial import Outcome, run_trials

from sphere_nmpc.errors import SphereNmpcError
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.settings import STRATEGIES
from sphere_sim.output.arguments import number, whole
from sphere_sim.output.files import prepare_folder, write_atomically
from sphere_sim.ros.session.domain import own_domain

_PAIRS = 12
_GROWTH = 1.5
"""Ratio of the memory at the end and at the beginning from which on it is not level: floors of up
to 70 MB come and go."""
_ENOUGH = 40
"""Trials from which on it has to be level: the first large floor alone makes a difference."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the campaign, or fuzz; return 0 when all was survived, 1 when something was not."""
    given = _parse(arguments)
    if given.json is not None:
        prepare_folder(given.json.parent)
    with tempfile.TemporaryDirectory(
        prefix="sphere_nmpc_faults_", ignore_cleanup_errors=True
    ) as temporary:
        folder = given.out.expanduser().absolute() if given.out else Path(temporary)
        with own_domain():
            return 0 if _campaign(given, folder) else 1


def _campaign(given: argparse.Namespace, folder: Path) -> bool:
    """Run all trials; return whether each was survived."""
    settings = Settings(given.seed, given.rtf, given.strategy, given.plant, given.rate)
    outcomes: list[Outcome] = []
    plans = _fuzzing(given) if given.fuzz else _plans(given)
    for outcome in run_trials(plans, settings, folder, given.fuzz):
        outcomes.append(outcome)
        if given.json is not None:
            write_json(given.json, outcomes, asdict(settings))
        print(f"{outcome.repetition if given.fuzz else len(outcomes)}: {outcome}", flush=True)
    robot = RobotParameters()
    print(f"\nlimits: {robot.max_rotor_speed:g} rad/s, {robot.max_rotor_acceleration:g} rad/s^2\n")
    print(*_table(outcomes), sep="\n")
    survived = sum(outcome.survived for outcome in outcomes)
    print(f"\n{survived} of {len(outcomes)} trials survived")
    first, last = memory_at_ends([outcome.memory for outcome in outcomes])
    print("memory of the controller and its worker, median of the first and the last quarter: "
          f"{first:.0f} MB, {last:.0f} MB")
    is_level = len(outcomes) < _ENOUGH or last <= _GROWTH * first
    return survived == len(outcomes) and is_level


def memory_at_ends(found: Sequence[float]) -> tuple[float, float]:
    """Return the medians of the first and of the last quarter; nodes are restarted in between."""
    quarter = math.ceil(len(found) / 4)
    return statistics.median(found[:quarter] or [0.0]), statistics.median(found[-quarter:] or [0])


def _fuzzing(given: argparse.Namespace) -> Iterator[tuple[tuple[Fault, ...], int]]:
    """Yield trials of hostile faults by their numbers, for a time, or those of some numbers."""
    end = time.monotonic() + 60.0 * given.minutes
    for one in given.only or itertools.count(1):
        if time.monotonic() > end:
            return
        yield fuzzed(given.seed, one), one


def _plans(given: argparse.Namespace) -> list[tuple[tuple[Fault, ...], int]]:
    """Return the trials: each fault, as often as wanted, then the combinations."""
    singles = chosen(given.fault, given.quick)
    several: list[tuple[Fault, ...]] = [(fault,) for fault in singles] * given.repeat
    for size, wanted in ((2, given.pairs), (3, given.triples)):
        several += combined(singles, size, wanted, given.seed)
    tried: Counter[str] = Counter()
    plans = []
    for faults in several:
        name = name_of(faults)
        plans.append((faults, tried[name]))
        tried[name] += 1
    return plans


def _row(fault: str, outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Return what the file and the tables hold of all trials of a fault."""
    recoveries = [outcome.recovery for outcome in outcomes if outcome.recovery >= 0.0]
    return {
        "fault": fault,
        "tried": len(outcomes),
        "survived": sum(outcome.survived for outcome in outcomes),
        "recover_s": round(max(recoveries), 3) if recoveries else None,
        "recover_median_s": round(statistics.median(recoveries), 3) if recoveries else None,
        "worst_speed": max((outcome.worst_speed for outcome in outcomes), default=0.0),
        "worst_slew": max((outcome.worst_slew for outcome in outcomes), default=0.0),
    }


def _rows(outcomes: Sequence[Outcome]) -> list[dict[str, Any]]:
    """Return a row for each fault, in order of their first trial."""
    faults = dict.fromkeys(outcome.fault for outcome in outcomes)
    return [_row(fault, [o for o in outcomes if o.fault == fault]) for fault in faults]


def _table(outcomes: Sequence[Outcome]) -> Iterator[str]:
    """Yield the lines of a table in Markdown."""
    yield ("| fault | survived | recovery, median [s] | longest [s] | speed [rad/s] "
           "| slew [rad/s²] |")
    yield "|---" * 6 + "|"
    for one in [*_rows(outcomes), _row("all", outcomes)]:
        median, longest = (
            "-" if seconds is None else f"{seconds:.1f}"
            for seconds in (one["recover_median_s"], one["recover_s"])
        )
        yield (f"| {one['fault']} | {one['survived']} of {one['tried']} | {median} | {longest} "
               f"| {one['worst_speed']:.2f} | {one['worst_slew']:.2f} |")


def write_json(path: Path, outcomes: Sequence[Outcome], campaign: Mapping[str, Any]) -> None:
    """Write the settings in common, the table of faults, and all trials to a file, at once."""
    trials = [
        asdict(o) | {"recovery": None if math.isnan(o.recovery) else o.recovery} for o in outcomes
    ]
    content = {"campaign": dict(campaign), "faults": _rows(outcomes), "trials": trials}
    write_atomically(path, json.dumps(content, indent=2, allow_nan=False) + "\n")


def _parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    groups = list(dict.fromkeys(fault.group for fault in FAULTS.values()))
    common = Settings()
    parser = argparse.ArgumentParser(
        prog="make faults", description=__doc__.splitlines()[0],
        epilog="groups: " + ", ".join(groups) + "; faults: " + ", ".join(FAULTS)
        + "; hostile faults of the fuzzing: " + ", ".join(fault.name for fault in HOSTILE),
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the table to this file")
    parser.add_argument("--seed", type=whole(0), default=common.seed,
                        help="of all that is random (default: %(default)s)")
    parser.add_argument("--out", type=Path, metavar="DIR",
                        help="keep logs and bags in this folder")
    campaign = parser.add_argument_group("campaign", "with --json")
    campaign.add_argument("--quick", action="store_true", help="one fault or two of each group")
    campaign.add_argument("--fault", nargs="+", action="extend", default=[], metavar="NAME",
                          choices=[*groups, *FAULTS], help="only these faults or groups of faults")
    campaign.add_argument("--pairs", nargs="?", type=whole(1), const=_PAIRS, default=0,
                          metavar="N", help="then N pairs of simultaneous faults, drawn by the "
                          f"seed (default: {_PAIRS})")
    campaign.add_argument("--triples", type=whole(1), default=0, metavar="N",
                          help="then N triples likewise")
    campaign.add_argument("--repeat", type=whole(1), default=1, metavar="N",
                          help="try each fault N times, each time with another goal")
    campaign.add_argument("--rtf", type=number(0.5, 5.0), default=common.rtf, metavar="F",
                          help="simulated over wall time (default: %(default)g)")
    campaign.add_argument("--strategy", choices=sorted(STRATEGIES), default=common.strategy,
                          help="what the controller solves")
    campaign.add_argument("--plant", choices=SERVO_ERROR, default=common.plant,
                          help="what the simulator simulates (default: %(default)s)")
    campaign.add_argument("--rate", type=number(RATE, 500.0), default=RATE, metavar="HZ",
                          help="rate of poses, commands and, above the default, solves (default: "
                          "%(default)g Hz, and a solve at each sampling instant)")
    fuzzing = parser.add_argument_group("fuzzing")
    fuzzing.add_argument("--fuzz", action="store_true", help="hostile faults on all nodes instead")
    fuzzing.add_argument("--minutes", type=float, default=10.0, help="wall time")
    fuzzing.add_argument("--only", type=whole(1), nargs="+", metavar="K", help="numbers of trials")
    given = parser.parse_args(arguments)
    if given.json is None and not given.fuzz:
        parser.error("expected --json FILE or --fuzz")
    return given


if __name__ == "__main__":
    try:
        sys.exit(main())
    except SphereNmpcError as error:
        sys.exit(f"faults: {error}")
    except KeyboardInterrupt:
        sys.exit("faults: interrupted")
