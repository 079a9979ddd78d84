"""How the code reads: one binding a line, comments, lines that fit, constants that are named once.

The shares are far from what the code had when they were first counted (14.9 % of assignments
packed,
0.6 comments to a hundred lines, 13 % of lines wide), and near what well-kept scientific packages
have.
"""

import ast
import io
import tokenize
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
ROOMS = sorted({file.relative_to(ROOT).parts[1] for file in (ROOT / "lmpchain").rglob("*.py")})
PACKED = 0.03  # share of assignments that bind several values in one line
COMMENTS = 0.02  # comment lines to a line of code, in each room; 0.025 in all
WIDEST = 100  # letters
BRANCHES = 15


def sources(room: str = "") -> list[Path]:
    """Return the modules of the package, or of one of its rooms."""
    place = ROOT / "lmpchain" / room
    return [place] if place.is_file() else sorted(place.rglob("*.py"))


def docstring_lines(tree: ast.Module) -> set[int]:
    """Return the numbers of all lines of docstrings."""
    lines: set[int] = set()
    for node in ast.walk(tree):
        kinds = ast.Module | ast.FunctionDef | ast.ClassDef
        if isinstance(node, kinds) and ast.get_docstring(node) is not None:
            text = node.body[0]
            lines |= set(range(text.lineno, (text.end_lineno or text.lineno) + 1))
    return lines


def count_lines(file: Path) -> tuple[int, int]:
    """Return how many lines of a module are code, and how many are comments of their own."""
    text = file.read_text(encoding="utf-8")
    lines = text.splitlines()
    comments = {
        token.start[0]
        for token in tokenize.generate_tokens(io.StringIO(text).readline)
        if token.type == tokenize.COMMENT and lines[token.start[0] - 1].strip().startswith("#")
    }
    others = docstring_lines(ast.parse(text)) | comments
    code = sum(bool(line.strip()) for n, line in enumerate(lines, 1) if n not in others)
    return code, len(comments)


def nodes(room: str = "") -> Iterator[ast.AST]:
    """Yield every node of the syntax trees of the package."""
    for file in sources(room):
        yield from ast.walk(ast.parse(file.read_text(encoding="utf-8")))


@pytest.mark.parametrize("room", ["", *ROOMS])
def test_comments_stand_where_a_reader_would_stop(room: str):
    counts = [count_lines(file) for file in sources(room)]
    code, comments = (sum(column) for column in zip(*counts, strict=True))
    least = COMMENTS if room else 0.025
    assert code < 400 or comments >= least * code, f"{comments} comments to {code} lines"


def test_a_line_binds_one_value():
    assignments = [node for node in nodes() if isinstance(node, ast.Assign)]
    packed = [
        node
        for node in assignments
        if isinstance(node.targets[0], ast.Tuple) and isinstance(node.value, ast.Tuple)
    ]
    assert len(assignments) > 5000
    assert len(packed) <= PACKED * len(assignments)


@pytest.mark.parametrize("folder", ["lmpchain", "tests", "analysis", "docs"])
def test_lines_fit_beside_each_other(folder: str):
    """Docstrings and comments, too; the formatter sees to the rest."""
    wide = {
        f"{file.relative_to(ROOT)}:{number}"
        for file in (ROOT / folder).rglob("*.py")
        for number, line in enumerate(file.read_text(encoding="utf-8").splitlines(), 1)
        if len(line) > WIDEST
    }
    assert not wide


def branches(function: ast.FunctionDef) -> int:
    """Return in how many places a function goes one way or another, or again, and one more."""
    forks = ast.If, ast.For, ast.While, ast.IfExp, ast.ExceptHandler, ast.Assert, ast.comprehension
    count = 1
    for node in ast.walk(function):
        count += isinstance(node, forks)
        count += len(node.ifs) if isinstance(node, ast.comprehension) else 0
        count += len(node.values) - 1 if isinstance(node, ast.BoolOp) else 0
    return count


def test_functions_do_one_thing():
    functions = [node for node in nodes() if isinstance(node, ast.FunctionDef)]
    assert len(functions) > 2000
    assert len([node.name for node in functions if branches(node) > BRANCHES]) <= 4


def test_a_constant_means_one_thing():
    names = Counter[str]()
    for file in sources():
        tree = ast.parse(file.read_text(encoding="utf-8"))
        targets = [
            target
            for node in tree.body
            if isinstance(node, ast.Assign | ast.AnnAssign)
            for target in (node.targets if isinstance(node, ast.Assign) else [node.target])
        ]
        names.update({t.id for t in targets if isinstance(t, ast.Name) and t.id.isupper()})
    assert sum(count > 2 for count in names.values()) <= 8
