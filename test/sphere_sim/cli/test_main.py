# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The command passes its arguments to verbs and returns their exit codes."""

import subprocess
import sys
from pathlib import Path

import pytest

from sphere_sim.cli import main as cli


@pytest.fixture
def install_verb(monkeypatch, tmp_path):
    """Return a function that makes a verb out of the source of its module."""

    def install(source: str, verb: str = "roll") -> None:
        (tmp_path / f"module_of_{verb}.py").write_text(source)
        monkeypatch.setitem(cli.VERBS, verb, (f"module_of_{verb}", "roll the sphere"))

    monkeypatch.syspath_prepend(tmp_path)
    yield install
    for name in [name for name in sys.modules if name.startswith("module_of_")]:
        del sys.modules[name]


def test_help_lists_the_verbs(install_verb, capsys) -> None:
    install_verb("")
    assert cli.main(["--help"]) == 0
    usage = capsys.readouterr().out
    assert "roll the sphere" in usage and "run one of the paper's cases" in usage


@pytest.mark.parametrize(
    ("absent", "source"),
    [("geometry_msgs.msg", "'sphere_nmpc[ros]'"), ("viser", "'sphere_nmpc[viewer]'"),
     ("casadi", "sphere_nmpc")],
)
def test_missing_package_is_named_with_its_source(
    absent, source, install_verb, monkeypatch, capsys
) -> None:
    install_verb(f"import {absent}\n")
    package = absent.partition(".")[0]
    for name in (package, absent):
        monkeypatch.setitem(sys.modules, name, None)
    assert cli.main(["roll"]) == 1
    message = capsys.readouterr().err
    assert f"'{package}'" in message
    assert message.endswith(f"pip install {source}\n")
    assert message.count("\n") == 1


def test_wrong_import_is_not_taken_for_a_missing_package(install_verb, capsys) -> None:
    install_verb("def main(argv):\n    import scipy.no_such_module\n")
    assert cli.main(["roll"]) == 1
    message = capsys.readouterr().err
    assert "unexpected ModuleNotFoundError" in message and "no_such_module" in message
    assert "is not installed" not in message


def test_installed_command_exits_with_the_code() -> None:
    command = Path(sys.executable).with_name("sphere_nmpc")
    assert subprocess.run([command, "no-such-verb"], capture_output=True).returncode == 2
