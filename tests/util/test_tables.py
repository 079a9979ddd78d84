"""Tables on terminals of any width."""

import pytest

from lmpchain.util import tables

ROWS = (
    ("what", "method", "step"),
    ("the longest step that a run of this scene may take", "native, adaptive steps", "3.1e-06 s"),
    ("the smallest error in double precision", "LAMMPS, physical diameter", "4.2e-12"),
)


def test_wide_cells_are_wrapped():
    lines = tables.align(ROWS)
    assert max(map(len, lines)) <= 80
    assert sum("3.1e-06 s" in line for line in lines) == 1
    # Every word is present, unbroken and in the order of its cell.
    words = " ".join(lines).split()
    for row in ROWS:
        for cell in row:
            assert set(cell.split()) <= set(words)


def test_a_wide_terminal_shows_a_row_in_a_line(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("COLUMNS", "120")
    # Without a terminal, lines are as wide as on the narrowest one.
    assert tables.line_width() == 80
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    assert tables.line_width() == 120
    assert len(tables.align(ROWS)) == len(ROWS)
    monkeypatch.setenv("COLUMNS", "40")
    assert tables.line_width() == 80


def test_a_path_is_not_broken():
    path = "/scratch" + "/a_folder" * 12
    lines = tables.align([("file", f"written: {path}"), ("scene", "a chain of " + "grains " * 20)])
    assert any(path in line for line in lines)


def test_markup_letters_are_printed_unchanged():
    rows = [("[bold]a[/]", "x" * 90), ("b", "y")]
    assert "[bold]a[/]" in "\n".join(tables.align(rows))
