"""Edited decks: `check --deck` reads them as `lmp` does, or rejects them in one line."""

import random
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.standalone_lammps import read_dump, small
from helpers.thinned import thinned

from lmpchain import Drive, InputError, Scene, simulate
from lmpchain.engines import Native
from lmpchain.engines.lammps.deck_reader import read_deck
from lmpchain.engines.lammps.export import write_deck

STEP = 1e-7
ROUNDED = 1e-7  # Rounding of heights in LAMMPS, relative to the largest motion.
SCENES: dict[str, tuple[Scene, dict[str, Any]]] = {
    "struck": (small(), {}),
    "gauge": (small(), {"diameter": "gauge"}),
    "composed": (small(), {"integrator": "kahan-li6"}),
    "driven": (small(Drive(amplitude=1e-8, frequency=5e4, cycles=3), grains=8), {}),
    "dimer": (small(material=["glass", "steel"] * 4, grains=8), {}),
}
TIMESTEP, RUN, DUMP = r"\ntimestep .*", r"\nrun  .*", r"\ndump_modify .*"
# Each edit: deck, pattern, text.
EDITS: list[tuple[str, str, str]] = [
    ("struck", TIMESTEP, r"\g<0>\ntimestep 5e-8"),
    ("struck", TIMESTEP, r"\ntimestep 5e-8\g<0>"),
    ("struck", RUN, r"\g<0>\ntimestep 5e-8"),
    ("struck", RUN, r"\g<0>\g<0>"),
    ("struck", RUN, "\nrun 130"),
    ("struck", RUN, "\nrun 60\nrun 140 upto"),
    ("struck", "\nunits", "\nvariable dt index 5e-8\nunits"),
    ("struck", r"\nvariable +dt .*", r"\g<0>\nvariable dt index 5e-8"),
    ("struck", r"\nvariable +every .*", "\nvariable every index 20"),
    ("struck", r"\nvariable +samples .*", r"\g<0>\nvariable samples index 2"),
    ("struck", r"\nvariable +v0 .*", "\nvariable v0 index 1e-3"),
    ("struck", r"\nvariable +v0 .*", r"\nvariable v0 index 1e-3\g<0>"),
    ("struck", "\nunits", "\nvariable v0 index 1e-3\nunits"),
    ("struck", r"group +struck id 1\b", "group struck id 3"),
    ("struck", DUMP, r"\g<0>\ndump_modify out format float %.4g"),
    ("struck", DUMP, r"\ndump_modify out format float %.4g\g<0>"),
    ("struck", RUN, r"\ndump_modify out format float %.9g\g<0>"),
    ("struck", r"\nthermo  .*", "\nthermo 0"),
    ("composed", DUMP, r"\g<0>\ndump_modify out format float %.4g"),
    ("struck", "# time step, s", "\f# time step"),
    ("gauge", TIMESTEP, r"\g<0>\ntimestep 2e-8"),
    ("composed", r"\nvariable +dt .*", "\nvariable dt index 5e-8"),
    ("composed", r"\nvariable +dt .*", r"\g<0>\nvariable dt index 5e-8"),
    ("composed", r"\nvariable +samples .*", "\nvariable samples index 3"),
    ("driven", r"\nvariable +amplitude .*", "\nvariable amplitude index 2e-8"),
    ("driven", r"\nvariable +dt .*", "\nvariable dt index 5e-8"),
]
SPOILT = ["", "$", "&", "nan", "1e308", "-1", "0", "2.5", "x", "${dt}", "# ", "\f", "index", "é"]


def spoil(folder: Path, turn: random.Random) -> None:
    """Change words or lines of the commands or of the data file."""
    path = folder / turn.choice(["in.column", "in.column", "column.data"])
    lines = path.read_text().split("\n")
    for _ in range(turn.choice([1, 1, 2, 4])):
        place = turn.choice([n for n, line in enumerate(lines) if line[:1] not in ("", "#")])
        words = re.split(r"(\s+)", lines[place])
        word = turn.randrange(len(words))
        how = turn.choice(["word", "word", "end", "lose", "line", "double", "number"])
        if how == "word":
            words[word] = turn.choice(SPOILT)
        elif how == "end":
            del words[word:]
        elif how == "lose":
            del words[word]
        elif how == "number":
            words[word] = re.sub(r"\d", str(turn.randrange(10)), words[word], count=1)
        lines[place] = "".join(words)
        if how == "line":
            del lines[place]
        elif how == "double":
            lines.insert(turn.randrange(len(lines)), lines[place])
    path.write_text("\n".join(lines))


def agree(folder: Path) -> None:
    """Check that `lmp` gives the motion that the reader of decks predicts."""
    deck = read_deck(folder)
    given = {*folder.iterdir(), folder / "log.lammps"}
    program = shutil.which("lmp") or str(Path(sys.executable).with_name("lmp"))
    done = subprocess.run([program, "-in", "in.column", "-screen", "none"], cwd=folder, check=False)
    assert done.returncode == 0
    (dump,) = set(folder.iterdir()) - given  # An edit may change its name.
    u, v = read_dump(dump)
    t = simulate(deck.scene, Native(deck.integrator, deck.step))
    assert len(u) == deck.scene.samples
    for field, dumped in (("displacement", u), ("velocity", v)):
        expected = getattr(t, field)
        close = max(ROUNDED, 10.0 ** (1 - deck.digits)) * np.abs(expected).max()
        assert np.abs(dumped[:, : expected.shape[1]] - expected).max() <= close


@pytest.mark.parametrize(("name", "pattern", "text"), thinned(EDITS, 9))
def test_lammps_runs_an_edited_deck_as_it_is_read(
    name: str, pattern: str, text: str, tmp_path: Path
):
    """All of these edits are read, and others refused, in `test_deck_reader.py`."""
    scene, options = SCENES[name]
    write_deck(scene, tmp_path, step=STEP, **options)
    for path in (tmp_path / "in.column", tmp_path / "column.data"):
        path.write_text(re.sub(pattern, text, path.read_text(), count=1))
    agree(tmp_path)


@pytest.mark.parametrize(
    ("count", "is_run"),
    [(20, False), *(pytest.param(2000, run, marks=pytest.mark.soak) for run in (False, True))],
)
@pytest.mark.slow
def test_decks_spoilt_at_random_are_read_right_or_refused(count: int, is_run: bool, tmp_path: Path):
    """In a separate soak test, `lmp` runs every deck that is accepted."""
    turn = random.Random(count)
    for case in range(count):
        scene, options = SCENES[turn.choice(list(SCENES))]
        folder = tmp_path / f"{case}"
        write_deck(scene, folder, step=STEP, **options)
        spoil(folder, turn)
        refusal = ""
        try:
            read_deck(folder)
            if is_run:
                agree(folder)
        except InputError as error:
            refusal = str(error)
        except Exception as error:
            raise AssertionError(f"{folder}: {error}") from error
        assert all(problem.isprintable() for problem in refusal.split("\n"))
        shutil.rmtree(folder)
