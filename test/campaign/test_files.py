# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Damaged files, and machines that lack something."""

import os
import random
import resource
import subprocess
from pathlib import Path

import pytest
from patience import PATIENCE
from recorded_bags import rolling_messages, write_own

from sphere_nmpc.child import python_command
from sphere_sim.recording.bag_files import BagError
from sphere_sim.recording.run_reader import read_run

pytestmark = pytest.mark.slow

STUDY = ("study", "--draw", "2", "--seed", "1", "--duration", "1", "--jobs", "2", "--no-bound")


@pytest.fixture(scope="module")
def bag(tmp_path_factory) -> Path:
    return write_own(tmp_path_factory.mktemp("whole") / "bag", rolling_messages())


@pytest.mark.parametrize("name", ["metadata.yaml", "bag_0.mcap"])
@pytest.mark.parametrize("seed", range(12))
def test_any_damage_to_a_bag_is_read_or_refused(bag, tmp_path, name, seed) -> None:
    rng = random.Random(seed)
    copy = tmp_path / "bag"
    copy.mkdir()
    for file in bag.iterdir():
        data = bytearray(file.read_bytes())
        if file.name == name:
            kind = seed % 4
            if kind == 0:
                del data[rng.randrange(len(data)) :]
            elif kind == 1:
                place = rng.randrange(len(data))
                data[place : place + rng.randrange(1, 50)] = rng.randbytes(rng.randrange(50))
            else:
                for _ in range(1 if kind == 2 else 30):
                    data[rng.randrange(len(data))] = rng.randrange(256)
        (copy / file.name).write_bytes(data)
    try:
        run = read_run(copy)
    except BagError as error:
        assert str(copy) in str(error)
        return
    assert len(run.times) == len(run.states) > 0


def test_study_without_a_home_and_with_few_files_has_its_results(tmp_path) -> None:
    program = "from sphere_sim.cli.main import main; sys.exit(main())"
    done = subprocess.run(
        python_command(program, *STUDY, "--out", str(tmp_path / "out")),
        # Not even root can create a folder there.
        env={**os.environ, "HOME": "/dev/null/home"},
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (40, 40)),
        capture_output=True, text=True, timeout=PATIENCE, cwd=tmp_path,
    )
    assert done.returncode == 0 and "Traceback" not in done.stderr, done.stderr
    assert (tmp_path / "out" / "runs.csv").exists()
