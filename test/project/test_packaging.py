# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Installations by pip and by colcon are complete."""

import os
import platform
import re
import shlex
import shutil
import subprocess
import sys
import zipfile
from importlib import metadata
from pathlib import Path
from xml.etree import ElementTree

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from sphere_nmpc.solver.native.codegen import generated
from sphere_nmpc.solver.native.library import FOLDER
from sphere_sim.cli import main as cli

ROOT = Path(__file__).parents[2]
COLCON = ROOT / ".venv-colcon" / "bin" / "colcon"
SHARED = ("config", "examples", "launch", "rviz", "foxglove", "urdf", "msg_docs", "hook")
NATIVE = "sphere_nmpc/solver/native"


@pytest.fixture(scope="module")
def tree(tmp_path_factory) -> Path:
    """Copy of the files that a build reads, so that it leaves nothing in the source tree."""
    copy = tmp_path_factory.mktemp("tree") / "sphere_nmpc"
    copy.mkdir()
    ignore = shutil.ignore_patterns("__pycache__", "*.so")
    for name in ("resource", "scripts", "sphere_nmpc", "sphere_sim", *SHARED):
        shutil.copytree(ROOT / name, copy / name, ignore=ignore, symlinks=True)
    for name in (
        "setup.py", "setup.cfg", "pyproject.toml", "package.xml", "colcon.pkg", "LICENSE",
        "README.md",
    ):
        shutil.copy(ROOT / name, copy)
    return copy


def shared_files(tree: Path) -> set[str]:
    """Return the files that belong under share/sphere_nmpc, relative to it."""
    return {"package.xml"} | {
        path.relative_to(tree).as_posix()
        for name in SHARED for path in tree.glob(f"{name}/**/*.*")
    }


@pytest.fixture(scope="module")
def environment(tmp_path_factory) -> dict[str, str]:
    """Return the environment with a stand-in for a C compiler, which only creates its output.

    It is without the variables that the ROS wheels set: with these a child that runs another
    interpreter would load libraries of this one.
    """
    compiler = tmp_path_factory.mktemp("compiler") / "cc"
    creates = 'open(sys.argv[sys.argv.index("-o") + 1], "w").close()'
    compiler.write_text(f"#!{sys.executable} -IS\nimport sys\n{creates}\n")
    compiler.chmod(0o755)
    leftovers = ("LD_LIBRARY_PATH", "_ROS_WHEELS_BOOTSTRAP_COMPLETE")
    kept = {name: value for name, value in os.environ.items() if name not in leftovers}
    return kept | {"CC": str(compiler)}


def run(*command: str | Path, **options) -> str:
    """Return the output of a command."""
    done = subprocess.run(command, capture_output=True, text=True, check=False, **options)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.slow
def test_wheel_is_complete(tree, tmp_path, environment) -> None:
    options = ("--quiet", "--no-deps", "--no-build-isolation", "--wheel-dir", tmp_path)
    run(sys.executable, "-m", "pip", "wheel", *options, tree, env=environment)
    (file,) = tmp_path.glob("*.whl")
    # One for every Python 3.
    assert re.fullmatch(r"sphere_nmpc-0\.1\.0-py3-none-\w+\.whl", file.name)
    with zipfile.ZipFile(file) as wheel:
        names = set(wheel.namelist())
        entry_points = wheel.read("sphere_nmpc-0.1.0.dist-info/entry_points.txt").decode()
    sources = {
        path.relative_to(tree).as_posix()
        for package in ("sphere_nmpc", "sphere_sim")
        for path in (tree / package).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
        # C is compiled.
        and path.suffix not in {".c", ".h", ".inc"}
    }
    share = "sphere_nmpc-0.1.0.data/data/share"
    assert sources <= names
    assert "sphere_nmpc/solver/native/solver.so" in names
    assert {f"{share}/sphere_nmpc/{name}" for name in shared_files(tree)} <= names
    assert f"{share}/ament_index/resource_index/packages/sphere_nmpc" in names
    executables = {f"sphere_nmpc-0.1.0.data/data/lib/sphere_nmpc/{verb}" for verb in cli.VERBS}
    assert executables <= names
    assert re.findall(r"^(\w+) =", entry_points, re.MULTILINE) == ["sphere_nmpc"]


