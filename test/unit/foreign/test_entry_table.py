# Copyright 2026 sphere_nmpc contributors
# SPDX-License-Identifier: Apache-2.0
"""Tables of strategies and plants: what cannot be chosen is refused with what is wrong with it."""

from dataclasses import replace
from importlib.metadata import EntryPoint

import pytest

from sphere_nmpc.errors import InvalidParameterError
from sphere_nmpc.foreign import entry_table
from sphere_nmpc.foreign.entry_table import Entry, EntryTable
from sphere_nmpc.model.parameters import RobotParameters
from sphere_nmpc.model.state import upright_state
from sphere_nmpc.settings import STRATEGIES, StrategyEntry
from sphere_sim.world.plant.checked import SIZES
from sphere_sim.world.plant.contract import Plant
from sphere_sim.world.plant.factory import make_plant
from sphere_sim.world.settings import PLANTS

UPRIGHT = upright_state(0.0, 0.0, 0.0)
TABLES = {"strategy": STRATEGIES, "plant": PLANTS}
METHODS = {
    "strategy": "plan, change, reset",
    "plant": "advance, reset, displace, push, surround, tilt",
}


def test_each_class_of_this_package_has_the_methods_of_its_contract() -> None:
    for table in TABLES.values():
        for name in table.own:
            kind = table.load(name)
            assert f"{kind.__module__}:{kind.__name__}" == table[name].path


@pytest.mark.parametrize("name", sorted(PLANTS.own))
def test_plant_of_this_package_has_all_of_the_contract_which_is_all_checked(name: str) -> None:
    if name == "rigid_body":
        pytest.importorskip("mujoco")
    plant = make_plant(name, RobotParameters(), UPRIGHT)
    members = {member for member in vars(Plant) if not member.startswith("_")}
    assert not [member for member in members if not hasattr(plant, member)]
    assert {name for name in members if isinstance(vars(Plant)[name], property)} == {*SIZES}
    assert all(getattr(plant, quantity).shape == (size,) for quantity, size in SIZES.items())


@pytest.mark.parametrize("kind", TABLES)
@pytest.mark.parametrize(
    ("path", "words"),
    [
        ("nowhere:Own", "imported (ModuleNotFoundError: No module named 'nowhere')"),
        ("sphere_nmpc.settings:Missing", "imported (AttributeError: "),
        ("no path", "imported ("),
        ("sphere_nmpc.settings:StrategyEntry", "it lacks {}"),
        ("sphere_nmpc.settings", "it lacks {}"),
    ],
)
def test_class_that_is_none_is_named_with_what_is_missing(
    kind: str, path: str, words: str, monkeypatch
) -> None:
    monkeypatch.setitem(TABLES[kind], "own", Entry(path))
    with pytest.raises(InvalidParameterError, match=f"{kind}: given '") as caught:
        TABLES[kind].load("own")
    assert words.format(METHODS[kind]) in str(caught.value)


def test_name_that_is_none_is_refused_with_those_that_there_are() -> None:
    with pytest.raises(InvalidParameterError, match="plant: given 'flying', expected rolling or"):
        PLANTS.load("flying")


def test_installed_packages_bring_entries_but_take_no_name_of_this_package(monkeypatch) -> None:
    def installed(group: str) -> list[EntryPoint]:
        return [EntryPoint(name, "own:Own", group) for name in ("paper", "roll_to")]

    monkeypatch.setattr(entry_table, "entry_points", installed)
    own = {"paper": replace(STRATEGIES["paper"])}
    table = EntryTable("strategy", "a.group", "", own, StrategyEntry)
    assert list(table) == ["paper", "roll_to"] and table.own == {"paper"}
    assert table["paper"] == STRATEGIES["paper"]
    assert table["roll_to"] == StrategyEntry("own:Own", sample_period=0.25)
