"""Decks of lmpchain read back, edited or not, without running them."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from itertools import pairwise
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...chain.chain import Chain
from ...chain.contacts import pair_value
from ...chain.damping import Damping
from ...errors import InputError, short
from ...integrators.splittings import SPLITTINGS
from ...scene.base import Excitation
from ...scene.excitation import Drive, Force, Impulse, Profile
from ...scene.scene import Scene
from ...util.arrays import Array
from ...util.files import expanded
from . import deck
from .column import Column

EXPONENTS = {"hertz": 1.5, "hooke": 1.0}
HEAVIEST = 1e5  # kg/m3: denser grains are drawn with a gauge diameter
SAME_NUMBER = 1e-6  # relative difference of numbers that were written and read
GAPS = 1e-4  # of an overlap, by which heights at rest may differ
# lines that say how long steps and run are, and where files lie; of a composition the variables do
FREE = {"verlet": {"timestep", "run", "thermo"}, "kahan-li6": {"thermo"}}
FREE_VARIABLES = {"data", "every", "samples", "dump", "dt"}
FLOAT_FORMAT = re.compile(r"%(?:\.(\d{1,2}))?g")
PRODUCT = re.compile(r"\$\(v_(\w+)\*v_(\w+)\)")
VARIABLE = re.compile(r"\$\{(\w+)\}")


class Deck(NamedTuple):
    """What a deck is to run.

    Attributes
    ----------
    scene : Scene
    integrator : str
    step : float
        s.
    gauge : float
        Diameter with which all grains are drawn, m; 0 for their own.
    digits : int
        Of the numbers in its dump.
    """

    scene: Scene
    integrator: str
    step: float
    gauge: float
    digits: int


class _Line(NamedTuple):
    """A command with its number in the file."""

    number: int
    words: list[str]


class _Grains(NamedTuple):
    """The data file: types, (N,) m, kg/m3, m, m/s, m, from the top; z points up."""

    types: list[int]
    diameters: Array
    densities: Array
    heights: Array
    speeds: Array
    rest: Array

    @property
    def masses(self) -> Array:
        """(N,) kg."""
        return np.pi / 6 * self.diameters**3 * self.densities


class _Script:
    """The commands of a deck."""

    def __init__(self, path: Path):
        self.path = path
        text = deck.read_user_text("deck", path)
        self.lines = _commands(text)
        self.variables = {
            line.words[1]: line.words[3]
            for line in self.lines
            if line.words[0] == "variable" and line.words[2:3] == ["index"] and len(line.words) > 3
        }

    def refuse(self, line: _Line | None, why: str) -> InputError:
        """Return the fault of a line, or of the file."""
        where = f"line {line.number} ({short(' '.join(line.words))}) " if line else ""
        return InputError.at(str(self.path), f"{where}{why}")

    def find(self, *words: str) -> _Line | None:
        """Return the first command that begins with these words."""
        found = (line for line in self.lines if line.words[: len(words)] == list(words))
        return next(found, None)

    def need(self, *words: str) -> _Line:
        """Return the first command that begins with these words; raises `InputError`."""
        line = self.find(*words)
        if line is None:
            fault = f"has no command {' '.join(words)}: is it a deck that lmpchain deck wrote?"
            raise self.refuse(None, fault)
        return line

    def value(self, text: str, line: _Line) -> float:
        """Return a number, a variable or a product of two; raises `InputError`."""
        if match := PRODUCT.fullmatch(text):
            return math.prod(self.value(f"${{{name}}}", line) for name in match.groups())
        if match := VARIABLE.fullmatch(text):
            text = self.variables.get(match[1], "")
        try:
            number = float(text)
        except ValueError:
            raise self.refuse(line, "holds no number that can be read without LAMMPS") from None
        if not math.isfinite(number):
            raise self.refuse(line, "must hold a finite number")
        return number

    def variable(self, name: str, missing: float = 0.0) -> float:
        """Return the value of an index variable."""
        if name not in self.variables:
            return missing
        return self.value(f"${{{name}}}", self.need("variable", name))

    def count(self, text: str, line: _Line) -> int:
        """Return a whole number from 1; raises `InputError`."""
        number = self.value(text, line)
        if not (number >= 1 and number == int(number)):
            raise self.refuse(line, f"must hold a whole number from 1 (got {number:g})")
        return int(number)


def read_deck(folder: str | PathLike[str], scene: Scene | None = None) -> Deck:
    """Read what a deck is to run from `in.column` and `column.data`, and execute nothing.

    Chain and excitation follow from the numbers in both files. The commands must be those that
    lmpchain writes for them; variables, the time step and the length of the run may differ.

    Parameters
    ----------
    folder : path
    scene : Scene, optional
        The one that it was written for: needed for a force or a drive through points.

    Returns
    -------
    Deck

    Raises
    ------
    InputError
        If it cannot be understood.
    """
    folder = expanded(folder)
    if not folder.is_dir():
        raise InputError.at("deck", f"there is no folder {folder}")
    script = _Script(folder / "in.column")
    grains = _read_data(folder / "column.data")
    composed = script.find("variable", "part") is not None
    integrator = "kahan-li6" if composed else "verlet"
    timestep = script.need("timestep")
    step = script.variable("dt") if composed else script.value(timestep.words[1], timestep)
    if not step > 0:
        raise script.refuse(timestep, f"must be a time above 0 (got {step:g})")
    output = script.need("dump", "out", "all", "custom")
    every = script.variable("every") if composed else script.value(output.words[4], output)
    every = script.count(repr(every), output)
    script.need("run")
    # through points, there is a run for each piece
    run = [line for line in script.lines if line.words[0] == "run"][-1]
    if composed:
        samples = script.count(repr(script.variable("samples")), script.need("variable", "samples"))
    else:
        samples = script.count(run.words[1], run) // every
    if not samples:
        raise script.refuse(run, f"ends before the first dump, after {every} steps")
    gauge = float(grains.diameters[0]) if grains.densities.min() > HEAVIEST else 0.0
    recording: dict[str, Any] = {"duration": step * every * samples, "samples": samples + 1}
    if scene is None:
        chain = _chain(script, grains, gauge)
        scene = Scene(chain=chain, excitation=_excitation(script, grains), **recording)
    else:
        scene = scene.replace(**recording)
    _check_heights(folder / "column.data", scene, grains)
    if scene.excitation.does_work and step != script.variable("dt"):
        fault = "is not the variable dt, by which force or drive tell the time: set that one"
        raise script.refuse(timestep, fault)
    _check_commands(script, scene, gauge, integrator, step)
    return Deck(scene, integrator, step, gauge, _digits(script))


def _commands(text: str) -> list[_Line]:
    """Return the commands of a text without comments."""
    lines = []
    for number, line in enumerate(text.splitlines(), 1):
        if words := line.partition("#")[0].split():
            lines.append(_Line(number, words))
    return lines


def _read_data(path: Path) -> _Grains:
    """Return the grains of a data file in the order of their numbers; raises `InputError`."""
    text = deck.read_user_text("deck", path)
    rows: dict[str, list[list[str]]] = {"Atoms": [], "Velocities": [], "Rest": []}
    section: list[list[str]] = []
    for line in text.splitlines()[1:]:
        words = line.partition("#")[0].split()
        if words and words[0] in rows and len(words) == 1:
            section = rows[words[0]]
        elif words:
            section.append(words)
    try:
        atoms, speeds, rest = (
            np.array(sorted((list(map(float, row)) for row in part), key=lambda row: row[0]))
            for part in rows.values()
        )
        numbers = np.arange(1, len(atoms) + 1)
        if not all(np.array_equal(part[:, 0], numbers) for part in (atoms, speeds, rest)):
            raise ValueError
        columns = atoms.T[1:4], atoms[:, 6], speeds[:, 3], rest[:, 1]
        if not all(np.isfinite(column).all() for column in columns):
            raise ValueError
    except (ValueError, IndexError):
        fault = "is no data file of a column: it needs Atoms # sphere, Velocities and Rest"
        raise InputError.at(str(path), fault) from None
    types = atoms[:, 1].astype(int).tolist()
    return _Grains(types, atoms[:, 2], atoms[:, 3], atoms[:, 6], speeds[:, 3], rest[:, 1])


def _chain(script: _Script, grains: _Grains, gauge: float) -> Chain:
    """Return the chain of a deck."""
    masses = grains.masses
    d = grains.diameters
    model, stiffness, damping = _contacts(script, grains.types)
    hertz = model == "hertz"
    constants = stiffness
    share: Array | float = 1.0
    if hertz:
        constants = stiffness * np.sqrt(d[:-1] * d[1:] / (d[:-1] + d[1:]) / 2)
        share = pair_value(masses) / 1.5
    # only overlaps and masses enter the motion: a gauge diameter would be compressed too much
    diameters = np.cbrt(6 * masses / (np.pi * 2500.0)) if gauge else d
    return Chain(
        grains=masses.size,
        diameter=diameters,
        masses=masses,
        contact_constants=constants,
        gravity=script.variable("g"),
        exponent=EXPONENTS[model],
        top_load=_load(script, grains, float(constants[0]), EXPONENTS[model]),
        load_grain=_load_grain(script),
        damping=_damping(script, damping * share / stiffness, masses),
        **_ends(script, d, hertz),
    )


def _ends(script: _Script, diameters: Array, hertz: bool) -> dict[str, Any]:
    """Return the ends of the chain of a deck, and the constants of its walls."""
    count = diameters.size
    mobile = script.need("group", "mobile", "id")
    first, _, last = mobile.words[3].partition(":")
    if not (first in ("1", "2") and last in (str(count), str(count - 1))):
        raise script.refuse(mobile, "moves other grains than a column of lmpchain does")
    above, below = (script.find("fix", name, f"at_{name}") for name in ("top", "bottom"))
    bottom = "wall" if below else "free" if last == str(count) else "fixed"
    ends: dict[str, Any] = {"top": "wall" if above else "free", "bottom": bottom}
    if above or below:
        ends["wall_constants"] = [
            _wall_constant(script, line, float(diameters[end]), hertz) if line else 0.0
            for line, end in ((above, 0), (below, -1))
        ]
    return ends


def _load(script: _Script, grains: _Grains, constant: float, exponent: float) -> float:
    """Return the load on the top of the chain of a deck, N.

    On a grain that is driven, or below a wall, it is none of the commands, but in the overlap of
    the first contact at rest.
    """
    if not (script.find("group", "driven") or script.find("fix", "top", "at_top")):
        return script.variable("load")
    d = grains.diameters
    overlap = max(0.0, float((d[0] + d[1]) / 2 - (grains.rest[0] - grains.rest[1])))
    weight = script.variable("g") * float(grains.masses[0])
    load = constant * overlap**exponent - weight
    return load if load > GAPS * weight else 0.0


def _load_grain(script: _Script) -> int:
    """Return the grain on which the load acts."""
    line = script.find("group", "top", "id")
    return script.count(line.words[3], line) if line else 1


def _contacts(script: _Script, types: Sequence[int]) -> tuple[str, Array, Array]:
    """Return the model, and stiffness and damping of each contact between grains, (N-1,)."""
    style = script.need("pair_style")
    words = style.words[1:]
    if words[0] == "gran/hertz/history" and len(words) == 7:
        alike = np.ones(len(types) - 1)
        stiffness, damping = (script.value(words[k], style) * alike for k in (1, 3))
        return "hertz", stiffness, damping
    table: dict[tuple[int, int] | None, tuple[float, float]] = {}
    model = ""
    for line in script.lines:
        if line.words[0] != "pair_coeff":
            continue
        if len(line.words) < 6 or line.words[3] not in EXPONENTS:
            raise script.refuse(line, "is no contact that lmpchain writes")
        first, second, model = line.words[1:4]
        key = None if first == "*" else (int(first), int(second))
        table[key] = (script.value(line.words[4], line), script.value(line.words[5], line))
    if words != ["granular"] or not table:
        raise script.refuse(style, "is no force that lmpchain writes")
    rows = [
        table.get((min(pair), max(pair)), table.get(None, (math.nan, 0.0)))
        for pair in pairwise(types)
    ]
    stiffness, damping = np.array(rows).T
    return model, stiffness, damping


def _wall_constant(script: _Script, line: _Line, diameter: float, hertz: bool) -> float:
    """Return the constant of the contact with a wall, N/m^delta."""
    stiffness = script.value(line.words[6], line) if len(line.words) > 6 else math.nan
    return stiffness * math.sqrt(diameter / 2) if hertz else stiffness


def _damping(script: _Script, viscous: Array, masses: Array) -> Damping:
    """Return the damping of a deck."""
    drag = 0.0
    if line := script.find("fix", "drag", "mobile", "viscous"):
        drag = script.value(line.words[4], line) / float(masses[0])
    elif line := script.find("variable", "drag", "atom"):
        drag = script.value(line.words[3].removesuffix("*mass*vz").removeprefix("-"), line)
    alike = np.ptp(viscous) <= SAME_NUMBER * np.abs(viscous).max(initial=0.0)
    return Damping(viscoelastic=float(viscous.mean()) if alike else viscous, drag=drag)


def _excitation(script: _Script, grains: _Grains) -> Excitation:
    """Return what sets the column of a deck in motion."""
    if struck := script.find("group", "struck", "id"):
        return Impulse(velocity=script.variable("v0"), grain=script.count(struck.words[3], struck))
    if line := script.find("variable", "c0"):
        fault = "acts through points, which the deck does not hold: give its scene, --scene"
        raise script.refuse(line, fault)
    if "amplitude" not in script.variables:
        displacement = grains.rest - grains.heights
        return Profile(displacement=displacement, velocity=0.0 - grains.speeds)
    wave: dict[str, Any] = {
        name: script.variable(name)
        for name in ("amplitude", "frequency", "cycles")
        if name in script.variables
    }
    if pushed := script.find("group", "pushed", "id"):
        wave["grain"] = script.count(pushed.words[3], pushed)
        if script.find("variable", "end") and "cycles" not in wave:
            # half a period
            wave |= {"shape": "half-sine", "duration": 0.5 / wave.pop("frequency")}
        return Force(**wave)
    return Drive(**wave) if script.find("group", "driven") else Drive(grain=0, **wave)


def _digits(script: _Script) -> int:
    """Return the digits of the numbers in the dump."""
    line = script.need("dump_modify", "out")
    match = FLOAT_FORMAT.fullmatch(line.words[-1])
    if not match:
        raise script.refuse(line, "must end in a format such as %.17g")
    # of C: six digits where none are given
    return int(match[1] or 6)


def _check_heights(path: Path, scene: Scene, grains: _Grains) -> None:
    """Raise `InputError` unless grains rest and start where the scene has them."""
    if scene.chain.grains != grains.rest.size:
        fault = f"has {grains.rest.size} grains, the scene {scene.chain.grains}"
        raise InputError.at(str(path), fault)
    gaps = grains.rest[:-1] - grains.rest[1:]
    overlaps = (grains.diameters[:-1] + grains.diameters[1:]) / 2 - gaps
    expected = scene.chain.equilibrium_overlap
    slack = GAPS * expected + 4 * np.spacing(np.abs(grains.rest).max())
    off = np.abs(overlaps - expected) - slack
    if (off > 0).any():
        worst = int(off.argmax())
        raise InputError.at(
            str(path),
            f"grains {worst + 1} and {worst + 2} overlap by {overlaps[worst]:.6g} m at rest, but "
            f"by {expected[worst]:.6g} under gravity, load and contacts of in.column: write the "
            "deck anew, lmpchain deck",
        )
    u, v = scene.initial()
    starts = [(grains.rest - grains.heights, u, 4 * np.spacing(np.abs(grains.rest).max()))]
    if not isinstance(scene.excitation, Impulse):
        # a deck strikes by itself
        starts.append((0.0 - grains.speeds, v, 0.0))
    for values, start, rounding in starts:
        if (np.abs(values - start) > rounding + SAME_NUMBER * np.abs(start).max()).any():
            worst = int(np.abs(values - start).argmax())
            raise InputError.at(
                str(path),
                f"grain {worst + 1} starts with {values[worst]:.6g}, in the scene "
                f"{start[worst]:.6g}: give the scene that the deck was written for, --scene",
            )


def _check_commands(
    script: _Script, scene: Scene, gauge: float, integrator: str, step: float
) -> None:
    """Raise `InputError` at the first command that lmpchain would not write for a scene."""
    style = script.need("pair_style").words[1]
    column = Column(scene, gauge, style)
    expected = _commands(deck.script(column, step, SPLITTINGS[integrator]))
    ours = [line for line in expected if not _is_free(line.words, integrator)]
    theirs = [line for line in script.lines if not _is_free(line.words, integrator)]
    cure = "a deck that does more than lmpchain deck writes cannot be foreseen"
    for line, other in zip(theirs, ours, strict=False):
        if not _alike(line.words, other.words):
            raise script.refuse(line, f"is not `{short(' '.join(other.words))}`: {cure}")
    if len(theirs) > len(ours):
        raise script.refuse(theirs[len(ours)], f"is not known: {cure}")
    if len(theirs) < len(ours):
        missing = " ".join(ours[len(theirs)].words)
        raise script.refuse(None, f"lacks `{short(missing)}`: {cure}")


def _is_free(words: Sequence[str], integrator: str) -> bool:
    """Return whether a command says only how long a run is, or where files lie."""
    if words[0] == "variable":
        return words[1] in FREE_VARIABLES
    if words[0] == "dump_modify":
        return words[1:-1] == ["out", "sort", "id", "format", "float"]
    return words[0] in FREE[integrator]


def _alike(words: Sequence[str], others: Sequence[str]) -> bool:
    """Return whether two commands are the same but for rounding."""
    if len(words) != len(others):
        return False
    return all(one == other or _near(one, other) for one, other in zip(words, others, strict=True))


def _near(one: str, other: str) -> bool:
    try:
        return math.isclose(float(one), float(other), rel_tol=SAME_NUMBER, abs_tol=1e-300)
    except ValueError:
        return False
