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
# Each edit: deck, pattern, text, and whether the edited deck is accepted.
EDITS: list[tuple[str, str, str, bool]] = [
    ("struck", TIMESTEP, r"\g<0>\ntimestep 5e-8", True),
    ("struck", TIMESTEP, r"\ntimestep 5e-8\g<0>", True),
    ("struck", RUN, r"\g<0>\ntimestep 5e-8", True),
    ("struck", RUN, r"\g<0>\ntimestep 5e-8\nrun 40", False),
    ("struck", RUN, r"\g<0>\g<0>", True),
    ("struck", RUN, "\nrun 130", True),
    ("struck", RUN, "\nrun 60\nrun 140 upto", True),
    ("struck", RUN, "\nrun 60\nrun 40 upto", False),
    ("struck", RUN, "\nrun 1e2", False),
    ("struck", RUN, "\nrun 100 every 10 NULL", False),
    ("struck", RUN, "\nrun 80\nvelocity all set 0 0 1", False),
    ("struck", r"\nthermo  .*", r"\nrun 40\g<0>", False),
    ("struck", r"\ndump  .*", r"\nrun 40\g<0>", False),
    ("struck", "\nunits", "\nvariable dt index 5e-8\nunits", True),
    ("struck", r"\nvariable +dt .*", r"\g<0>\nvariable dt index 5e-8", True),
    ("struck", r"\nvariable +dt .*", "\nvariable dt index 5e-8 1e-8", False),
    ("struck", r"\nvariable +dt .*", "\nvariable dt index 1_0e-8", False),
    ("struck", r"\nvariable +dt .*", "\nvariable dt equal 5e-8", False),
    ("struck", r"\nvariable +every .*", "\nvariable every index 20", True),
    ("struck", r"\nvariable +samples .*", r"\g<0>\nvariable samples index 2", True),
    ("struck", r"\nvariable +v0 .*", "\nvariable v0 index 1e-3", True),
    ("struck", r"\nvariable +v0 .*", r"\nvariable v0 index 1e-3\g<0>", True),
    ("struck", "\nunits", "\nvariable v0 index 1e-3\nunits", True),
    ("struck", r"group +struck id 1\b", "group struck id 3", True),
    ("struck", DUMP, r"\g<0>\ndump_modify out format float %.4g", True),
    ("struck", DUMP, r"\ndump_modify out format float %.4g\g<0>", True),
    ("struck", RUN, r"\ndump_modify out format float %.9g\g<0>", True),
    ("struck", r"\nthermo  .*", "\nthermo 0", True),
    ("struck", r"hertz \S+", "hertz 2e10", False),
    ("struck", "# time step, s", "# time step &", False),
    ("struck", "# time step, s", "\f# time step", True),
    ("gauge", TIMESTEP, r"\g<0>\ntimestep 2e-8", True),
    ("composed", r"\nvariable +dt .*", "\nvariable dt index 5e-8", True),
    ("composed", r"\nvariable +dt .*", r"\g<0>\nvariable dt index 5e-8", True),
    ("composed", r"\nvariable +samples .*", "\nvariable samples index 3", True),
    ("composed", r"\nrun  +0 .*", r"\g<0>\nrun 5", False),
    ("driven", r"\nvariable +amplitude .*", "\nvariable amplitude index 2e-8", True),
    ("driven", r"\nvariable +dt .*", "\nvariable dt index 5e-8", True),
    ("driven", TIMESTEP, r"\g<0>\ntimestep 5e-8", False),
    # Edits of the data file.
    ("struck", r"\n3 0 0 -0.0 ", "\n3 0 0 1e-4 ", False),
    ("struck", r"\n3 0 0 -0.0 ", "\n3 1e-4 0 0 ", False),
    ("struck", r"\n3 0 0 -0.0 0 0 0", "\n3 0 0 0 0 9 0", False),
    ("struck", r"(\n3 1 \S+ \S+) 0 0", r"\1 1e-5 0", False),
    ("struck", r"\n3 1 ", "\n3 2 ", False),
    ("struck", "1 atom types", "2 atom types", False),
    ("struck", "25 atoms", "24 atoms", False),
    ("dimer", r"\n3 1 ", "\n3 2 ", False),
    ("struck", r"(\n[34] 1 \S+) 2426.0 ", r"\1 5000.0 ", False),
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


@pytest.mark.parametrize(("name", "pattern", "text", "is_read"), thinned(EDITS, 5))
def test_an_edited_deck_is_read_like_lammps_or_rejected(
    name: str, pattern: str, text: str, is_read: bool, tmp_path: Path
):
    scene, options = SCENES[name]
    write_deck(scene, tmp_path, step=STEP, **options)
    for path in (tmp_path / "in.column", tmp_path / "column.data"):
        path.write_text(re.sub(pattern, text, path.read_text(), count=1))
    if is_read:
        agree(tmp_path)
        return
    with pytest.raises(InputError) as refused:
        read_deck(tmp_path)
    assert str(refused.value).isprintable()


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
