# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Installations by pip and by colcon are complete."""

import ast
import itertools
import os
import re
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree

import pytest
import yaml
from packaging.requirements import Requirement

from sphere_sim.cli import main as cli

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
COLCON = ROOT / ".venv-colcon" / "bin" / "colcon"
EXECUTABLES = {"sphere_nmpc", *cli.VERBS}
SHARED = ("config", "examples", "launch", "rviz", "foxglove", "urdf", "msg_docs", "hook")
NATIVE = "sphere_nmpc/solver/native"
SOURCES = ("sphere_nmpc", "sphere_sim", "launch", "test", "bench", "examples")
HEADER = "# Copyright 2026 sphere_nmpc contributors\n# SPDX-License-Identifier: Apache-2.0\n"


@pytest.fixture(scope="module")
def compiler(tmp_path_factory) -> Path:
    """Return a stand-in for a C compiler, which only creates its output."""
    script = tmp_path_factory.mktemp("compiler") / "cc"
    script.write_text(f"""#!{sys.executable} -IS
import sys
open(sys.argv[sys.argv.index("-o") + 1], "w").close()
""")
    script.chmod(0o755)
    return script


@pytest.fixture(scope="module")
def tree(tmp_path_factory) -> Path:
    """Copy of the files that a build reads, so that it leaves nothing in the source tree."""
    copy = tmp_path_factory.mktemp("tree") / "sphere_nmpc"
    copy.mkdir()
    ignore = shutil.ignore_patterns("__pycache__", "*.so")
    for name in ("resource", "sphere_nmpc", "sphere_sim", *SHARED):
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, copy / name, ignore=ignore)
    for name in (
        "setup.py", "setup.cfg", "pyproject.toml", "package.xml", "colcon.pkg", "LICENSE",
        "README.md",
    ):
        if (ROOT / name).is_file():
            shutil.copy(ROOT / name, copy)
    return copy


def shared_files(tree: Path) -> set[str]:
    """Return the files that belong under share/sphere_nmpc, relative to it."""
    return {"package.xml"} | {
        path.relative_to(tree).as_posix()
        for name in SHARED for path in tree.glob(f"{name}/**/*.*")
    }


def environment(compiler: Path | str) -> dict[str, str]:
    """Return the environment with a compiler and without the variables that the ROS wheels set.

    With these a child that runs another interpreter would load libraries of this one.
    """
    leftovers = ("LD_LIBRARY_PATH", "_ROS_WHEELS_BOOTSTRAP_COMPLETE")
    kept = {name: value for name, value in os.environ.items() if name not in leftovers}
    return kept | {"CC": str(compiler)}


