"""Readers on damaged files: each returns a value, or raises an error with a message."""

import hashlib
import io
import json
import random
import resource
import shutil
from collections.abc import Callable
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.instrument_files import ARRAYS, FILES, push
from helpers.standalone_lammps import lmp
from helpers.thinned import fuzzed

from lmpchain import Force, InputError, LmpchainError, Scene, Stopped, Trajectory, resume, simulate
from lmpchain.engines.lammps.export import write_deck
from lmpchain.engines.stepping import time_stepping as stepping_run
from lmpchain.simulation import folder_files
from lmpchain.simulation.run_folder import status
from lmpchain.sweeps.file import read_sweep
from lmpchain.util.files import seal

MEMORY = 500_000  # Additional memory in kB.
HOSTILE = [
    None,
    True,
    -1,
    0,
    1,
    3.5,
    2**31,
    -(2**64),
    1e308,
    5e-324,
    float("nan"),
    float("inf"),
    "",
    "x" * 300,
    "NaN",
]
HOSTILE += [
    [],
    {},
    [[]],
    [1, "a"],
    {"name": "pickle"},
    {"id": "pickle"},
    "float64",
    "object",
    "../..",
    "/dev/zero",
    "\0",
]
SCENE: dict[str, Any] = {
    "chain": {
        "grains": 6,
        "material": {"density": 2426.0, "youngs_modulus": 62e9, "poissons_ratio": 0.2},
        "diameter": 1e-3,
        "top_load": 1e-3,
        "bottom": "wall",
        "impurity": [{"grain": 3, "mass": 1e-6}],
    },
    "excitation": {"kind": "impulse", "velocity": 1e-5},
    "recording": {"duration": 2e-5, "samples": 41, "grains": "1:6"},
}
SWEEP: dict[str, Any] = {
    "scene": SCENE,
    "engine": "native",
    "keep": ["velocity"],
    "grid": {"chain.gravity": [1.0, 2.0]},
    "random": {
        "draws": 2,
        "seed": 1,
        "chain": {"top_load": {"low": 1.0, "high": 2.0, "log": True}},
    },
}


