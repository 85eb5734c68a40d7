# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""How a process joins ROS: one place for the checks before it and for what can go wrong."""

import re
import sys
from collections.abc import Sequence

import rclpy
from rclpy.signals import SignalHandlerOptions

from sphere_nmpc.errors import SphereNmpcError
from sphere_nmpc.ros.environment import check_environment, missing_log_folder
from sphere_nmpc.ros.loopback import heed_localhost_only
from sphere_nmpc.ros.shared_memory import leave_to_others

_WITHOUT_LOG_FILE = ("--ros-args", "--disable-external-lib-logs")


class RosStartError(SphereNmpcError):
    """ROS cannot start, or cannot make a node, in this process."""


def join(args: Sequence[str], *, quiet: bool = False) -> None:
    """Initialise rclpy without signal handlers; `rclpy.try_shutdown` ends it.

    Parameters
    ----------
    args : sequence of str
        Arguments after the program's name.
    quiet : bool, optional
        Whether not to tell what is done without, as where nodes that are started tell it too.

    Raises
    ------
    RosEnvironmentError
        If a variable of the environment is wrong.
    RosStartError
        With ROS's own reason.
    """
    heed_localhost_only()
    check_environment()
    news = [leave_to_others()]
    unwritable = missing_log_folder()
    if unwritable is not None:
        args = [*args, *_WITHOUT_LOG_FILE]
        news.append(
            f"log file: given {unwritable}, which cannot be written, expected a folder that can; "
            "going on without one, ROS_LOG_DIR names another"
        )
    for line in news:
        if line and not quiet:
            print(line, file=sys.stderr)
    try:
        rclpy.init(args=list(args), signal_handler_options=SignalHandlerOptions.NO)
    except Exception as error:  # rclpy's own types of error are private to it
        rclpy.try_shutdown()
        raise RosStartError(one_line(error)) from None


def one_line(error: Exception) -> str:
    """Return what an error of rclpy tells, without where in its sources it noticed."""
    return re.sub(r"(, at /\S+)+$", "", " ".join(str(error).split()))
