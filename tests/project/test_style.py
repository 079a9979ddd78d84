"""Style of the code: one binding per line, comments, line widths, unique constants.

The limits are far from the first counts of this code (14.9 % of assignments packed, 0.6 comments
to a hundred lines, 13 % of lines wide), and near the counts of well-kept scientific packages.
"""

import ast
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

import pytest
from helpers.modules import MODULES, nodes_of, room_of, text_of

ROOT = Path(__file__).parents[2]
PACKED = 0.03  # Largest fraction of assignments that bind several values in one line.
COMMENTS = 0.02  # Smallest ratio of comment lines to lines of code in each room.
ALL_COMMENTS = 0.025  # The same ratio for the whole package.
FEW_LINES = 400  # Lines of code; a smaller room may have fewer comments.
WIDEST = 100  # Characters.
BRANCHES = 15


def lines_of(nodes: Iterable[ast.AST]) -> set[int]:
    """Return the numbers of the lines that nodes of a syntax tree cover."""
    return {n for node in nodes for n in range(node.lineno, (node.end_lineno or node.lineno) + 1)}


def count_lines(module: str) -> tuple[int, int]:
    """Return the number of lines of code, and of lines that are comments only."""
    kinds = ast.Module | ast.FunctionDef | ast.ClassDef
    docstrings = lines_of(
        node.body[0]
        for node in nodes_of(module)
        if isinstance(node, kinds) and ast.get_docstring(node, clean=False) is not None
    )
    strings = lines_of(
        node
        for node in nodes_of(module)
        if isinstance(node, ast.Constant | ast.JoinedStr) and node.end_lineno != node.lineno
    )
    lines = list(enumerate(map(str.strip, text_of(module).splitlines()), 1))
    comments = {n for n, line in lines if line.startswith("#")} - strings - docstrings
    code = sum(bool(line) for n, line in lines if n not in docstrings | comments)
    return code, len(comments)


def test_every_room_has_comments():
    code = Counter[str]()
    comments = Counter[str]()
    for module in MODULES.keys() - {"lmpchain"}:
        lines, remarks = count_lines(module)
        code[room_of(module)] += lines
        comments[room_of(module)] += remarks
    few = {
        room: f"{comments[room]} comments to {lines} lines"
        for room, lines in code.items()
        if lines >= FEW_LINES and comments[room] < COMMENTS * lines
    }
    assert not few
    assert comments.total() >= ALL_COMMENTS * code.total()


def test_a_line_binds_one_value():
    assignments = [
        node for module in MODULES for node in nodes_of(module) if isinstance(node, ast.Assign)
    ]
    packed = [
        node
        for node in assignments
        if isinstance(node.targets[0], ast.Tuple) and isinstance(node.value, ast.Tuple)
    ]
    assert len(assignments) > 5000
    assert len(packed) <= PACKED * len(assignments)


@pytest.mark.parametrize("folder", ["lmpchain", "tests", "analysis", "docs"])
def test_no_line_is_too_wide(folder: str):
    """The formatter breaks only code, not docstrings and comments."""
    wide = {
        f"{file.relative_to(ROOT)}:{number}"
        for file in (ROOT / folder).rglob("*.py")
        for number, line in enumerate(file.read_text(encoding="utf-8").splitlines(), 1)
        if len(line) > WIDEST
    }
    assert not wide


def branches(function: ast.FunctionDef) -> int:
    """Return the number of branches and loops of a function, plus one."""
    forks = ast.If, ast.For, ast.While, ast.IfExp, ast.ExceptHandler, ast.Assert, ast.comprehension
    count = 1
    for node in ast.walk(function):
        count += isinstance(node, forks)
        count += len(node.ifs) if isinstance(node, ast.comprehension) else 0
        count += len(node.values) - 1 if isinstance(node, ast.BoolOp) else 0
    return count


def test_few_functions_have_many_branches():
    functions = [
        node for module in MODULES for node in nodes_of(module) if isinstance(node, ast.FunctionDef)
    ]
    assert len(functions) > 2000
    assert len([node.name for node in functions if branches(node) > BRANCHES]) <= 4


def test_few_constants_share_a_name():
    names = Counter[str]()
    for module in MODULES:
        tree = nodes_of(module)[0]
        assert isinstance(tree, ast.Module)
        targets = [
            target
            for node in tree.body
            if isinstance(node, ast.Assign | ast.AnnAssign)
            for target in (node.targets if isinstance(node, ast.Assign) else [node.target])
        ]
        names.update({t.id for t in targets if isinstance(t, ast.Name) and t.id.isupper()})
    assert sum(count > 2 for count in names.values()) <= 8
