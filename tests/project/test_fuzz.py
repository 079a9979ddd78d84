"""Damaged files of all kinds: each leads to a message, and no partial output remains."""

import os
import random
import re
import secrets
import shutil
import tempfile
from collections.abc import Callable, Iterable
from contextlib import redirect_stderr, redirect_stdout, suppress
from copy import deepcopy
from io import StringIO
from pathlib import Path
from typing import Any

import hypothesis
import pytest
import tomli_w
from helpers.child_processes import same
from helpers.thinned import fuzzed
from hypothesis import strategies as st

from lmpchain import LmpchainError, Scene, Stopped, Trajectory, engines, resume, simulate
from lmpchain.cli.command_line import main
from lmpchain.engines.stepping import time_stepping as stepping_run

Tables = dict[str, Any]
MARK = "INJECTED"  # Text that no deck may contain.
SCENE: Tables = {
    "chain": {
        "grains": 6,
        "material": {
            "density": 2426.0,
            "youngs_modulus": 62e9,
            "poissons_ratio": 0.2,
            "name": "mine",
            "source": "",
        },
        "diameter": 1e-3,
        "gravity": 9.81,
        "top_load": 1e-3,
        "exponent": 1.5,
        "top": "free",
        "bottom": "wall",
        "bottom_material": "steel",
        "impurity": [{"grain": 3, "mass": 1e-6, "material": "ptfe"}],
    },
    "excitation": {"kind": "impulse", "grain": 1, "velocity": 1e-5},
    "recording": {"duration": 5e-6, "samples": 4, "grains": "1:6"},
}
EXCITATIONS: list[Tables] = [
    SCENE["excitation"],
    {"kind": "displacement", "grain": 2, "displacement": 1e-10},
    {"kind": "drive", "amplitude": 1e-10, "frequency": 1e4},
    {"kind": "drive", "times": [0.0, 1e-5], "displacement": [0.0, 1e-10]},
    {"kind": "profile", "velocity": [1e-5, 0.0, 0.0, 0.0, 0.0, 0.0]},
]
TABLES: Tables = {  # The tables are written as CSV files where a key names one.
    "grains.csv": "diameter,material,mass\n" + "1e-3,glass,1e-6\n" * 6,
    "drive.csv": "time,displacement\n0,0\n1e-5,1e-10\n",
    "profile.csv": "grain,velocity\n" + "".join(f"{n},{1e-5 * (n == 1)}\n" for n in range(1, 7)),
}
SWEEPS: list[Tables] = [
    {"grid": {"chain.gravity": [1.62, 9.81], "chain": {"material": ["glass", "steel"]}}},
    {"list": {"excitation": {"velocity": [1e-5, 2e-5]}, "chain": {"top_load": [0.0, 1e-3]}}},
    {
        "random": {
            "draws": 2,
            "seed": 1,
            "chain": {"gravity": {"low": 1.0, "high": 10.0, "log": True}},
        }
    },
    {"disorder": {"m": 20.0, "seed": 1, "realisations": 2, "law": "dyson", "of": "constant"}},
]

# Values of keys, except sizes that would only cost time.
COMMANDS = [
    f"{MARK}",
    f"glass\nshell touch {MARK}",
    f'glass"\nprint "{MARK}',
    f"$({MARK})",
    f"${{{MARK}}}",
    f"`{MARK}`; touch {MARK}",
    f"{{{{ {MARK} }}}}",
    f"{{% include '{MARK}' %}}",
    f"<script>{MARK}</script>",
    f"../{MARK}\x1b[2J\x00\u2028\r",
]
NAMES = [
    "",
    ".",
    "..",
    "~",
    "/",
    "/dev/zero",
    "/dev/stdin",
    "/proc/self/mem",
    "a\x00b",
    "x" * 5000,
    "\U0001f300",
]
NUMBERS = [
    float("nan"),
    float("inf"),
    float("-inf"),
    1e300,
    -1e300,
    1e-300,
    5e-324,
    1.7976931348623157e308,
    -0.0,
    0.0,
]
WHOLES = [0, 1, -1, 2, 7, 2**31, 2**63, -(2**64), 10**400, 10**8 + 1]
NESTED: Any = []
for _ in range(60):
    NESTED = [NESTED]