@pytest.mark.skipif(platform.machine() not in ("x86_64", "aarch64"), reason="has no wheels")
def test_compiled_solver_needs_no_newer_glibc_than_its_wheels_say() -> None:
    promised = re.search(r"platform=manylinux_(\d+)_(\d+)", (ROOT / ".ci/wheels").read_text())
    libraries = list(FOLDER.glob("solver*.so"))
    needed = {
        tuple(map(int, version.split(b".")))
        for file in libraries for version in re.findall(rb"GLIBC_([\d.]+)", file.read_bytes())
    }
    assert libraries and max(needed, default=(0,)) <= tuple(map(int, promised.groups()))


@pytest.mark.slow
@pytest.mark.skipif(not COLCON.exists(), reason="make test provides colcon")
@pytest.mark.parametrize("option", [[], ["--symlink-install"]], ids=["copy", "symlink"])
def test_colcon_installs_executables_and_shared_files(
    tree, tmp_path, option, environment
) -> None:
    workspace = tmp_path / "a workspace"
    bases = ("--build-base", workspace / "build", "--install-base", workspace / "install")
    logs = ("--log-base", workspace / "log")
    for built in tree.rglob("solver*.so"):
        built.unlink()
    run(COLCON, *logs, "build", *bases, *option, cwd=tree, env=environment)
    # A linked installation has it in the source tree.
    built = tree if option else workspace / "install"
    assert list(built.rglob("solver.so")) and list(built.rglob("point-v1/scenarios.csv"))
    prefix = workspace / "install" / "sphere_nmpc"
    for name in ("sphere_nmpc", *cli.VERBS):
        assert os.access(prefix / "lib" / "sphere_nmpc" / name, os.X_OK)
    for name in shared_files(tree):
        assert (prefix / "share" / "sphere_nmpc" / name).is_file(), name
    assert (prefix / "share/ament_index/resource_index/packages/sphere_nmpc").is_file()
    for shell, setup in (("sh", "local_setup.sh"), ("bash", "setup.bash")):
        install = shlex.quote(f"{workspace}/install/{setup}")
        words = f". {install} && command -v sphere_nmpc && sphere_nmpc --version"
        path, version = run(shell, "-c", words, env=environment).splitlines()
        assert Path(path).is_relative_to(prefix) and version == "sphere_nmpc 0.1.0"


@pytest.mark.slow
def test_installations_from_one_tree_at_once(tree, environment) -> None:
    build = [sys.executable, "setup.py", "--quiet", "build_ext", "--inplace"]
    builds = [
        subprocess.Popen(build, cwd=tree, env=environment, text=True, stderr=subprocess.PIPE)
        for _ in range(2)
    ]
    errors = [build.communicate()[1] for build in builds]
    assert not any(build.returncode for build in builds), errors
    made = {path.name for path in (tree / NATIVE).glob("*.so*")}
    assert "solver.so" in made and not any(name[-1].isdigit() for name in made)


@pytest.mark.slow
def test_without_a_compiler_a_build_fails_with_its_cure_unless_it_is_told_otherwise(
    tree, tmp_path, environment
) -> None:
    """Then it makes a wheel for any platform, without a compiled solver."""
    build = [sys.executable, "setup.py", "--quiet", "bdist_wheel", "--dist-dir", str(tmp_path)]
    without = environment | {"CC": "/bin/false"}
    failed = subprocess.run(build, cwd=tree, env=without, text=True, capture_output=True)
    assert failed.returncode != 0 and not list(tmp_path.iterdir())
    assert "apt install gcc" in failed.stderr and "SPHERE_NMPC_SOLVER=plain" in failed.stderr
    assert "Traceback" not in failed.stderr
    run(*build, cwd=tree, env=without | {"SPHERE_NMPC_SOLVER": "plain"})
    assert [path.name for path in tmp_path.iterdir()] == ["sphere_nmpc-0.1.0-py3-none-any.whl"]


