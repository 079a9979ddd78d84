"""A mutant changes executed statements and expressions, and nothing else."""

import ast
import subprocess
import sys
from pathlib import Path

import mutants
import pytest

MODULES = sorted((mutants.PROJECT / "lmpchain").rglob("*.py"))


def test_every_mutant_is_a_different_program(tmp_path: Path):
    for module in MODULES[::64]:
        program = ast.dump(ast.parse(module.read_text(encoding="utf-8")))
        copy = tmp_path / module.relative_to(mutants.PROJECT)
        copy.parent.mkdir(parents=True, exist_ok=True)
        for mutant in mutants.mutants_of(module)[::7]:
            copy.write_bytes(module.read_bytes())
            mutant.write(tmp_path)
            assert ast.dump(ast.parse(copy.read_text(encoding="utf-8"))) != program, mutant


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("a < b", "(a >= b)"),
        ("a - b", "(a + b)"),
        ("a / b", "(a * b)"),
        ("a and b", "(a or b)"),
        ("-a", "(a)"),
        ("2", "(3)"),
        ("0.5", "(0.6)"),
        ("True", "(False)"),
        ("'m/s'", None),
        ("a", None),
    ],
)
def test_expressions_are_changed(before: str, after: str | None):
    assert mutants.mutate(ast.parse(before).body[0].value) == after


@pytest.mark.parametrize("statement", ["a += 1", "raise a", "f(a)", "a[0] = b", "a.b = c", "del a"])
def test_statements_are_dropped(statement: str):
    assert mutants.mutate(ast.parse(statement).body[0]) == "pass"


@pytest.mark.parametrize(
    "statement", ["'''A docstring.'''", "def f(a: 3) -> 4: pass", "a = f'{1}'", "a = b(c, lw=2)"]
)
def test_annotations_docstrings_and_looks_are_not_changed(statement: str):
    assert not [
        node for node in mutants.walk(ast.parse(statement)) if mutants.mutate(node) is not None
    ]


def test_the_tests_that_name_a_module_run_first():
    tests = mutants.tests_of("theory")
    ordered = mutants.nearest_first(tests, "lmpchain/theory/scattering.py")
    assert ordered[0] == "tests/theory/test_scattering.py"
    assert sorted(ordered) == sorted(tests)
    assert tests[-1] == "lmpchain/theory"


@pytest.mark.slow
def test_mutants_are_tried_by_exchange_and_in_copies():
    """A test that notices a mutant is named, and every mutant is counted once."""
    words = ["lmpchain/util/arrays.py", "--number", "8", "--tests", "tests/util/test_arrays.py"]
    tool = mutants.PROJECT / "tests" / "mutants.py"
    done = subprocess.run(
        [sys.executable, tool, *words], capture_output=True, text=True, check=True
    ).stdout.splitlines()
    noticed = [line for line in done if line.startswith("noticed ")]
    survived = [line for line in done if line.startswith("SURVIVED ")]
    assert len(noticed) + len(survived) == 8
    assert done[-1] == f"{len(noticed)} of 8 noticed"
    assert any(line.startswith("         by tests/util/test_arrays.py::") for line in done)
