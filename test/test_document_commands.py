# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Commands in the documents: parsers and settings of the package accept each of them.

Nothing is run: arguments go through the parsers of the package, parameters through its settings,
payloads into the messages, and launch arguments into the launch file.
"""

import shlex
from collections.abc import Callable
from functools import partial

import pytest

pytest.importorskip("rclpy")

from command_checks import (
    SETTINGS,
    WrongCommandError,
    check_for_some_node,
    check_launch,
    check_own,
    check_ros,
    check_verb,
)
from document_commands import Command, all_commands, commands
from launch_stand_in import declared_arguments
from ros2_checks import (
    check_parameter_get,
    check_parameter_set,
    check_publication,
    check_recording,
    check_service_call,
    check_subscription,
)

OF_A_VERB = ("sphere_nmpc", "ros2 run sphere_nmpc")
CHECKS: dict[str, Callable[[tuple[str, ...]], None]] = {
    "make demo": lambda words: check_make("demo", words),
    "make faults": lambda words: check_make("faults", words),
    "ros2 launch sphere_nmpc": check_launch,
    "ros2 topic pub": check_publication,
    "ros2 topic echo": check_subscription,
    "ros2 topic hz": check_subscription,
    "ros2 topic info": check_subscription,
    "ros2 service call": check_service_call,
    "ros2 param set": check_parameter_set,
    "ros2 param get": check_parameter_get,
    "ros2 bag record": check_recording,
    "--ros-args": lambda words: check_ros(None, words),
    "-p": lambda words: check_ros(None, ("-p", *words)),
    "-r": lambda words: check_ros(None, ("-r", *words)),
}
"""Check of commands with this beginning; it is called with the remaining words."""
UNCHECKED = (
    # Tools of ROS whose arguments do not depend on the package.
    "ros2 security", "ros2 pkg prefix", "ros2 topic list", "ros2 node list", "colcon", "rosdep",
    ".venv/bin/fast-discovery-server",
    # test_documents.py checks that targets and scripts exist.
    "make", "python", "python3", ".venv/bin/python",
    # Tools of the system.
    ".", "apt", "done", "export", "for", "dask", "openssl", "pip",
    ".venv-acados/bin/pip", "ssh", "touch",
    # Not a command but a line of /etc/security/limits.conf.
    "your_user - rtprio",
)
"""Beginnings of commands that are not checked."""


def check_make(verb: str, words: tuple[str, ...]) -> None:
    for word in words:
        name, _, value = word.partition("=")
        if name == "ARGS":
            check_own(verb, shlex.split(value), False)


def check_assignment(word: str) -> None:
    """Check name:=value in running text, which is an argument of launch or a parameter."""
    name, _, value = word.partition(":=")
    if name in declared_arguments():
        check_launch(("sphere.launch.py", word))
    elif not name.startswith("__"):
        check_for_some_node(list(SETTINGS), name, value)


def check(command: Command) -> None:
    """Check a command by the check of its longest known beginning.

    Raises
    ------
    WrongCommandError
        If it would be refused, or is of an unknown kind.
    """
    words = command.words
    checks = {**CHECKS, **dict.fromkeys(OF_A_VERB, partial(check_verb, inline=command.inline))}
    for end in range(len(words), 0, -1):
        beginning = " ".join(words[:end])
        if beginning in checks:
            # Such as `ros2 bag record -a` in a sentence about it.
            is_a_mention = command.inline and all(w.startswith("-") for w in words[end:])
            return None if is_a_mention else checks[beginning](words[end:])
        if beginning in UNCHECKED:
            return None
    if ":=" in words[0]:
        return check_assignment(words[0])
    if command.inline and any(known.startswith(" ".join(words)) for known in checks):
        return None  # such as `ros2 topic`
    raise WrongCommandError("a new kind of command: add a check, or name it in UNCHECKED")


@pytest.mark.parametrize("command", all_commands(), ids=str)
def test_command_in_a_document_is_understood(command) -> None:
    wrong = ""
    try:
        check(command)
    except WrongCommandError as error:
        wrong = f"{command}\n    {error}"
    if wrong:
        pytest.fail(wrong, pytrace=False)


@pytest.mark.parametrize(
    ("line", "wrong"),
    [
        ("ros2 run sphere_nmpc fly", "fly: no executable"),
        ("sphere_nmpc report bag", "required: --out"),
        ("make demo ARGS='--case 9'", "invalid choice: 9"),
        ("sphere_nmpc controller --ros-args -p strateggy:=paper", "no parameter strateggy"),
        ("sphere_nmpc simulator --ros-args -p robot.shell_mass:=0.0", "shell_mass: given 0.0"),
        ("ros2 launch sphere_nmpc sphere.launch.py rvis:=true", "rvis: not an argument"),
        ("ros2 topic pub -t 3 /goal geometry_msgs/msg/PoseStamped", "/goal: not in"),
        ("ros2 service call /simulator/pause std_srvs/srv/SetBool '{data: a}'", "data: given"),
        ("ros2 param set /controller horizon 5", "cannot be changed while it runs"),
        ("ros2 bag record /poses", "/poses: not in"),
        ("docker run ros", "a new kind of command"),
    ],
)
def test_wrong_command_is_refused(line, wrong) -> None:
    (command,) = commands("a.md", f"```\n{line}\n```\n")
    with pytest.raises(WrongCommandError) as caught:
        check(command)
    assert wrong in str(caught.value)


def test_commands_are_found_in_blocks_and_in_text() -> None:
    text = (
        "Type `ros2 topic\necho /pose` or `pose`:\n\n"
        "    make demo && . a/b   # here\n\n"
        "```\n# no command\nFOO=1 sudo ros2 run \\\n    a 'b c' $(ros2 pkg prefix a)/d\n```\n"
        "```python\nx = 1\n```\n    y = (x)\n"
    )
    found = {command.words: command.inline for command in commands("a.md", text)}
    assert found == {
        ("ros2", "pkg", "prefix", "a"): False,
        ("ros2", "run", "a", "b c", "OUTPUT/d"): False,
        ("make", "demo"): False,
        (".", "a/b"): False,
        ("ros2", "topic", "echo", "/pose"): True,
    }
