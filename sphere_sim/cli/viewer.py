# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""``sphere_nmpc viewer``: live or recorded sphere in the browser."""

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from sphere_nmpc.errors import printable_line
from sphere_nmpc.model.state import POSITION
from sphere_sim.output.arguments import whole
from sphere_sim.viewer.server import DEFAULT_PORT, announce

_ROS = "--ros-args"


def main(arguments: Sequence[str] | None = None) -> int:
    """Serve the page until the process is interrupted."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    at = given.index(_ROS) if _ROS in given else len(given)
    own = _parse(given[:at])
    if own.replay is None:
        # A replay does not need ROS.
        from sphere_sim.ros.viewer import node as viewer_node

        return viewer_node.main(given[at:], own.port)
    return _replay(own.replay, own.namespace, own.pose_topic, own.port)


def _parse(arguments: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="sphere_nmpc viewer",
        description="Show a sphere in the browser, on this machine only: a live one by its "
        "topics, or with --replay a recorded one.",
        epilog="ROS arguments follow --ros-args, for example: --ros-args -r __ns:=/left",
    )
    parser.add_argument("--port", type=whole(0, 65535), default=DEFAULT_PORT, metavar="P",
                        help="port of the page; a free one if it is taken (default: %(default)s)")
    parser.add_argument("--replay", type=Path, metavar="BAG",
                        help="folder of a bag, or a .mcap or .db3 file")
    parser.add_argument("--namespace", metavar="NS",
                        help="namespace of the robot, if the bag has several")
    parser.add_argument("--pose-topic", metavar="TOPIC",
                        help="topic of the robot's poses, if the bag does not say which it is")
    return parser.parse_args(arguments)


def _replay(bag: Path, namespace: str | None, pose_topic: str | None, port: int) -> int:
    from sphere_sim.recording.run_reader import read_run
    from sphere_sim.viewer.replay import Replay
    from sphere_sim.viewer.source import Pause
    from sphere_sim.viewer.viewer import FRAME_PERIOD, Viewer

    run = read_run(bag, namespace, pose_topic=pose_topic)
    for note in run.notes:
        print(printable_line(f"viewer: {note}"), file=sys.stderr, flush=True)
    replay, started = Replay(run), False
    replay.handle(Pause(True))
    viewer = Viewer(replay, port, live=False)
    viewer.tick()  # the view depends on the size of the sphere
    viewer.look_at(run.states[:, POSITION])
    announce(viewer.url)
    try:
        while True:
            viewer.tick()
            if viewer.has_pages and not started:
                started = True
                replay.handle(Pause(False))
            time.sleep(FRAME_PERIOD)
    except KeyboardInterrupt:
        return 0
    finally:
        viewer.close()
