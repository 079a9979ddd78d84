"""Strange values for every number of a scene file lead to one line with a remedy."""

import re
from collections.abc import Iterator
from contextlib import redirect_stderr, redirect_stdout
from copy import deepcopy
from io import StringIO
from pathlib import Path
from typing import Any

import pytest
from project.test_fuzz import EXCITATIONS, SCENE, Tables, places, toml

from lmpchain.cli.command_line import main

NAN = float("nan")
INF = float("inf")
STRANGE: list[Any] = [NAN, INF, -INF, -1, 0, 5e-324, 1e308, True, "x", [], {}]
LONGEST = 400  # Largest number of letters of a line; a repeated value has at most 80.
ALL: list[Tables] = [
    *EXCITATIONS,
    {"kind": "drive", "grain": 1, "amplitude": 1e-10, "frequency": 1e4, "cycles": 2.5},
    {"kind": "force", "grain": 2, "amplitude": 1e-4, "frequency": 1e5, "cycles": 1.0},
    {"kind": "force", "shape": "half-sine", "amplitude": 1e-4, "duration": 2e-6},
    {"kind": "force", "times": [0.0, 1e-6, 1e-5], "force": [0.0, 1e-4, 0.0]},
    {"kind": "packet", "frequency": 3e4, "width": 2.0, "grain": 3, "amplitude": 1e-10},
]
MORE = {"masses": [1e-6] * 6, "contact_constants": [1e9] * 5, "wall_constants": [0.0, 1e9]}
REFUSED = {  # All commands report a fault of a scene in the same way.
    "plan": (),
    "run": ("--engine", "native", "--tolerance", "1e-2", "--force"),
    "compare": ("--tolerance", "1e-2"),
    "deck": ("-o", "deck", "--step", "1e-8"),
    "orbit": ("--mode", "1", "--energy", "1e-20"),
    "stability": (),
    "workprec": ("--budget", "0.1", "-o", "chart.png"),
    "report": ("column.lammpstrj", "--scene"),
    "fit": ("column.lammpstrj", "--scene"),
    "dyson": ("column.lammpstrj", "--m", "1", "--scene"),
}
# Commands that are fast enough to be run if the scene is accepted.
DONE = ("plan", "run", "compare", "deck")
DUMP = "".join(
    f"ITEM: TIMESTEP\n{step}\nITEM: NUMBER OF ATOMS\n6\nITEM: BOX BOUNDS ff ff ff\n-1 1\n-1 1\n-1 "
    "1\n"
    "ITEM: ATOMS id x y z vx vy vz\n"
    + "".join(f"{n} 0 0 {-1e-3 * n:g} 0 0 0\n" for n in range(1, 7))
    for step in (0, 1)
)


def numbers(tables: Tables) -> Iterator[tuple]:
    """Yield the path to every number of a scene, in lists to the first."""
    for way in places(tables):
        value: Any = tables
        for step in way:
            value = value[step]
        if isinstance(value, int | float | list) and not any(
            isinstance(step, int) and step for step in way
        ):
            yield way


def spoilt(tables: Tables, way: tuple, value: Any) -> Tables:
    """Return the tables with another value."""
    other = deepcopy(tables)
    holder: Any = other
    for step in way[:-1]:
        holder = holder[step]
    holder[way[-1]] = value
    return other


def bases() -> Iterator[tuple[str, Tables, tuple[str, ...]]]:
    """Yield scenes with the tables whose numbers are to be changed."""
    plain = deepcopy(SCENE)
    yield "chain", plain, ("chain", "recording")
    given = deepcopy(SCENE)
    del given["chain"]["impurity"], given["chain"]["bottom_material"]
    given["chain"] |= MORE
    yield "given", given, ("chain",)
    for number, excitation in enumerate(ALL):
        acted = deepcopy(SCENE) | {"excitation": dict(excitation)}
        if excitation.get("grain") == 0:
            acted["chain"]["top"] = "wall"
        yield f"{excitation['kind']} {number}", acted, ("excitation",)


def said(command: str, scene: str) -> tuple[int, list[str]]:
    """Return the exit code of a command on a scene, and its printed errors."""
    out = StringIO()
    err = StringIO()
    options = REFUSED[command]
    with redirect_stdout(out), redirect_stderr(err):
        code = main(
            [command, *options, scene] if "--scene" in options else [command, scene, *options]
        )
    lines = err.getvalue().splitlines()
    assert not any(
        "Traceback" in line or len(line) > LONGEST or not line.isprintable() for line in lines
    ), lines
    return code, [line for line in lines if line.startswith("error: ")]


@pytest.mark.soak
@pytest.mark.parametrize("base", [pytest.param(base, id=base[0]) for base in bases()])
def test_strange_numbers(
    base: tuple[str, Tables, tuple[str, ...]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """All commands report the same line with exit code 2, or none rejects the scene."""
    _, tables, parts = base
    monkeypatch.chdir(tmp_path)
    Path("column.lammpstrj").write_text(DUMP)
    cases = [(way, value) for way in numbers(tables) if way[0] in parts for value in STRANGE]
    wrong: list[str] = []
    for way, value in cases:
        Path("scene.toml").write_bytes(toml(spoilt(tables, way, value)))
        name = f"{'.'.join(map(str, way))} = {value!r}"
        before = None
        for command in REFUSED:
            if before is not None and before[0] != 2 and command not in DONE:
                break
            try:
                found = said(command, "scene.toml")
            except Exception as error:
                wrong.append(f"{name}: {command}: {type(error).__name__}: {error}")
                continue
            before = before or found
            code, errors = found
            if (
                code not in (0, 1, 2)
                or (code == 2 and len(errors) != 1)
                or (code == 1 and not errors)
            ):
                wrong.append(f"{name}: {command}: exit code {code}, {errors}")
            elif before[0] == 2 and found != before:
                wrong.append(f"{name}: {command}: {found} instead of {before}")
            elif code == 2 and not re.match(r"error: [\w.\[\]]+: ", errors[0]):
                wrong.append(f"{name}: {command}: {errors} names no field")
    assert not wrong, "\n".join(wrong)
