# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Public names: few, loaded when used, and all that examples and notebooks import."""

import doctest
import importlib
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
from documented_examples import EXAMPLES
from notebook_cells import agree

from sphere_nmpc import Controller, Goal, LeastSquaresProblem, RobotParameters, roll_out
from sphere_sim import Simulator, run_closed_loop

PACKAGES = "sphere_nmpc", "sphere_sim"
MOST_NAMES = 25
NAMES = [(package, name) for package in PACKAGES
         for name in importlib.import_module(package).__all__]
ROOT = Path(__file__).parents[2]


def test_public_names_are_few_and_listed() -> None:
    assert len(NAMES) <= MOST_NAMES
    for package, name in NAMES:
        module = importlib.import_module(package)
        assert name in dir(module) and getattr(module, name).__doc__
    with pytest.raises(AttributeError, match="module 'sphere_sim' has no attribute 'nothing'"):
        importlib.import_module("sphere_sim").nothing  # noqa: B018


def test_packages_load_nothing_before_a_name_is_used(tmp_path) -> None:
    script = (
        "import sys; before = {*sys.modules}; import sphere_nmpc, sphere_sim\n"
        "print(*{*sys.modules} - before - {'sphere_nmpc', 'sphere_sim'})"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == ""


POSE = (0.0, 0.0, 1.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize(("typed", "says"), [
    ('Controller(strategy="paper")', "strategy: given 'paper', expected an object with plan, "),
    ('Simulator(plant="rigid_body")', "plant: given 'rigid_body', expected an object with adv"),
    ("Controller().set_goal((1.0, 2.0))", r"state: given \(2,\), expected the shape \(6,\)"),
    ("Controller().set_goal([Goal.position(0.0, 0.0)])", r"state: given .*, expected numbers \["),
    ('draw_scenarios(1, 1, "near")', "kind: given 'near', expected anywhere or "),
    ('score("papr")', "strategy: given 'papr', expected time_optimal or "),
    ('score("paper", "point")', "suite: given 'point', expected point-v1 or "),
])
def test_what_is_typed_in_another_way_is_refused_in_one_line(typed, says) -> None:
    names = {name: getattr(importlib.import_module(package), name) for package, name in NAMES}
    with pytest.raises(ValueError, match=f"^{says}"):
        eval(typed, names)


def test_lists_are_arrays_and_a_second_run_goes_on_from_the_first() -> None:
    robot, still = RobotParameters(), [[0.0, 0.0], [0.0, 0.0]]
    assert roll_out(list(POSE), still, [0.5], robot.lumped.as_array())[1].tolist() == list(POSE)
    problem = LeastSquaresProblem.of_paper(robot, POSE, POSE, [0.0, 0.0])
    assert problem.state.tolist() == [*POSE, 0.0, 0.0, 0.0]
    simulator, controller = Simulator(), Controller()
    for place in (1.0, 0.0):
        run = run_closed_loop(simulator, controller, Goal.position(place, 0.0), duration=6.0)
        assert 0.5 < run.settled_after < 6.0 and len(run.times) == 601
    assert run.times[-1] == 12.0


def sources() -> dict[str, str]:
    found = {path.name: path.read_text("utf-8") for path in EXAMPLES.glob("*.py")}
    for path in EXAMPLES.glob("*.ipynb"):
        cells = json.loads(path.read_text("utf-8"))["cells"]
        found[path.name] = "\n".join("".join(cell["source"]) for cell in cells)
    for path in (ROOT / "docs").rglob("*.md"):
        blocks = re.findall(r"```py(?:thon|con)\n(.*?)```", path.read_text("utf-8"), re.DOTALL)
        found[path.name] = "\n".join(blocks)
    return found


SHOWN = [
    pytest.param(code, output, id=f"{path.stem}-{number}")
    for path in sorted((ROOT / "docs").glob("*.md"))
    for number, (code, output) in enumerate(re.findall(
        r"```python\n([^`]*)```\n+```text\n([^`]*)```", path.read_text("utf-8")
    )) if "import" in code and "score" not in code  # a whole suite takes minutes
]


@pytest.mark.slow
@pytest.mark.parametrize(("code", "output"), SHOWN)
def test_code_in_documents_prints_what_is_shown_below_it(code, output, tmp_path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert agree(output, done.stdout), done.stdout


SECTIONS = {
    text.partition("\n")[0]: text for path in (ROOT / "docs" / "api").glob("*.md")
    for text in path.read_text("utf-8").split("\n## ")
}
"""Sections of the pages of the API, by heading."""


@pytest.mark.parametrize(("package", "name"), [
    pytest.param(*one, marks=pytest.mark.slow if one[1] == "score" else ()) for one in NAMES
])
def test_public_name_has_an_example_that_prints_what_its_page_shows(
    package, name, tmp_path, monkeypatch
) -> None:
    section = SECTIONS[name]
    assert f":: {package}.{name}" in section
    (code,) = re.findall(r"```pycon\n(.*?)```", section, re.DOTALL)
    example = doctest.DocTestParser().get_doctest(code, {"__name__": "example"}, name, None, None)
    assert re.search(rf"import .*\b{name}\b", code) and any(one.want for one in example.examples)
    monkeypatch.chdir(tmp_path)
    differences: list[str] = []
    doctest.DocTestRunner().run(example, out=differences.append)
    assert not differences, "".join(differences)


def test_examples_and_documents_import_public_names_alone() -> None:
    texts = sources()
    imports = re.compile(r"^(?:>>>)?\s*(?:from|import) (sphere_(?:nmpc|sim)[\w.]*)", re.MULTILINE)
    used = {(name, module) for name, text in texts.items() for module in imports.findall(text)}
    assert len({name for name, _ in used}) >= 6
    assert {module for _, module in used} == {*PACKAGES}
