# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Runs to goals with simulator and controller on two hosts, over a link that loses packets.

    sudo python bench/two_hosts.py --loss 0 1 5 20 --goals 6 --json out/two_hosts.json
    sudo python bench/two_hosts.py --loss 0 --starts 50 --discovery server

The hosts are network namespaces, see `lossy_link`. Shared memory, which would bypass the link, is
switched off. With ``--starts`` all processes are started anew each time, and the time is measured
until they have discovered each other, and until the sphere moves to a first goal: by then poses,
goal and commands have passed.
``--loss none`` is the same without a link: both nodes on this host.
"""

import argparse
import contextlib
import json
import math
import os
import statistics
import subprocess
import sys
import sysconfig
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from lossy_link import ADDRESSES, LinkError, Quality, lossy_link
from machine import write_json

from sphere_nmpc.errors import SphereNmpcError
from sphere_nmpc.model.rotation import random_quaternion
from sphere_nmpc.model.state import Vector
from sphere_nmpc.ros.network import profiles_variable
from sphere_sim.ros.session.goal_run import GoalRunner
from sphere_sim.ros.session.process_set import ProcessSet
from sphere_sim.ros.session.serving import serve_until

DEADLINE = 60.0
"""Time to a goal after which it is given up [s]."""
REACH = 1.5
"""Largest |x| and |y| of a goal [m]."""
_PATIENCE = 90.0
"""How long nodes may take to find each other or to confirm a goal; when it is sent again [s]."""
_DOMAIN, _SERVER_PORT = "65", "11811"
_MOTION = 1e-3
"""Change of the error from which on the sphere moves [mixed units]."""
_UP = 10.0
"""Time within which a start counts as up [s]."""
DISCOVERY: dict[str, dict[str, str]] = {
    "peers": {
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_STATIC_PEERS": ";".join(ADDRESSES)
    },
    "server": {"ROS_DISCOVERY_SERVER": f"{ADDRESSES[0]}:{_SERVER_PORT}"},
    "multicast": {},
}
"""Variables of each means of discovery; the server runs on the simulator's host."""
_OF_THE_LINK = ("pose_loss", "command_loss", "commitment_window_s")
"""Values of the status at the end that tell what the controller has seen of the link."""


def main() -> int:
    """Run with each quality of the link and print how many goals were reached."""
    given = _parse()
    if given.inside:
        print(json.dumps(_inside(given)))
        return 0
    results = []
    try:
        for loss in given.loss:
            quality = None if loss == "none" else Quality(
                1e-3 * given.delay, 1e-3 * given.jitter, 1e-2 * float(loss), given.burst
            )
            results.append({"loss_percent": loss, **_over(quality, given)})
            print(results[-1], flush=True)
    except (LinkError, PermissionError) as error:
        print(f"two hosts: {error}; is this Linux, and you root?", file=sys.stderr)
        return 1
    write_json(given.json, {"two_hosts": results})
    wanted, got = ("starts", "up_in_10_s") if given.starts else ("goals", "reached")
    return 0 if all(row[got] == row[wanted] for row in results) else 1


def _parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--loss", nargs="+", default=["0", "1", "5", "20"],
                        help="packets lost in either direction [%%]; none is without a link")
    parser.add_argument("--burst", type=float, default=0.0,
                        help="time in every 10 s for which all packets are lost [s]")
    parser.add_argument("--delay", type=float, default=20.0, help="in either direction [ms]")
    parser.add_argument("--jitter", type=float, default=10.0, help="around it, either way [ms]")
    parser.add_argument("--goals", type=int, default=6, help="one after the other, for each loss")
    parser.add_argument("--starts", type=int, default=0,
                        help="measure this many starts for each loss, instead of goals")
    parser.add_argument("--discovery", choices=DISCOVERY, default="peers")
    parser.add_argument("--profiles", type=Path, help="XML profiles of Fast DDS of all nodes")
    parser.add_argument("--seed", type=int, default=0, help="of the goals")
    parser.add_argument("--strategy", default="time_optimal")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--inside", metavar="OTHER", help=argparse.SUPPRESS)
    return parser.parse_args()


def _over(quality: Quality | None, given: argparse.Namespace) -> dict[str, object]:
    """Run this program again on the first of the two hosts, with the name of the second.

    Without a link that is the first one, too.
    """
    with lossy_link(quality or Quality(0.0, 0.0, 0.0)) as hosts:
        here, there = hosts if quality else 2 * hosts[:1]
        environment = {
            **{k: v for k, v in os.environ.items()
               if not k.startswith(("ROS_A", "ROS_S", "ROS_DISC", "ROS_L", "FAST"))},
            "ROS_DOMAIN_ID": os.environ.get("ROS_DOMAIN_ID", _DOMAIN),
            "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4",
            **DISCOVERY[given.discovery],
        }
        if given.profiles:
            environment[profiles_variable()] = str(given.profiles.resolve())
        own = ["--goals", str(given.goals), "--starts", str(given.starts),
               "--seed", str(given.seed), "--strategy", given.strategy, "--inside", there]

        def run() -> dict[str, float]:
            done = subprocess.run(
                ["ip", "netns", "exec", here, sys.executable, __file__, *own],
                env=environment, stdout=subprocess.PIPE, text=True, check=False,
            )
            if done.returncode:
                raise LinkError(f"the run ended with exit code {done.returncode}")
            result: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
            return result

        with _server(here) if given.discovery == "server" else contextlib.nullcontext():
            measured = _starts(run, given.starts) if given.starts else run()
        return {"discovery": given.discovery, **measured}


