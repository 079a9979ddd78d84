"""The modules of the package and their syntax trees, each parsed once."""

import ast
import re
from functools import cache
from pathlib import Path

PACKAGE = Path(__file__).parents[2] / "lmpchain"
REFERENCE = Path(__file__).parents[2] / "docs" / "api.md"


def name_of(path: Path) -> str:
    """Return the dotted name of a module."""
    parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {name_of(path): path for path in sorted(PACKAGE.rglob("*.py"))}


@cache
def text_of(module: str) -> str:
    """Return the source text of a module."""
    return MODULES[module].read_text(encoding="utf-8")


@cache
def nodes_of(module: str) -> list[ast.AST]:
    """Return all nodes of the syntax tree of a module; the first node is the module itself."""
    return list(ast.walk(ast.parse(text_of(module))))


def room_of(module: str) -> str:
    """Return the part of the package to which a module belongs."""
    return module.split(".")[1]


def listed_names() -> list[str]:
    """Return the dotted names that the reference lists."""
    found = []
    package = ""
    for line in REFERENCE.read_text(encoding="utf-8").splitlines():
        if line.startswith(".. currentmodule:: "):
            package = line.split()[-1]
        elif re.fullmatch(r"   [\w.]+", line):
            found.append(f"{package}.{line.strip()}")
    return found
