# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Initialisation of rclpy in a process: checks of the environment and errors in one line."""

import re
import sys
from collections.abc import Sequence
from itertools import pairwise

import rclpy
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from sphere_nmpc.errors import SphereNmpcError, printable_line
from sphere_nmpc.ros.network import prepare_environment, unwritable_log_folder

_WITHOUT_LOG_FILE = ("--ros-args", "--disable-external-lib-logs")
_BEFORE_ASSIGNMENTS = ("-p", "--param", "-r", "--remap", "--log-level")


class RosStartError(SphereNmpcError):
    """Failure to initialise ROS, or to create a node, in this process."""


class RosArgumentsError(SphereNmpcError):
    """Arguments on the command line that ROS refuses, or takes for something else."""

    exit_code = 2


def without_ros_arguments(words: Sequence[str]) -> list[str]:
    """Return the arguments, after the program's name, that are not for ROS.

    `RosArgumentsError` is raised for one that ROS refuses, and for ``strategy:=paper`` alone,
    which ROS takes for the remapping of a topic where no ``--ros-args`` precedes it.
    """
    for before, word in pairwise(["", *words]):
        if ":=" in word and before not in _BEFORE_ASSIGNMENTS:
            raise RosArgumentsError(
                f"given {word}, expected --ros-args -p {word} for a parameter, -r {word} for a "
                "remapping"
            )
    try:
        return list(remove_ros_args(["node", *words])[1:])
    except Exception as error:  # the error types of rclpy are private
        reason = one_line(error)
        if reason.startswith("["):  # of words that it does not know, it has only the list
            reason = f"arguments after --ros-args: given {reason}, which ROS does not know"
        raise RosArgumentsError(reason) from None


def start_ros(args: Sequence[str], *, quiet: bool = False) -> None:
    """Initialise rclpy without signal handlers; `rclpy.try_shutdown` reverses it.

    `args` are those after the program's name. `quiet` omits the messages about a missing log
    file, network or shared memory, where the nodes that are started afterwards print them too.
    `RosEnvironmentError` or `RosStartError` has the reason if it fails.
    """
    messages = prepare_environment()
    unwritable = unwritable_log_folder()
    if unwritable is not None:
        args = [*args, *_WITHOUT_LOG_FILE]
        messages.append(
            f"log file: given {unwritable}, which cannot be written, expected a writable folder; "
            "continuing without a log file, set ROS_LOG_DIR to choose another folder"
        )
    for message in messages:
        if not quiet:
            print(message, file=sys.stderr)
    try:
        rclpy.init(args=list(args), signal_handler_options=SignalHandlerOptions.NO)
    except Exception as error:  # the error types of rclpy are private
        rclpy.try_shutdown()
        raise RosStartError(one_line(error)) from None


def one_line(error: Exception) -> str:
    """Return the message of an rclpy error in one printable line, without source locations."""
    return printable_line(re.sub(r"(, at /\S+)+$", "", " ".join(str(error).split())))