@contextlib.contextmanager
def _server(host: str) -> Iterator[None]:
    """Run the discovery server of Fast DDS, which does not find the libraries of its wheel."""
    programs = Path(sys.executable).parent
    libraries = [programs.parent / "lib", Path(sysconfig.get_path("purelib"), "ros_fastrtps.libs")]
    server = [str(programs / "fast-discovery-server"), "-i", "0"]
    process = subprocess.Popen(
        ["ip", "netns", "exec", host, *server, "-l", ADDRESSES[0], "-p", _SERVER_PORT],
        stdout=subprocess.DEVNULL,
        env={**os.environ, "LD_LIBRARY_PATH": os.pathsep.join(map(str, libraries))},
    )
    try:
        yield
    finally:
        process.terminate()
        process.wait()


def _starts(run: Callable[[], dict[str, float]], number: int) -> dict[str, object]:
    """Start everything `number` times, and return how long that took."""
    times = []
    for _ in range(number):
        times.append(run())
        print(times[-1], flush=True)
    result: dict[str, object] = {"starts": number}
    for name in ("found_s", "moving_s"):
        known = [time[name] for time in times if name in time]
        result[name] = round(statistics.median(known), 2) if known else None
        result[f"{name}_most"] = max(known, default=None)
    moving = [time.get("moving_s", math.inf) for time in times]
    result["up_in_10_s"] = sum(time <= _UP for time in moving)
    return {**result, "never": moving.count(math.inf)}


def _inside(given: argparse.Namespace) -> dict[str, object]:
    """Start the simulator here and the controller there, and send goals from here."""
    began = time.monotonic()
    with tempfile.TemporaryDirectory() as logs, ProcessSet(Path(logs)) as nodes:
        nodes.start("simulator", ["--ros-args", "-p", "pose_rate:=50.0"])
        nodes.start(
            "controller",
            ["--ros-args", "-p", "use_sim_time:=true", "-p", f"strategy:={given.strategy}"],
            within=["ip", "netns", "exec", given.inside],
        )
        rclpy.init(args=[])
        try:
            goals = _Goals(given.goals, given.seed)
            return goals.start(began) if given.starts else goals.run()
        except SphereNmpcError:
            print(Path(logs, "controller.log").read_text(), file=sys.stderr)
            raise
        finally:
            rclpy.try_shutdown()


class _Goals:
    """Random goals, each of which is sent when the one before has been reached."""

    def __init__(self, number: int, seed: int) -> None:
        self._number = number
        self._rng = np.random.default_rng(seed)
        self._node = rclpy.create_node("two_hosts")
        self._status: dict[str, str] = {}
        self._ages: list[float] = []
        self._goals = GoalRunner(self._node, self._spin)
        self._node.create_subscription(
            DiagnosticStatus, "controller/status", self._take_status, 10
        )

    def run(self) -> dict[str, object]:
        self._goals.prepare(_PATIENCE)
        took = [
            self._goals.go(self._goal(), DEADLINE, _PATIENCE)
            for _ in range(self._number)
        ]
        reached = [time for time in took if time is not None]
        return {
            "goals": self._number,
            "reached": len(reached),
            "settle_s_median": round(statistics.median(reached), 2) if reached else None,
            "settle_s_longest": round(max(reached), 2) if reached else None,
            "pose_age_s_mean": round(statistics.fmean(self._ages), 3),
            "late_poses": int(self._status["late_poses"]),
            "missed_ticks": int(self._status["missed_ticks"]),
            **{key: float(self._status[key]) for key in _OF_THE_LINK},
        }

    def start(self, began: float) -> dict[str, object]:
        """Return the times until everything has been found and until the sphere moves [s]."""
        times: dict[str, object] = {}
        try:
            self._goals.prepare(_PATIENCE)
            times["found_s"] = round(time.monotonic() - began, 2)
            run = self._goals.send(self._goal(), _PATIENCE)
            at_first: list[float] = []

            def moves() -> bool:
                if not at_first and not math.isnan(run.error):
                    at_first.append(run.error)
                return bool(at_first) and abs(run.error - at_first[0]) > _MOTION

            if serve_until(self._spin, moves, _PATIENCE):
                times["moving_s"] = round(time.monotonic() - began, 2)
        except SphereNmpcError as error:
            print(error, file=sys.stderr)
        return times

    def _goal(self) -> Vector:
        place = self._rng.uniform(-REACH, REACH, 2)
        return np.concatenate((place, random_quaternion(self._rng)))

    def _spin(self) -> None:
        rclpy.spin_once(self._node, timeout_sec=0.05)

    def _take_status(self, message: DiagnosticStatus) -> None:
        self._status = {pair.key: pair.value for pair in message.values}
        age = float(self._status.get("pose_age_s", "nan"))
        if math.isfinite(age):
            self._ages.append(age)


if __name__ == "__main__":
    sys.exit(main())