@pytest.fixture(scope="module")
def originals(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with results in a file, run folders (one stopped), and a dump."""
    folder = tmp_path_factory.mktemp("originals")
    scene = Scene.from_dict(SCENE)
    simulate(scene, "native", folder=folder / "run").save(folder / "run.nc")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(stepping_run, "BLOCK_S", 1e-9)  # Four samples per block.
        with pytest.raises(Stopped):
            simulate(scene, "native", folder=folder / "stopped", max_wall=1e-9)
    write_deck(scene, folder / "deck", step=1e-7)
    lmp(folder / "deck")
    return folder


def spoilt(tree: Any, turn: random.Random) -> Any:
    """Return tables and lists with one to three values replaced, lost or doubled at any depth."""
    tree = deepcopy(tree)
    for _ in range(turn.choice([1, 1, 1, 2, 3])):
        holder = [tree]
        key = 0
        while isinstance(holder[key], dict | list) and holder[key] and turn.random() < 0.8:
            holder = holder[key]
            key = turn.choice(list(holder) if isinstance(holder, dict) else range(len(holder)))
        how = turn.choice(["value", "value", "value", "lost", "more"])
        if how == "lost" and holder[key] is not tree:
            del holder[key]
        elif how == "more" and isinstance(holder[key], dict):
            holder[key][turn.choice(["", "a.b", "file", "name", "x" * 300])] = turn.choice(HOSTILE)
        elif how == "more" and isinstance(holder[key], list):
            holder[key].append(turn.choice(HOSTILE))
        elif holder[key] is not tree:
            holder[key] = deepcopy(turn.choice(HOSTILE))
    return tree


def damaged(content: bytes, turn: random.Random) -> bytes:
    """Return the content of a file with some bytes changed, lost, doubled or inserted."""
    found = bytearray(content)
    for _ in range(turn.choice([1, 1, 2, 10])):
        place = turn.randrange(len(found) or 1)
        length = turn.choice([1, 4, 30, 300])
        how = turn.choice(["flip", "drop", "double", "insert", "cut", "swap"])
        if how == "flip" and found:
            found[place] ^= 1 << turn.randrange(8)
        elif how == "drop":
            del found[place : place + length]
        elif how == "double":
            found[place:place] = found[place : place + length]
        elif how == "insert":
            found[place:place] = turn.choice(
                [b"\0", b"nan", b"1e999", b"\n", b"ITEM: TIMESTEP\n", b"-", b"9" * 400, b" "]
            )
        elif how == "swap":
            found[place : place + length] = found[place : place + length][::-1]
        elif turn.random() < 0.2:
            del found[place:]
    return bytes(found)


def examine(case: Callable[[random.Random], object], count: int) -> None:
    """Try this number of cases; each returns a value or short error lines within a memory limit."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    refused = 0
    longest = 0
    for seed in range(count):
        try:
            case(random.Random(seed))
        except LmpchainError as error:
            refused += 1
            longest = max(longest, *map(len, str(error).splitlines()))
        except Exception as error:
            raise AssertionError(f"case {seed}") from error
        grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
        assert grown < MEMORY, f"case {seed}: {grown} kB"
    assert longest < 1000
    print(f"{count} cases, {refused} refused")
    assert refused > count / 4


@fuzzed(300, 50_000)
def test_scenes(count: int):
    examine(lambda turn: Scene.from_dict(spoilt(SCENE, turn), None).to_text(), count)


@fuzzed(50, 10_000)
def test_sweeps(count: int):
    examine(lambda turn: list(read_sweep(spoilt(SWEEP, turn)).trials()), count)


@fuzzed(30, 10_000)
def test_metadata_of_run_folders(originals: Path, tmp_path: Path, count: int):
    run = Path(shutil.copytree(originals / "run", tmp_path / "run"))
    files = sorted(run.rglob("zarr.json"))
    whole = {path: path.read_bytes() for path in files}

    def case(turn: random.Random) -> None:
        path = turn.choice(files)
        path.write_text(json.dumps(spoilt(json.loads(whole[path]), turn)))
        try:
            t = Trajectory.load(run)
            assert np.isfinite(t.velocity[:]).all()
        finally:
            path.write_bytes(whole[path])

    examine(case, count)


@fuzzed(30, 5000)
def test_status_files(originals: Path, tmp_path: Path, count: int):
    run = Path(shutil.copytree(originals / "run", tmp_path / "run"))
    whole = json.loads((run / "status.json").read_text())

    def case(turn: random.Random) -> None:
        (run / "status.json").write_text(json.dumps(spoilt(whole, turn)))
        status(run)
        if not turn.randrange(4):
            raise InputError([("status", "is fine without what was changed")])

    examine(case, count)


@pytest.mark.filterwarnings("ignore")
@fuzzed(10, 2000)
def test_checkpoints_and_tasks_with_the_right_hash(originals: Path, tmp_path: Path, count: int):
    def case(turn: random.Random) -> None:
        shutil.rmtree(tmp_path / "run", ignore_errors=True)
        run = Path(shutil.copytree(originals / "stopped", tmp_path / "run"))
        if turn.random() < 0.3:
            asked = spoilt(json.loads((run / "run.json").read_text()), turn)
            if isinstance(asked, dict):
                asked["sha256"] = folder_files.order_hash(asked, (run / "scene.toml").read_text())
            (run / "run.json").write_text(json.dumps(asked))
        else:
            with np.load(io.BytesIO((run / "checkpoint").read_bytes()[32:])) as kept:
                arrays = dict(kept)
            if turn.random() < 0.5:
                notes = json.loads(str(arrays["notes"]))
                notes["attempt"]["proposal"].pop("choices")
                arrays["notes"] = np.array(json.dumps(spoilt(notes, turn)))
            else:
                name = turn.choice([name for name in arrays if name != "notes"])
                arrays[name] = turn.choice(
                    [
                        np.atleast_1d(arrays[name])[..., :1],
                        arrays[name].astype("f4"),
                        np.zeros(0),
                        np.array("a"),
                    ]
                )
            packed = io.BytesIO()
            np.savez(packed, **arrays)
            (run / "checkpoint").write_bytes(
                hashlib.sha256(packed.getvalue()).digest() + packed.getvalue()
            )
            (run / "checkpoint-before").unlink(missing_ok=True)
        resume(run)

    examine(case, count)


@fuzzed(50, 15_000)
def test_dumps(originals: Path, tmp_path: Path, count: int):
    content = (originals / "deck" / "column.lammpstrj").read_bytes()
    scene = Scene.from_dict(SCENE)

    def case(turn: random.Random) -> None:
        (tmp_path / "dump").write_bytes(damaged(content, turn))
        Trajectory.from_dump(tmp_path / "dump", scene)

    examine(case, count)


@fuzzed(30, 5000)
def test_netcdf_files(originals: Path, tmp_path: Path, count: int):
    content = (originals / "run.nc").read_bytes()
    sealed = content[: -len(seal(b""))]

    def case(turn: random.Random) -> None:
        changed = damaged(sealed, turn)
        # A valid seal on a damaged file would pass the check, and HDF5 might hang.
        (tmp_path / "run.nc").write_bytes(changed + turn.choice([b"", seal(sealed)]))
        Trajectory.load(tmp_path / "run.nc")

    examine(case, count)


def force_of(path: Path, options: dict[str, Any], may_refuse: bool = True) -> Force:
    """Return the force in a file; fail if an error has several lines or is not allowed."""
    try:
        return Force(grain=1, file=path, trigger=0.0, **options)
    except InputError as error:
        if "\n" in str(error) or not may_refuse:
            raise AssertionError(f"{path.read_text(errors='replace')[:500]}") from error
        raise


def edited(text: str, how: str, turn: random.Random) -> str:
    """Return the text of a trace after edits as by a spreadsheet or by hand."""
    lines = text.splitlines()
    place = turn.randrange(len(lines) - 60, len(lines) - 1)
    comma = "\t" if "\t" in text else ","
    if how == "empty cells below":
        lines += [comma * turn.randrange(1, 4)] * turn.randrange(1, 4)
    elif how == "blanks below":
        lines += [" " * turn.randrange(3)] * 3
    elif how == "shorter":
        del lines[-turn.randrange(1, 9) :]
    elif how == "empty cells":
        lines[place] = comma * lines[place].count(comma)
    elif how == "a word":
        cells = lines[place].split(comma)
        cells[turn.randrange(len(cells))] = turn.choice(["nan", "---", "1e999", "0x1", "5e"])
        lines[place] = comma.join(cells)
    elif how == "a line less":
        lines[place] = ""
    return "\n".join(lines) + "\n"


HARMLESS = ["empty cells below", "blanks below", "shorter"]


@fuzzed(120, 2000)
def test_edited_traces(tmp_path: Path, count: int):
    """Harmless edits change nothing; others are rejected, or leave the push unchanged."""

    def case(turn: random.Random) -> None:
        text, options = FILES[turn.choice(list(FILES))]
        how = turn.choice([*HARMLESS, *["empty cells", "a word", "a line less"] * 3])
        path = tmp_path / "scope.csv"
        path.write_text(edited(text, how, turn))
        force = force_of(path, options, how not in HARMLESS)
        np.testing.assert_allclose(force.force, push(force.times), rtol=0, atol=1e-6)

    examine(case, count)


@fuzzed(150, 2000)
def test_damaged_traces(tmp_path: Path, count: int):
    """Damaged files of all kinds give finite numbers at increasing times, or one line."""
    originals: list[tuple[Path, bytes, dict[str, Any]]] = []
    for name, (write, options) in ARRAYS.items():
        path = tmp_path / name.split(",")[0]
        write(path)
        originals.append((path, path.read_bytes(), options))
    texts = [(tmp_path / "scope.csv", text.encode(), options) for text, options in FILES.values()]

    def case(turn: random.Random) -> None:
        path, content, options = turn.choice(turn.choice([texts, originals]))
        path.write_bytes(damaged(content, turn))
        force = force_of(path, options)
        assert np.isfinite(force.force).all()
        assert (np.diff(force.times) > 0).all()

    examine(case, count)
