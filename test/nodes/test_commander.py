# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""The example with BasicNavigator, run against simulator, controller and navigator."""

import importlib.util
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import navigation_messages
import pytest
from navigation_session import Session
from patience import PATIENCE

from sphere_sim.ros.session.process_set import ProcessSet

ROOT = Path(__file__).parents[2]


@pytest.fixture
def commander(tmp_path) -> Path:
    """Return a folder with nav2_simple_commander: that of Nav2, or what stands in for it."""
    if importlib.util.find_spec("nav2_simple_commander") is None:
        package = tmp_path / "nav2_simple_commander"
        package.mkdir()
        (package / "__init__.py").touch()
        stand_in = ROOT / "test" / "support" / "commander_stand_in.py"
        shutil.copy(stand_in, package / "robot_navigator.py")
    return tmp_path


@pytest.mark.slow
def test_example_runs_as_printed(graph, tmp_path, monkeypatch, commander) -> None:
    navigation_messages.provide()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))  # the stored goal
    path = os.pathsep.join([str(commander), *filter(None, sys.path)])
    with ProcessSet(tmp_path) as processes:
        Session(graph, processes)
        done = subprocess.run(
            [sys.executable, str(ROOT / "examples" / "commander.py")], text=True, check=False,
            capture_output=True, env=os.environ | {"PYTHONPATH": path}, timeout=PATIENCE,
        )
    assert done.returncode == 0, done.stderr
    way, *ends = done.stdout.splitlines()
    assert re.fullmatch(r"the way to the pose was \d\.\d m long", way)
    assert ends == ["pose: succeeded", "waypoints: succeeded", "far pose: canceled"]
