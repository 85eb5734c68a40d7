# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Fuzzing of all nodes as running processes: what ends a node, breaks a limit or stops control.

    python bench/fuzz_nodes.py --minutes 120 --seed 1 --json out/fuzz.json
    python bench/fuzz_nodes.py --seed 1 --only 17             # try 17 again

Tries one fault after another, or two at once: malformed and extreme messages, parameters,
services, clocks, goals and signals, see `fuzz_tries.py`. Afterwards all is restored, a new goal is
sent, and the time is measured until the rotors follow a command to it. Meanwhile `fuzz_judge.py`
judges each command. The exit code is 1 if there is any complaint.
"""

import argparse
import math
import random
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np
import rclpy
from fuzz_judge import rounded
from fuzz_session import NODES, NoAnswerError, Session
from fuzz_tries import TRIES, WEIGHTS
from node_runs import machine, write_json

from sphere_nmpc.errors import SphereNmpcError
from sphere_nmpc.foreign_text import shown
from sphere_nmpc.ros.startup import start_ros
from sphere_sim.ros.session.domain import own_domain

_REPORT_EVERY = 20.0
"""Wall time between two lines of progress [s]."""


class Campaign:
    """Tries one after another, and their complaints.

    Parameters
    ----------
    given : Namespace
        Options of the command line.
    folder : Path
        Folder for logs and bags.
    """

    def __init__(self, given: argparse.Namespace, folder: Path) -> None:
        self._given = given
        self.failures: list[dict[str, object]] = []
        self.counts: Counter[str] = Counter()
        self._kinds: Counter[str] = Counter()
        self._told: set[tuple[int, str, str]] = set()
        self._back: list[tuple[float, int, str]] = []
        self._number, self._name = 0, "start"
        self.session = Session(folder, self._fail)

    def run(self) -> None:
        """Run the tries."""
        session, given = self.session, self._given
        session.start(*NODES)
        session.control_back(np.random.default_rng(given.seed))
        session.learn()
        end, reported = time.monotonic() + 60.0 * given.minutes, time.monotonic()
        numbers = iter(given.only or range(1, sys.maxsize))
        for number in numbers:
            if time.monotonic() > end:
                break
            self._one(number)
            if time.monotonic() > reported + _REPORT_EVERY:
                reported = time.monotonic()
                print(f"{(end - reported) / 60.0:.1f} min left, {self.summary()}", flush=True)
                write_json(given, self.result())

    def _one(self, number: int) -> None:
        given, session = self._given, self.session
        rng = random.Random(f"{given.seed}:{number}")
        weights = [WEIGHTS.get(kind, 1) for kind in given.kinds]
        kinds = list(dict.fromkeys(
            rng.choices(given.kinds, weights, k=2 if rng.random() < 0.3 else 1)
        ))
        self._number, self._name = number, "+".join(kinds)
        session.alone = len(kinds) == 1
        self._kinds.update(kinds)
        end = rng.uniform(1.0, 5.0)
        tries = [TRIES[k](session, random.Random(f"{given.seed}:{number}:{k}")) for k in kinds]
        running = list(tries)
        for one in tries:  # what they wait for first does not count
            if next(one, one) is one:
                running.remove(one)
        end += time.monotonic()
        while running and time.monotonic() < end:
            session.spin()
            running = [one for one in running if next(one, one) is not one]
        for one in tries:
            one.close()
        try:
            session.restore()
            seconds = session.control_back(np.random.default_rng([given.seed, number]))
        except NoAnswerError as error:
            self._fail("requests without an answer", str(error))
            seconds = None
        if seconds is None:  # the next try needs nodes that work
            session.restart()
        else:
            self._back.append((seconds, number, self._name))
        session.check_logs()

    def _fail(self, what: str, detail: str, about: str = "") -> None:
        """Count a complaint, and tell the first of its kind in each try."""
        self.counts[what] += 1
        if (self._number, what, about) in self._told:
            return
        self._told.add((self._number, what, about))
        one = {"try": self._number, "kinds": self._name, "what": what, "detail": shown(detail)}
        self.failures.append(one)
        print(f"try {self._number} ({self._name}): {what}: {shown(detail)}", flush=True)

    def summary(self) -> str:
        """Return the counts in one line."""
        found = ", ".join(f"{count} {what}" for what, count in sorted(self.counts.items()))
        times = _distribution(self._back)
        control = ", ".join(f"{key} {value}" for key, value in times.items())
        return f"{sum(self._kinds.values())} faults: {found or 'no complaint'}; {control}"

    def result(self) -> dict[str, object]:
        """Return everything for the JSON file."""
        judge = self.session.judge
        table = {
            kind: {
                "tried": tried,
                "failures": sum(kind in str(one["kinds"]).split("+") for one in self.failures),
                **_distribution([one for one in self._back if kind in one[2].split("+")]),
            }
            for kind, tried in sorted(self._kinds.items())
        }
        return {
            "machine": machine(), "seed": self._given.seed, "tries": self._number,
            "commands_judged": judge.count, "worst": rounded(judge.worst),
            "most_log_lines_of_a_node_in_a_try": self.session.most_lines,
            "counts": dict(self.counts), "seconds_without_control": _distribution(self._back),
            "kinds": table, "failures": self.failures,
        }


def _distribution(back: list[tuple[float, int, str]]) -> dict[str, object]:
    """Return the distribution of times until control is back [s], with the try of the worst."""
    if not back:
        return {"control_back": "never"}
    times = sorted(back)
    return {
        "median_s": round(times[len(times) // 2][0], 3),
        "p99_s": round(times[math.ceil(0.99 * len(times)) - 1][0], 3),
        "worst_s": round(times[-1][0], 3),
        "worst_try": f"{times[-1][1]} ({times[-1][2]})",
    }


def main() -> int:
    """Run the campaign; return 0 if there is no complaint, 130 if it was interrupted without."""
    given = _parse()
    with tempfile.TemporaryDirectory(prefix="fuzz_nodes_") as scratch, own_domain():
        folder = given.logs or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        start_ros([], quiet=True)
        campaign, code = Campaign(given, folder), 0
        try:
            with campaign.session.processes:
                campaign.run()
        except KeyboardInterrupt:
            code = 130
        finally:
            campaign.session.close()
            rclpy.try_shutdown()
    write_json(given, campaign.result())
    print(f"seed {given.seed}, {campaign.summary()}")
    return 1 if campaign.counts else code


def _parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=10.0, help="wall time")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", type=int, nargs="+", metavar="K", help="numbers of tries")
    parser.add_argument("--kinds", nargs="+", choices=TRIES, default=list(TRIES),
                        help="kinds to draw from; they are part of what --only repeats")
    parser.add_argument("--logs", type=Path, help="folder for logs and bags that are kept")
    parser.add_argument("--json", type=Path)
    return parser.parse_args()


if __name__ == "__main__":
    try:
        sys.exit(main())
    except SphereNmpcError as error:
        sys.exit(str(error))
