"""The layout of the package: allowed imports, docstrings and names."""

import ast
from collections import Counter
from functools import cache
from graphlib import CycleError, TopologicalSorter
from importlib import import_module
from types import ModuleType

import pytest
from helpers.modules import MODULES, nodes_of, room_of

# A room imports from itself and from the rooms before it, never from a later room.
ROOMS = [
    "errors",
    "util",
    "chain",
    "scene",
    "theory",
    "integrators",
    "trajectory",
    "engines",
    "simulation",
    "disorder",
    "orbits",
    "measure",
    "benchmark",
    "stability",
    "design",
    "sweeps",
    "report",
    "doctor",
    "cli",
]
OPENING = 100  # Largest number of characters of the first line of a docstring.


@cache
def imported(name: str) -> set[str]:
    """Return the modules of the package that a module imports anywhere, including types."""
    package = name if MODULES[name].name == "__init__.py" else name.rpartition(".")[0]
    found = set()
    for node in nodes_of(name):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            above = (
                package.split(".")[: len(package.split(".")) + 1 - node.level] if node.level else []
            )
            base = ".".join([*above, *([node.module] if node.module else [])])
            found |= {
                f"{base}.{alias.name}" if f"{base}.{alias.name}" in MODULES else base
                for alias in node.names
            }
    return {module for module in found if module in MODULES} - {name}


def test_imports_have_no_circle():
    try:
        TopologicalSorter({name: imported(name) for name in MODULES}).prepare()
    except CycleError as error:
        pytest.fail(" imports ".join(reversed(error.args[1])))


def test_every_room_is_in_the_order():
    assert {room_of(module) for module in MODULES if module != "lmpchain"} == set(ROOMS)


def test_modules_import_from_earlier_rooms_only():
    place = {room: number for number, room in enumerate(ROOMS)}
    assert not {
        (module, other)
        for module in MODULES.keys() - {"lmpchain"}
        for other in imported(module)
        if other == "lmpchain" or place[room_of(other)] > place[room_of(module)]
    }


def test_no_engine_imports_another_engine():
    """Engines import the modules that all engines share; the registry imports engines by name."""
    engines = {name: name.split(".")[2] for name in MODULES if name.startswith("lmpchain.engines.")}
    shared = {"base", "step_control", "cost_model", "stepping"}
    assert not {
        (name, other)
        for name, engine in engines.items()
        for other in imported(name) & engines.keys()
        if engines[other] not in {engine, *shared}
    }


def test_docstrings_open_with_one_short_line():
    openings = {
        (module, text.split("\n\n")[0])
        for module in MODULES
        for node in nodes_of(module)
        if isinstance(node, ast.FunctionDef | ast.ClassDef | ast.Module)
        and (text := ast.get_docstring(node))
    }
    assert len(openings) > 2000
    assert not {each for each in openings if "\n" in each[1] or len(each[1]) > OPENING}


def test_class_names_are_unique():
    uses = Counter(
        node.name
        for module in MODULES
        for node in nodes_of(module)
        if isinstance(node, ast.ClassDef)
    )
    assert [name for name, count in uses.items() if count > 1] == []


def test_no_module_has_the_name_of_an_exported_object():
    """Python would replace the object by the module as soon as the module is imported."""
    for name, path in MODULES.items():
        if path.name == "__init__.py":
            package = import_module(name)
            modules = {
                other.rpartition(".")[2] for other in MODULES if other.rpartition(".")[0] == name
            }
            both = modules & set(getattr(package, "__all__", ()))
            assert not {
                each for each in both if not isinstance(getattr(package, each), ModuleType)
            }, name
