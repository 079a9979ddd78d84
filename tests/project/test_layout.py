"""The shape of the package: arrows between modules run one way."""

import ast
from collections import Counter
from graphlib import CycleError, TopologicalSorter
from importlib import import_module
from pathlib import Path
from types import ModuleType

import pytest

PACKAGE = Path(__file__).parents[2] / "lmpchain"
# each room imports from itself and those before it, never from one that comes later
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
OPENING = 100  # letters of the first line of a docstring


def name_of(path: Path) -> str:
    """Return the dotted name of a module."""
    parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {name_of(path): path for path in sorted(PACKAGE.rglob("*.py"))}


def imported(path: Path) -> set[str]:
    """Return the modules of ours that a module imports, wherever in it and be it for types only."""
    name = name_of(path)
    package = name if path.name == "__init__.py" else name.rpartition(".")[0]
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
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


ARROWS = {name: imported(path) for name, path in MODULES.items()}


def room(module: str) -> str:
    return module.split(".")[1]


def test_there_is_no_circle_of_imports():
    try:
        TopologicalSorter(ARROWS).prepare()
    except CycleError as error:
        pytest.fail(" imports ".join(reversed(error.args[1])))


def test_every_room_has_its_place():
    assert {room(module) for module in MODULES if module != "lmpchain"} == set(ROOMS)


@pytest.mark.parametrize("module", sorted(MODULES.keys() - {"lmpchain"}))
def test_arrows_run_down(module: str):
    own = ROOMS.index(room(module))
    assert not {
        other for other in ARROWS[module] if other == "lmpchain" or ROOMS.index(room(other)) > own
    }


def test_no_engine_imports_another_one():
    """Engines stand on the seam and on what time steppers share; the registry imports by name."""
    rooms = {name: name.split(".")[2] for name in MODULES if name.startswith("lmpchain.engines.")}
    shared = {"base", "step_control", "cost_model", "stepping"}
    assert {
        (name, other)
        for name, room in rooms.items()
        for other in ARROWS[name] & rooms.keys()
        if rooms[other] not in {room, *shared}
    } == set()


@pytest.mark.parametrize("module", sorted(MODULES))
def test_docstrings_open_with_one_short_line(module: str):
    tree = ast.parse(MODULES[module].read_text(encoding="utf-8"))
    documented = (
        node
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef | ast.ClassDef | ast.Module)
    )
    opening = [text.split("\n\n")[0] for node in documented if (text := ast.get_docstring(node))]
    assert [text for text in opening if "\n" in text or len(text) > OPENING] == []


def test_a_class_name_stands_for_one_class():
    names = [
        node.name
        for path in MODULES.values()
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.ClassDef)
    ]
    assert [name for name, uses in Counter(names).items() if uses > 1] == []


def test_no_module_bears_the_name_of_something_that_its_package_hands_on():
    """Python would put the module in its place as soon as it is imported."""
    for name, path in MODULES.items():
        if path.name == "__init__.py":
            package = import_module(name)
            modules = {
                other.rpartition(".")[2] for other in MODULES if other.rpartition(".")[0] == name
            }
            both = modules & set(getattr(package, "__all__", ()))
            assert {
                each for each in both if not isinstance(getattr(package, each), ModuleType)
            } == set(), name