HOSTILE = st.one_of(
    st.sampled_from(NUMBERS),
    st.sampled_from(WHOLES),
    st.sampled_from(COMMANDS),
    st.sampled_from(NAMES),
    st.booleans(),
    st.text(max_size=8),
    st.sampled_from(
        [
            [],
            {},
            [[]],
            [1, "a"],
            ["glass"] * 6,
            {"low": 1.0},
            {"name": MARK},
            NESTED,
            [0.0] * 6,
            [3, 3],
        ]
    ),
    st.lists(st.sampled_from([*NUMBERS, *WHOLES, *COMMANDS]), max_size=6),
)


def places(table: Any, path: tuple = ()) -> Iterable[tuple]:
    """Return the paths to all items of nested tables and lists."""
    items = (
        table.items()
        if isinstance(table, dict)
        else enumerate(table)
        if isinstance(table, list)
        else ()
    )
    for key, value in items:
        yield (*path, key)
        yield from places(value, (*path, key))


@st.composite
def spoilt(draw: st.DrawFn, whole: st.SearchStrategy[Tables]) -> Tables:
    """Draw tables in which up to three values are hostile, unknown or missing."""
    tables = deepcopy(draw(whole))
    for _ in range(draw(st.integers(0, 3))):
        ways = sorted(places(tables), key=str)
        if not ways:
            break
        *way, key = draw(st.sampled_from(ways))
        holder: Any = tables
        for step in way:
            holder = holder[step]
        change = draw(st.sampled_from(["value", "value", "value", "unknown", "missing"]))
        if change == "unknown" and isinstance(holder, dict):
            holder[draw(st.sampled_from([*COMMANDS, *NAMES]))] = deepcopy(draw(HOSTILE))
        elif change == "missing":
            del holder[key]
        else:
            holder[key] = deepcopy(draw(HOSTILE))
    return tables


@st.composite
def scenes(draw: st.DrawFn) -> Tables:
    tables = deepcopy(SCENE)
    tables["excitation"] = dict(draw(st.sampled_from(EXCITATIONS)))
    if draw(st.booleans()):
        del tables["chain"]["impurity"]
    file = draw(st.sampled_from([None, None, *TABLES, *NAMES[1:8]]))
    if file == "grains.csv" or (file in NAMES and draw(st.booleans())):
        tables["chain"] = {"file": file}
    elif file:
        kind = "profile" if file.startswith("p") else "drive"
        tables["excitation"] = {"kind": kind, "file": file}
    return tables


@st.composite
def sweeps(draw: st.DrawFn) -> Tables:
    tables = {
        "scene": deepcopy(SCENE),
        "engine": "native",
        "tolerance": 1e-3,
        "keep": ["wall_force", "velocity"],
    }
    for part in draw(st.lists(st.sampled_from(SWEEPS), min_size=1, max_size=2)):
        tables |= deepcopy(part)
    return tables


@st.composite
def damage(draw: st.DrawFn) -> Callable[[bytes], bytes]:
    """Draw a function that damages a file: bytes change, lines are lost, or the end is cut."""
    turn = random.Random(draw(st.integers(0, 2**32)))
    how = draw(
        st.sampled_from(["flip", "flip", "flip", "insert", "drop", "double", "cut", "zeros"])
    )
    count = draw(st.sampled_from([1, 1, 2, 20]))

    def spoil(content: bytes) -> bytes:
        found = bytearray(content)
        for _ in range(count):
            place = turn.randrange(len(found) or 1)
            line = found.find(b"\n", place) + 1
            end = found.find(b"\n", line) + 1 or len(found)
            if how == "flip" and found:
                found[place] ^= 1 << turn.randrange(8)
            elif how == "insert":
                found[place:place] = turn.choice(
                    [b"\0", b"\xff\xfe", b"\x1b[2J", b"e300", b"nan", b'"', b"[", b"}"]
                )
            elif how == "drop":
                del found[line:end]
            elif how == "double":
                found[line:line] = found[line:end]
            elif how == "zeros":
                found[place : place + 64] = bytes(len(found[place : place + 64]))
            else:
                del found[place:]
        return bytes(found)

    return spoil


def examine(check: Callable[[Any], None], cases: st.SearchStrategy, count: int) -> None:
    """Check this number of cases: fixed ones in the quick suite, random ones in a soak."""
    quick = count < 100
    seed = 0 if quick else secrets.randbits(64)
    print(f"{check.__name__}: {count} cases, seed {seed}")
    health = list(hypothesis.HealthCheck)
    options = hypothesis.settings(
        max_examples=count,
        deadline=None,
        database=None,
        derandomize=quick,
        suppress_health_check=health,
        phases=[hypothesis.Phase.generate, hypothesis.Phase.shrink],
    )
    run = options(hypothesis.given(cases)(check))
    (run if quick else hypothesis.seed(seed)(run))()


