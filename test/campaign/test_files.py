# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Damaged files, and machines that lack something."""

import os
import random
import resource
import shutil
import subprocess
from pathlib import Path

import pytest
from mcap.writer import Writer
from patience import PATIENCE
from recorded_bags import (
    STORE,
    estimated,
    momentum_messages,
    rolling_messages,
    run_messages,
    walled_messages,
    write_rosbag2,
)

from sphere_nmpc.process.child import python_command
from sphere_sim.recording.bag_files import BagError
from sphere_sim.recording.run_reader import read_run

pytestmark = pytest.mark.slow

STUDY = ("study", "--draw", "2", "--seed", "1", "--duration", "1", "--jobs", "2", "--no-bound")


KINDS = {
    "bag_0.mcap": {}, "bag_0.db3": {"kind": "sqlite3"}, "metadata.yaml": {"parts": 2},
    "bag_0.mcap.zstd": {"compression": "file"},
    "bag_0.db3.zstd": {"kind": "sqlite3", "compression": "file"},
}
"""How bags are written, by the file of them that is damaged."""


@pytest.fixture(scope="module")
def bags(tmp_path_factory) -> dict[str, Path]:
    return {
        name: write_rosbag2(tmp_path_factory.mktemp("whole") / "bag", rolling_messages(), **how)
        for name, how in KINDS.items()
    }


def damaged(content: bytes, rng: random.Random) -> bytes:
    """Return a content that is cut off, has another part, or other bytes at one or many places."""
    data, kind = bytearray(content), rng.randrange(4)
    if kind == 0:
        del data[rng.randrange(len(data)) :]
    elif kind == 1:
        place = rng.randrange(len(data))
        data[place : place + rng.randrange(1, 50)] = rng.randbytes(rng.randrange(50))
    else:
        for _ in range(1 if kind == 2 else 30):
            data[rng.randrange(len(data))] = rng.randrange(256)
    return bytes(data)


def expect_run_or_error(bag: Path, namespace: str | None = None) -> None:
    try:
        run = read_run(bag, namespace)
    except BagError as error:
        assert str(bag) in str(error)
        return
    assert len(run.times) == len(run.states) > 0
    run.metrics()


@pytest.mark.parametrize("name", KINDS)
@pytest.mark.parametrize("seed", range(12))
def test_any_damage_to_a_bag_is_read_or_refused(bags, tmp_path, name, seed) -> None:
    copy = tmp_path / "bag"
    shutil.copytree(bags[name], copy)
    file = copy / name
    file.write_bytes(damaged(file.read_bytes(), random.Random(seed)))
    expect_run_or_error(copy)


@pytest.mark.parametrize("seed", range(12))
def test_any_content_of_messages_is_read_or_refused(tmp_path, seed) -> None:
    """The file is whole, but each tenth message, or its log time, is not what it should be."""
    rng, file = random.Random(seed), tmp_path / "a.mcap"
    entries = [*momentum_messages(), *walled_messages(0.1), *estimated(run_messages("/second"))]
    with file.open("wb") as stream:
        writer, channels = Writer(stream), {}
        writer.start()
        for topic, kind, log, message in entries:
            if topic not in channels:
                schema = writer.register_schema(kind, "ros2msg", b"")
                channels[topic] = writer.register_channel(topic, "cdr", schema)
            data = bytes(STORE.serialize_cdr(message, kind))
            if rng.random() < 0.1:
                data = damaged(data, rng)
            if rng.random() < 0.01:
                log = rng.randrange(2 ** rng.randrange(65))
            writer.add_message(channels[topic], log, data, log)
        writer.finish()
    for namespace in ("/", "/second"):
        expect_run_or_error(file, namespace)


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