def run(*command: str | Path, compiler: Path | str = "cc", **options) -> str:
    """Return the output of a command that compiles with a given compiler."""
    done = subprocess.run(
        command, env=environment(compiler), capture_output=True, text=True, check=False, **options
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_wheel_is_complete(tree, tmp_path, compiler) -> None:
    options = ("--quiet", "--no-deps", "--no-build-isolation", "--wheel-dir", tmp_path)
    run(sys.executable, "-m", "pip", "wheel", *options, tree, compiler=compiler)
    with zipfile.ZipFile(next(tmp_path.glob("*.whl"))) as wheel:
        names = set(wheel.namelist())
        entry_points = wheel.read("sphere_nmpc-0.1.0.dist-info/entry_points.txt").decode()
    sources = {
        path.relative_to(tree).as_posix()
        for package in ("sphere_nmpc", "sphere_sim")
        for path in (tree / package).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    share = "sphere_nmpc-0.1.0.data/data/share"
    assert sources <= names
    assert "sphere_nmpc/solver/native/solver.so" in names
    assert {f"{share}/sphere_nmpc/{name}" for name in shared_files(tree)} <= names
    assert f"{share}/ament_index/resource_index/packages/sphere_nmpc" in names
    assert set(re.findall(r"^(\w+) =", entry_points, re.MULTILINE)) == EXECUTABLES


@pytest.mark.skipif(not COLCON.exists(), reason="make test provides colcon")
@pytest.mark.parametrize("option", [[], ["--symlink-install"]], ids=["copy", "symlink"])
def test_colcon_installs_executables_and_shared_files(
    tree, tmp_path, option, compiler
) -> None:
    bases = ("--build-base", tmp_path / "build", "--install-base", tmp_path / "install")
    logs = ("--log-base", tmp_path / "log")
    for built in tree.rglob("solver*.so"):
        built.unlink()
    run(COLCON, *logs, "build", *bases, *option, cwd=tree, compiler=compiler)
    # A linked installation has it in the source tree.
    built = tree if option else tmp_path / "install"
    assert list(built.rglob("solver.so"))
    prefix = tmp_path / "install" / "sphere_nmpc"
    for name in EXECUTABLES:
        assert os.access(prefix / "lib" / "sphere_nmpc" / name, os.X_OK)
    for name in shared_files(tree):
        assert (prefix / "share" / "sphere_nmpc" / name).is_file(), name
    assert (prefix / "share/ament_index/resource_index/packages/sphere_nmpc").is_file()
    for shell, setup in (("sh", "local_setup.sh"), ("bash", "setup.bash")):
        words = f". {tmp_path}/install/{setup} && command -v sphere_nmpc && sphere_nmpc --version"
        path, version = run(shell, "-c", words).splitlines()
        assert Path(path).is_relative_to(prefix) and version == "sphere_nmpc 0.1.0"


def test_installations_from_one_tree_at_once_and_one_without_a_compiler(
    tree, tmp_path, compiler
) -> None:
    """The one without a compiler says so in one line, and is complete."""
    build = [sys.executable, "setup.py", "--quiet", "build_ext", "--inplace"]
    builds = [
        subprocess.Popen(
            build, cwd=tree, env=environment(one), text=True, stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
        )
        for one in (compiler, compiler, "/bin/false")
    ]
    errors = [build.communicate()[1] for build in builds]
    assert not any(build.returncode for build in builds), errors
    made = {path.name for path in (tree / NATIVE).glob("*.so*")}
    assert "solver.so" in made and not any(name[-1].isdigit() for name in made)
    assert ["not compiled" in text for text in errors] == [False, False, True]
    assert len(errors[2].splitlines()) == 1


@pytest.mark.parametrize("suffix", ["", ".exe"])
def test_executable_named_like_a_verb_runs_it(suffix, monkeypatch) -> None:
    given = []
    module = SimpleNamespace(main=lambda arguments: given.append(arguments) or 7)
    monkeypatch.setattr(cli, "import_module", {cli.VERBS["study"][0]: module}.__getitem__)
    monkeypatch.setattr(sys, "argv", [f"/lib/sphere_nmpc/study{suffix}", "--out", "x"])
    assert cli.main(cli.of_process()) == 7
    assert given == [["--out", "x"]]


def test_package_xml_agrees_with_setup() -> None:
    package = ElementTree.parse(ROOT / "package.xml").getroot()
    installed = metadata.metadata("sphere_nmpc")
    for tag, field in (("name", "Name"), ("version", "Version"), ("license", "License")):
        assert package.findtext(tag) == (installed[field] or installed["License-Expression"]), tag
    maintainer = package.find("maintainer")
    assert maintainer.attrib["email"] == installed["Maintainer-email"]
    assert package.findtext("export/build_type") == "ament_python"


def test_citation_names_this_version_and_the_paper() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    package = ElementTree.parse(ROOT / "package.xml").getroot()
    for key in ("version", "license"):
        assert citation[key] == package.findtext(key)
    # What version 1.2.0 of the format requires.
    assert citation["cff-version"] == "1.2.0" and citation["message"] and citation["title"]
    (paper,) = citation["references"]
    for entry in (citation, paper):
        assert entry["title"] and all(author["name"] for author in entry["authors"])
    assert paper["type"] == "article"
    assert " ".join(paper["title"].split()) in " ".join(
        (ROOT / "README.md").read_text().replace("\n> ", " ").split()
    )


def test_core_requires_three_packages_only() -> None:
    requirements = map(Requirement, metadata.requires("sphere_nmpc"))
    core = {r.name for r in requirements if "extra" not in str(r.marker)}
    assert core == {"numpy", "scipy", "casadi"}


def test_lock_satisfies_every_extra() -> None:
    lines = (ROOT / "requirements" / "lock.txt").read_text().splitlines()
    pins = [Requirement(line) for line in lines if line and not line.startswith("#")]
    version = {pin.name: next(iter(pin.specifier)).version for pin in pins}
    for requirement in map(Requirement, metadata.requires("sphere_nmpc")):
        assert requirement.name in version
        assert requirement.specifier.contains(version[requirement.name]), requirement


def test_sources_carry_the_licence_header() -> None:
    bare = [
        str(path.relative_to(ROOT))
        for folder in SOURCES
        for path in sorted((ROOT / folder).rglob("*.py"))
        if not path.read_text().removeprefix("#!/usr/bin/env python3\n").startswith(HEADER)
    ]
    assert not bare


def test_make_says_what_it_installs_and_how_large_it_is() -> None:
    # The stamp of the environment counts as old, and nothing is done.
    done = subprocess.run(
        ["make", "--dry-run", "--always-make", "demo", "test"], cwd=ROOT, capture_output=True,
        text=True, check=True,
    )
    told = [line for line in done.stdout.splitlines() if line.startswith("echo")]
    for words in ("1 of 2", "MB to download", "GB on disk", "2 of 2", "2000 tests take"):
        assert any(words in line for line in told), words


def test_what_the_documents_write_is_ignored_by_git() -> None:
    ignored = (ROOT / ".gitignore").read_text().splitlines()
    documents = [ROOT / "README.md", ROOT / "Makefile", *(ROOT / "docs").glob("*.md")]
    written = {
        folder for text in documents
        for folder in re.findall(r"--(?:out|json) (\w+/)", text.read_text(encoding="utf-8"))
    }
    assert "out/" in written
    assert written - {"docs/"} <= set(ignored)


def described_constants(source: str) -> Iterator[tuple[int, str]]:
    """Yield the line and the docstring of each constant and attribute that has one."""
    for block in ast.walk(ast.parse(source)):
        body = getattr(block, "body", None)
        for one, after in itertools.pairwise(body if isinstance(body, list) else []):
            if isinstance(one, ast.Assign | ast.AnnAssign) and isinstance(after, ast.Expr):
                text = getattr(after.value, "value", None)
                if isinstance(text, str):
                    yield one.lineno, text.strip()


def test_docstring_of_each_constant_reads_alone() -> None:
    """It begins with a capital letter and ends with a full stop, not in the one after it."""
    found = [
        (f"{path.relative_to(ROOT)}:{line}: {text}", text)
        for folder in SOURCES
        for path in sorted((ROOT / folder).rglob("*.py"))
        for line, text in described_constants(path.read_text())
    ]
    assert len(found) > 500
    assert not [
        place for place, text in found
        if not text[0].isupper() or not text.endswith(".") or text.endswith("..")
    ]