def call(*words: object) -> tuple[int, str]:
    """Run a command; check that errors are explained, and return its exit code and output."""
    out = StringIO()
    err = StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        code = main([str(word) for word in words])
    said = err.getvalue().split("\n")[:-1]
    assert code in (0, 1, 2), (code, said)
    assert all(line.isprintable() for line in said), said
    # The first call on a machine compiles, with a message.
    errors = [line for line in said if not line.startswith(("warning: ", "note: ", "compiling "))]
    form = {0: None, 1: r"error: \S.*", 2: r"error: \S.*: \S.*"}[code]
    assert all(form and re.fullmatch(form, line) for line in errors), said
    assert code == 0 or errors, said
    return code, out.getvalue()


def files(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*")}


class Workplace(tempfile.TemporaryDirectory):
    """A folder with CSV files and a scene or sweep, for the duration of a case."""

    def __init__(self, **texts: bytes | str):
        super().__init__()
        folder = Path(self.name)
        for name, text in {
            **TABLES,
            **{name.replace("__", "."): text for name, text in texts.items()},
        }.items():
            (folder / name).write_bytes(text.encode() if isinstance(text, str) else text)

    def __enter__(self) -> Path:
        return Path(super().__enter__())


def nothing_injected(folder: Path) -> None:
    """Check that no text of a scene is in a deck, and that no command of a scene was executed."""
    for path in folder.glob("deck/*"):
        assert MARK not in path.read_text()
    assert not (folder / MARK).exists()
    assert not Path(MARK).exists()


def toml(tables: Tables) -> bytes:
    return tomli_w.dumps(tables).encode("utf-8", "surrogatepass")


# --- scenes


def deck(scene: bytes) -> None:
    with Workplace(scene__toml=scene) as folder:
        before = files(folder)
        code, _ = call("deck", folder / "scene.toml", "-o", folder / "deck", "--step", "1e-7")
        wanted = {"deck", "deck/in.column", "deck/column.data"} if code == 0 else set()
        assert files(folder) - before == wanted
        nothing_injected(folder)


def run_file(scene: bytes, *options: str) -> None:
    with Workplace(scene__toml=scene) as folder:
        before = files(folder)
        code, _ = call("run", folder / "scene.toml", *options)
        new = files(folder) - before
        assert new == {"scene.nc"} if code == 0 else new <= ({"scene.nc"} if code == 1 else set())
        if new:
            Trajectory.load(folder / "scene.nc")
        nothing_injected(folder)


@fuzzed(4, 2900)
def test_decks_of_hostile_scenes(count: int):
    examine(lambda tables: deck(toml(tables)), spoilt(scenes()), count)


@fuzzed(13, 1500)
def test_runs_of_hostile_scenes(count: int):
    def check(case: tuple[Tables, str]) -> None:
        tables, engine = case
        run_file(toml(tables), "--engine", engine, "--tolerance", "1e-3")

    examine(
        check,
        st.tuples(spoilt(scenes()), st.sampled_from(["auto", "native", "modes", "bessel"])),
        count,
    )


@fuzzed(20, 1500)
def test_spoilt_text_of_scenes(count: int):
    def check(case: tuple[Tables, Callable[[bytes], bytes]]) -> None:
        deck(case[1](toml(case[0])))

    examine(check, st.tuples(scenes(), damage()), count)


@fuzzed(13, 700)
def test_spoilt_tables_of_grains(count: int):
    def check(case: tuple[str, Callable[[bytes], bytes]]) -> None:
        name, spoil = case
        tables = deepcopy(SCENE)
        if name == "grains.csv":
            tables["chain"] = {"file": name}
        else:
            tables["excitation"] = {"kind": name.removesuffix(".csv"), "file": name}
        with Workplace(scene__toml=toml(tables), **{name: spoil(TABLES[name].encode())}) as folder:
            code, _ = call("deck", folder / "scene.toml", "-o", folder / "deck", "--step", "1e-7")
            assert (folder / "deck").exists() == (code == 0)

    examine(check, st.tuples(st.sampled_from(list(TABLES)), damage()), count)


@pytest.mark.parametrize("kind", ["zero", "pipe", "loop", "sparse", "folder", "long"])
def test_special_files_do_not_block(kind: str):
    with Workplace(scene__toml=toml(SCENE | {"chain": {"file": "odd"}})) as folder:
        odd = folder / ("odd" if kind != "long" else "x" * 300)
        if kind == "zero":
            odd.symlink_to("/dev/zero")
        elif kind == "pipe":
            os.mkfifo(odd)
        elif kind == "loop":
            odd.symlink_to(odd)
        elif kind == "sparse":
            with open(odd, "wb") as opened:
                opened.truncate(2**40)
        elif kind == "folder":
            odd.mkdir()
        (folder / "sweep.toml").write_bytes(
            toml({"scene": str(odd), "grid": {"chain.gravity": [1.0]}})
        )
        for words in (
            ("run", odd),
            ("run", folder / "scene.toml"),
            ("fit", odd),
            ("sweep", folder / "sweep.toml"),
        ):
            output = ["-o", folder / "new.nc"] if words[0] != "fit" else []
            assert call(*words, *output)[0] == 2
        assert not (folder / "new.nc").exists()


# --- sweeps


def sweep(text: bytes) -> None:
    with Workplace(sweep__toml=text) as folder:
        before = files(folder)
        code, _ = call("sweep", folder / "sweep.toml", "-o", folder / "out", "--workers", 1)
        new = files(folder) - before
        assert not any(".partial" in name for name in new)
        assert ("out/sweep.json" in new) == (code < 2)
        assert code < 2 or not new
        assert MARK not in str(new)
        nothing_injected(folder)


@fuzzed(8, 1000)
def test_sweeps_of_hostile_tables(count: int):
    examine(lambda tables: sweep(toml(tables)), spoilt(sweeps()), count)


@fuzzed(8, 500)
def test_spoilt_text_of_sweeps(count: int):
    examine(lambda case: sweep(case[1](toml(case[0]))), st.tuples(sweeps(), damage()), count)


# --- answers


@pytest.fixture(scope="module")
def answers(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a scene and its results in all formats, including a stopped run."""
    folder = tmp_path_factory.mktemp("answers")
    tables = deepcopy(SCENE)
    tables["recording"] |= {"duration": 2e-5, "samples": 41}
    (folder / "scene.toml").write_bytes(toml(tables))
    scene = Scene.from_toml(folder / "scene.toml")
    simulate(scene, "native", folder=folder / "finished").save(folder / "run.nc")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(stepping_run, "BLOCK_S", 1e-9)  # Four samples per block.
        with pytest.raises(Stopped):
            simulate(scene, "native", folder=folder / "stopped", max_wall=1e-9)
        with pytest.raises(Stopped):
            resume(folder / "stopped", max_wall=1e-9)
    simulate(scene, engines.Lammps(integrator="verlet", step=1e-7, keep=folder / "lammps"))
    shutil.copy(next((folder / "lammps").glob("*.lammpstrj")), folder / "dump")
    return folder


def read(path: Path, *more: object) -> None:
    """Read a damaged result with all of its readers."""
    with suppress(LmpchainError):
        (
            Trajectory.from_dump(path, Scene.from_toml(str(more[1])))
            if more
            else Trajectory.load(path)
        ).displacement[:]
    call("fit", path, *more, "--json", path.with_suffix(".json"))


@pytest.mark.filterwarnings("ignore:.*going on from", "ignore:the run began with other")
@fuzzed(10, 500)
def test_spoilt_run_folders(answers: Path, count: int):
    """A resumed run gives the right bits, or an error is reported."""
    truth = Trajectory.load(answers / "run.nc")
    which = [
        path.relative_to(answers)
        for name in ("finished", "stopped")
        for path in (answers / name).rglob("*")
    ]
    spoilt = sorted(path for path in which if (answers / path).is_file() and path.name != ".lock")

    def check(case: tuple[Path, Callable[[bytes], bytes], bool]) -> None:
        path, spoil, lost = case
        with Workplace() as folder:
            at = folder / path.parts[0]
            shutil.copytree(answers / path.parts[0], at)
            if lost:
                (folder / path).unlink()
            else:
                (folder / path).write_bytes(spoil((folder / path).read_bytes()))
            read(at)
            code, _ = call("resume", at)
            assert code != 1
            # Files that only SHA256SUMS protects.
            if code == 0 and path.name not in (
                "status.json",
                "zarr.json",
            ):
                with suppress(LmpchainError):  # Each chunk of the arrays has a checksum.
                    assert same(Trajectory.load(at), truth)
            assert not list(folder.rglob("*.partial*"))

    examine(
        check,
        st.tuples(st.sampled_from(spoilt), damage(), st.sampled_from([False] * 5 + [True])),
        count,
    )