def test_generated_sources_are_those_of_the_model() -> None:
    """As CasADi of the lock file generates them: another version may name or order differently."""
    for name, text in generated().items():
        assert (ROOT / NATIVE / name).read_text(encoding="utf-8") == text, (
            f"{name} is not up to date: python -m sphere_nmpc.solver.native.codegen"
        )


def test_package_xml_setup_and_citation_agree() -> None:
    package = ElementTree.parse(ROOT / "package.xml").getroot()
    installed = metadata.metadata("sphere_nmpc")
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert citation["version"] == package.findtext("version") == installed["Version"]
    assert citation["license"] == package.findtext("license")
    assert package.findtext("export/build_type") == "ament_python"
    # What version 1.2.0 of the format requires.
    assert citation["cff-version"] == "1.2.0" and citation["message"]
    (paper,) = citation["references"]
    for entry in (citation, paper):
        assert entry["title"] and all(author["name"] for author in entry["authors"])
    readme = " ".join((ROOT / "README.md").read_text().replace("\n> ", " ").split())
    assert " ".join(paper["title"].split()) in readme


def test_platforms_that_are_claimed_are_those_of_the_table_of_what_was_run() -> None:
    _, _, table = (ROOT / "QUALITY_DECLARATION.md").read_text().partition("\n## What was run\n")
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in table.splitlines()[6:]]
    was_run = [row for row in rows if not row[-1].startswith("not run")]
    classifiers = metadata.metadata("sphere_nmpc").get_all("Classifier") or []
    versions = [c.split(" :: ")[2] for c in classifiers if "Python :: 3." in c]
    assert sorted({row[0] for row in was_run}) == sorted(versions)
    wheels = {r.split("-")[1] for r in metadata.requires("sphere_nmpc") or [] if "-rclpy" in r}
    assert {row[2] for row in was_run} == {f"{name.title()}, wheels" for name in wheels}


def pins(name: str) -> dict[str, str]:
    """Return the versions in a file of requirements by names, without the files it includes."""
    lines = (ROOT / "requirements" / name).read_text().splitlines()
    found = [Requirement(line) for line in lines if line[:1] not in ("", "#", "-")]
    return {canonicalize_name(pin.name): next(iter(pin.specifier)).version for pin in found}


def test_demo_has_all_that_its_extras_require_and_nothing_else() -> None:
    # SciPy is for maps, empy for the generation of code from messages.
    left_out = {"scipy", "empy"}
    todo, seen = [Requirement("sphere_nmpc[ros,record,sim,viewer]")], set()
    while todo:
        wanted = todo.pop()
        name = canonicalize_name(wanted.name)
        for extra in {"", *wanted.extras} if name not in left_out else ():
            if (name, extra) not in seen:
                seen.add((name, extra))
                todo += [it for it in map(Requirement, metadata.requires(name) or [])
                         if it.marker is None or it.marker.evaluate({"extra": extra})]
    needed = {name for name, _ in seen} - {"sphere-nmpc"}
    assert pins("demo.txt").keys() == needed | {"setuptools"}
    assert not pins("demo.txt").keys() & pins("lock.txt").keys()


def test_the_package_requires_numpy_only_and_the_lock_satisfies_every_extra() -> None:
    of_all = (r for r in metadata.requires("sphere_nmpc") if "ros-kilted-" not in r)
    requirements = [*map(Requirement, of_all)]
    core = {r.name for r in requirements if "extra" not in str(r.marker)}
    assert core == {"numpy"}
    version = pins("demo.txt") | pins("lock.txt")
    assert "-r demo.txt" in (ROOT / "requirements" / "lock.txt").read_text()
    for requirement in requirements:
        found = version[canonicalize_name(requirement.name)]
        assert requirement.specifier.contains(found), requirement
