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
    with pytest.raises(ValueError, match="argument"):
        tables.align([("a", "b"), ("c",)])
    # Every word is present, unbroken and in the order of its cell.
    words = " ".join(lines).split()
    for row in ROWS:
        for cell in row:
            assert set(cell.split()) <= set(words)


def test_cells_are_wrapped_within_their_columns():
    """Lines are as long as possible, and a column that is not wrapped keeps its width."""
    long = "a word of text " * 20
    lines = tables.align([("name", "text", "end"), ("one", long, "#"), ("two", "short", "%")])
    assert [line[:4].strip() for line in lines] == ["name", "one", *[""] * (len(lines) - 3), "two"]
    assert lines[1].index("#") == lines[-1].index("%") == 77
    column = [line[6:75] for line in lines[1:-1]]
    assert " ".join(map(str.strip, column)) == long.strip()
    assert min(len(part.rstrip()) for part in column[:-1]) > 69 - len("word ")
    assert tables.align([]) == []


def test_words_for_numbers_and_durations():
    """Numbers and their units, or words in place of both."""
    assert [tables.duration(x) for x in (1.0, 0.9996, 0.9994, 1e-3, 9.996e-4, 9.994e-4)] == [
        "1 s", "1 s", "999 ms", "1 ms", "1 ms", "999 us",
    ]  # fmt: skip
    assert [tables.duration(float(x), "?") for x in ("nan", "inf")] == ["?", "?"]
    assert [tables.number(float(x), ".1f", "m") for x in ("nan", "-inf", "2.04")] == [
        "", "inf", "2.0 m",
    ]  # fmt: skip
    assert tables.number(float("nan"), missing="-") == "-"
    assert [tables.counted(n, "step") for n in (0, 1, 2)] == ["0 steps", "1 step", "2 steps"]
    row = {"a": float("nan"), "b": float("inf"), "c": 1.5, "d": "nan", "e": 3}
    assert tables.finite(row) == {"a": None, "b": None, "c": 1.5, "d": "nan", "e": 3}


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
    # Another column is wrapped beside a path that is wider than all other cells, if it then fits.
    short = path[:53]
    lines = tables.align([(short, "words " * 9), ("b", "word " * 9)])
    words = [("words", 4), ("words", 4), ("words", 1), ("word", 5), ("word", 4)]
    assert [line[55:].split() for line in lines] == [[word] * count for word, count in words]
    assert [line[:55].strip() for line in lines] == [short, "", "", "b", ""]
    assert tables.align([(path, "two words")]) == [f"{path}  two words"]


def test_markup_letters_are_printed_unchanged():
    rows = [("[bold]a[/]", "x" * 90), ("b", "y")]
    assert "[bold]a[/]" in "\n".join(tables.align(rows))
