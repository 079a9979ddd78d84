"""Reads decks of lmpchain, edited or not, without running them."""

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
from ...chain.contact_law import pair_value, power_law
from ...chain.damping import Damping
from ...errors import InputError, short
from ...integrators.methods import LAGGED, SPLITTINGS
from ...scene.base import Excitation
from ...scene.excitation import Drive, Force, Impulse, Profile
from ...scene.scene import Scene
from ...util.arrays import Array
from ...util.files import expanded
from . import deck
from .column import LammpsColumn

EXPONENTS = {"hertz": 1.5, "hooke": 1.0}
HEAVIEST = 1e5  # Grains above this density have a gauge diameter, kg/m3.
SAME_NUMBER = 1e-6  # Relative difference of a number after writing and reading.
GAPS = 1e-4  # Largest difference of heights at rest, as a fraction of an overlap.
# Commands whose arguments may differ and that may be repeated: the last one is valid, and runs add
# up.
FREE = {
    "verlet": {"timestep", "run", "thermo", "dump_modify"},
    "kahan-li6": {"thermo", "dump_modify"},
}
FREE_VARIABLES = {"data", "every", "samples", "dump", "dt"}
FLOAT_FORMAT = re.compile(r"%(?:\.(\d{1,2}))?g", re.ASCII)
PRODUCT = re.compile(r"\$\((?:v_(\w+)|(\d+))\*v_(\w+)\)", re.ASCII)
PIECE_END = re.compile(r"\$\(floor\((\S+)/v_(\w+)\)\)", re.ASCII)
VARIABLE = re.compile(r"\$\{(\w+)\}", re.ASCII)
USED = re.compile(r"(?:\$\{|v_)(\w+)", re.ASCII)
LAMMPS_NUMBER = re.compile(
    r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII
)  # A number as LAMMPS reads it.
PLAIN_PATH = re.compile(r"[\w./+-]+", re.ASCII)
# Layout of a row: number of columns, count of leading integers, and columns that must be 0. A
# hybrid style has a column more for bonds, three for sph, or both.
ATOMS = {("Atoms # sphere", 7): (7, 2, [4, 5])} | {
    ("Atoms # hybrid", length): (length, 2, [2, 3, *range(7, length)]) for length in (8, 10, 11)
}
# Columns of type, diameter, density and height in a row.
COLUMNS = {"Atoms # sphere": [1, 2, 3, 6], "Atoms # hybrid": [1, 5, 6, 4]}
DATA_ROWS = {
    "Velocities": (7, 1, [1, 2, 4, 5, 6]),
    "Rest": (2, 1, []),
}
OWN = "Own"
BONDS = "Bonds"


class Deck(NamedTuple):
    """The content of a deck: its scene and its method.

    Attributes
    ----------
    scene : Scene
    integrator : str
        Name of the method in the native engine; "lagged-verlet" for a damped chain with fix nve.
    step : float
        Time step, s.
    gauge : float
        Gauge diameter of all grains, m; 0 for their physical diameters.
    digits : int
        Number of digits of the values in the dump.
    """

    scene: Scene
    integrator: str
    step: float
    gauge: float
    digits: int


class _DeckLine(NamedTuple):
    """A command with its line number."""

    number: int
    words: list[str]


class _Grains(NamedTuple):
    """Grains of a data file from the top, z upward: types and properties in SI units.

    `own` has a column for each parameter of formulas that differs from grain to grain. `bonds`
    has a row for each contact with a law by formula: number, type and grains.
    """

    path: Path
    title: str
    header: list[list[str]]
    types: list[int]
    diameters: Array
    densities: Array
    heights: Array
    speeds: Array
    rest: Array
    own: Array
    bonds: Array

    @property
    def masses(self) -> Array:
        """Masses, (N,) kg."""
        return np.pi / 6 * self.diameters**3 * self.densities


class _Script:
    """The parsed commands of a deck."""

    def __init__(self, path: Path):
        self.path = path
        self.lines = _commands(deck.read_user_text("deck", path))
        self.variables: dict[str, _DeckLine] = {}
        for line in self.lines:
            if not all(map(str.isascii, line.words)) or line.words[-1].endswith("&"):
                raise self.refuse(line, "must be a line of plain ASCII, without & at its end")
            if _is_index(line.words):
                # LAMMPS ignores a second definition of an index variable.
                self.variables.setdefault(line.words[1], line)
        for line in self.lines:
            for name in USED.findall(" ".join(line.words)):
                if name in self.variables and line.number < self.variables[name].number:
                    raise self.refuse(line, f"uses the variable {name} before it is set")

    def refuse(self, line: _DeckLine | None, why: str) -> InputError:
        """Return the error for a line, or for the file."""
        where = f"line {line.number} ({short(' '.join(line.words))}) " if line else ""
        return InputError.at(str(self.path), f"{where}{why}")

    def find(self, *words: str) -> _DeckLine | None:
        """Return the first command that begins with these words, or None."""
        found = (line for line in self.lines if line.words[: len(words)] == list(words))
        return next(found, None)

    def need(self, *words: str) -> _DeckLine:
        """Return the first command that begins with these words; raise `InputError` without one."""
        line = self.find(*words)
        if line is None:
            fault = f"has no command {' '.join(words)}: use a deck that lmpchain deck wrote"
            raise self.refuse(None, fault)
        return line

    def value(self, text: str, line: _DeckLine) -> float:
        """Return the value of a number, a variable or a product; raise `InputError` otherwise."""
        if match := PRODUCT.fullmatch(text):
            first, factor, second = match.groups()
            product = [factor or f"${{{first}}}", f"${{{second}}}"]
            return math.prod(self.value(part, line) for part in product)
        if match := PIECE_END.fullmatch(text):
            step = self.value(f"${{{match[2]}}}", line)
            return math.floor(self.value(match[1], line) / step) if step else 0
        if (match := VARIABLE.fullmatch(text)) and match[1] in self.variables:
            text = self.variables[match[1]].words[3]
        if not LAMMPS_NUMBER.fullmatch(text):
            raise self.refuse(line, "contains no number that can be read without LAMMPS")
        if not math.isfinite(number := float(text)):
            raise self.refuse(line, "must contain a finite number")
        return number

    def argument(self, line: _DeckLine, place: int) -> str:
        """Return one word of a command; raise `InputError` if it is missing."""
        if place >= len(line.words):
            raise self.refuse(line, "is too short")
        return line.words[place]

    def variable(self, name: str, missing: float = 0.0) -> float:
        """Return the value of an index variable."""
        if name not in self.variables:
            return missing
        return self.value(f"${{{name}}}", self.variables[name])

    def count(self, text: str, line: _DeckLine, least: int = 1) -> int:
        """Return an integer of at least `least`; raise `InputError` for other words."""
        number = self.value(text, line)
        if (match := VARIABLE.fullmatch(text)) and match[1] in self.variables:
            text = self.variables[match[1]].words[3]
        # LAMMPS does not accept 1e2 as an integer.
        whole = text.isdigit() or text.startswith("$(")
        if not (whole and least <= number <= deck.STEPS_OF_A_RUN and number == int(number)):
            fault = f"must contain a whole number from {least} to {deck.STEPS_OF_A_RUN}"
            raise self.refuse(line, f"{fault} (got {number:g})")
        return int(number)

    def runs(self) -> tuple[float, int, int]:
        """Return the time step, s, the total number of steps, and the digits of the dumps.

        Raises
        ------
        InputError
            If two runs differ in step or digits.
        """
        step = math.nan
        digits = steps = 0
        kinds: dict[tuple[float, int], None] = {}
        for line in self.lines:
            if line.words[0] == "timestep":
                step = self.value(self.argument(line, 1), line)
                if not step > 0:
                    raise self.refuse(line, f"must be a time above 0 (got {step:g})")
            elif line.words[0] == "dump_modify":
                digits = self.digits(line)
            elif line.words[0] == "run":
                count = self.count(self.argument(line, 1), line, least=0)
                if line.words[2:] not in ([], ["upto"], ["upto", "pre", "no"]):
                    raise self.refuse(line, "must be `run` with a number of steps")
                if line.words[2:] and count < steps:
                    raise self.refuse(line, f"ends before it begins, at step {steps}")
                steps = count if line.words[2:] else steps + count
                kinds[step, digits] = None
                if len(kinds) > 1:
                    fault = "has another time step or dump format than the previous run"
                    raise self.refuse(line, f"{fault}: use the same in all runs")
        (step, digits), *_ = kinds
        return step, steps, digits

    def digits_of_all_frames(self) -> int:
        """Return the digits of a dump whose runs are a loop; raise `InputError` if they change."""
        digits = 0
        begin = self.need("run").number
        for line in self.lines:
            if line.words[0] == "dump_modify":
                if line.number > begin and self.digits(line) != digits:
                    fault = "has another dump format than the first frame: use the same for all"
                    raise self.refuse(line, fault)
                digits = self.digits(line)
        return digits

    def digits(self, line: _DeckLine) -> int:
        """Return the digits of the numbers in the dump."""
        match = FLOAT_FORMAT.fullmatch(line.words[-1])
        if not match:
            raise self.refuse(line, "must end in a format such as %.17g")
        # The format of C prints six digits by default, and at least one.
        return max(1, int(match[1] or 6))


def read_deck(folder: str | PathLike[str], scene: Scene | None = None) -> Deck:
    """Read the scene of a deck from `in.column` and `column.data` without executing anything.

    Chain and excitation follow from the numbers in both files. The commands must be the commands
    that lmpchain writes for this scene; variables, the time step and the length of the run may
    differ.

    Parameters
    ----------
    folder : path
        Folder of the deck.
    scene : Scene, optional
        Scene that the deck was written for; required for a force or a drive that is given by
        points.

    Returns
    -------
    Deck

    Raises
    ------
    InputError
        If the deck is not valid or contains unsupported commands.
    """
    folder = expanded(folder)
    if not folder.is_dir():
        raise InputError.at("deck", f"there is no folder {folder}")
    script = _Script(folder / "in.column")
    grains = _read_data(folder / _data_path(script))
    composed = script.find("variable", "part") is not None
    integrator = "kahan-li6" if composed else "verlet"
    script.need("timestep")
    output = script.need("dump", "out", "all", "custom")
    script.need("dump_modify", "out")
    run = script.need("run")
    every = script.count("${every}", output)
    if composed:
        step = script.variable("dt")
        samples = script.count("${samples}", script.need("variable", "macro"))
        digits = script.digits_of_all_frames()
    else:
        step, steps, digits = script.runs()
        samples = steps // every
    if not samples:
        raise script.refuse(run, f"ends before the first dump, after {every} steps")
    gauge = _gauge(grains, scene)
    recording: dict[str, Any] = {"duration": step * every * samples, "samples": samples + 1}
    if scene is None:
        chain = _chain(script, grains, gauge)
        scene = Scene(chain=chain, excitation=_excitation(script, grains), **recording)
    else:
        scene = scene.replace(**recording)
    _check_heights(scene, grains)
    timed = scene.excitation.does_work or scene.chain.ground_in_time
    if timed and step != script.variable("dt"):
        fault = "is not the variable dt, from which forces and drives compute the time: set dt"
        raise script.refuse(script.need("timestep"), fault)
    lagged = scene.chain.damped and script.find("fix", "motion", "mobile", "nve") is not None
    pair_style = "granular" if script.find("bond_style") else _pair_style(script)[1][0]
    column = LammpsColumn(scene, gauge, pair_style, lagged=lagged)
    _check_data(column, grains)
    _check_formulas(column, grains)
    _check_commands(script, column, integrator, step)
    return Deck(scene, LAGGED.name if lagged else integrator, step, gauge, digits)


def _gauge(grains: _Grains, scene: Scene | None) -> float:
    """Return the gauge diameter of a deck, m; 0 for physical diameters."""
    diameter = float(grains.diameters[0])
    if scene is None:
        physical = grains.densities.min() <= HEAVIEST
    else:
        physical = np.allclose(scene.chain.diameters, diameter, SAME_NUMBER, 0.0)
    return 0.0 if physical or np.ptp(grains.diameters) > 0 else diameter


def _data_path(script: _Script) -> str:
    """Return the path of the data file of a deck; raise `InputError` unless it is plain."""
    data = script.variables.get("data")
    if data is None:
        return "column.data"
    if not PLAIN_PATH.fullmatch(data.words[3]):
        raise script.refuse(data, "must be a plain path")
    return data.words[3]


def _commands(text: str) -> list[_DeckLine]:
    """Return the commands of a text without comments."""
    lines = []
    for number, line in enumerate(text.split("\n"), 1):
        # LAMMPS joins continuation lines before it removes comments.
        command, _, comment = line.partition("#")
        words = command.split() + (["&"] if comment.rstrip().endswith("&") else [])
        if words:
            lines.append(_DeckLine(number, words))
    return lines


def _is_index(words: Sequence[str]) -> bool:
    """Return whether a command defines a variable that `-var` can replace."""
    return len(words) == 4 and words[0] == "variable" and words[2] == "index"


def _read_data(path: Path) -> _Grains:
    """Return the grains of a data file by number; raise `InputError` if it is invalid."""
    text = deck.read_user_text("deck", path)
    first, *paragraphs = re.split(r"\n[ \t\r]*\n", text.rstrip())
    parts = [[line.split() for line in part.split("\n")] for part in paragraphs]
    try:
        # LAMMPS ignores the first line only.
        if "\n" in first:
            raise ValueError
        title, rows = _read_sections(parts)
    except ValueError:
        fault = f"is not a column's data file: it needs {' or '.join(COLUMNS)}, Velocities and Rest"
        raise InputError.at(str(path), fault) from None
    atoms, speeds, rest = (rows[name] for name in (title, *DATA_ROWS))
    for name, (_, _, zeros) in _forms(title, atoms.shape[1]).items():
        if (off := rows[name][:, zeros].any(1)).any():
            worst = int(off.argmax())
            fault = f"grain {worst + 1} does not move on the axis ({name.split()[0]})"
            raise InputError.at(str(path), f"{fault}: x, y and their velocities must be 0")
    kinds, diameters, densities, heights = atoms[:, COLUMNS[title]].T
    types = kinds.astype(int).tolist()
    motion = diameters, densities, heights, speeds[:, 3], rest[:, 1]
    return _Grains(path, title, parts[0], types, *motion, rows[OWN][:, 1:], rows[BONDS])


def _read_sections(parts: list[list[list[str]]]) -> tuple[str, dict[str, Array]]:
    """Return the title of the atoms and the rows; raise `ValueError` for other formats."""
    titles = [" ".join(words) for part in parts[1::2] for words in part]
    sections = dict(zip(titles, parts[2::2], strict=True))
    title, *others = titles
    forms = _forms(title, len(sections[title][0]))
    known = [*DATA_ROWS, *(name for name in (OWN, BONDS) if name in sections)]
    if others != known or not forms:
        raise ValueError
    if OWN in sections:
        forms[OWN] = len(sections[OWN][0]), 1, []
    if BONDS in sections:
        forms[BONDS] = 4, 4, []
    rows = {name: _rows(sections[name], form) for name, form in forms.items()}
    numbers = np.arange(1, len(rows[title]) + 1)
    rows.setdefault(OWN, rows[title][:, :1])
    if not all(np.array_equal(rows[name][:, 0], numbers) for name in (title, *DATA_ROWS, OWN)):
        raise ValueError
    rows.setdefault(BONDS, np.zeros((0, 4)))
    return title, rows


def _forms(title: str, length: int) -> dict[str, tuple[int, int, list[int]]]:
    """Return the forms of the rows of atoms of this length, and of others; {} if there is none."""
    atoms = ATOMS.get((title, length))
    return {title: atoms} | DATA_ROWS if atoms else {}


def _rows(rows: list[list[str]], form: tuple[int, int, list[int]]) -> Array:
    """Return the rows of a section by number; raise `ValueError` for other formats."""
    length, whole, _ = form
    for row in rows:
        if len(row) != length or not all(map(LAMMPS_NUMBER.fullmatch, row)):
            raise ValueError
        if not all(word.isdigit() for word in row[:whole]):
            raise ValueError
    values = np.array(sorted((list(map(float, row)) for row in rows), key=lambda row: row[0]))
    if not np.isfinite(values).all():
        raise ValueError
    return values


def _chain(script: _Script, grains: _Grains, gauge: float) -> Chain:
    """Return the chain that a deck describes."""
    cure = "give its scene, --scene"
    if formula := script.find("bond_style") or script.find("fix", "ground"):
        raise script.refuse(formula, f"has a formula with numbers instead of parameters: {cure}")
    if grains.diameters.size == 1:
        raise InputError.at(str(grains.path), f"has a single grain and no contact: {cure}")
    masses = grains.masses
    d = grains.diameters
    model, stiffness, damping = _contacts(script, grains.types)
    hertz = model == "hertz"
    constants = stiffness
    share: Array | float = 1.0
    if hertz:
        constants = stiffness * np.sqrt(d[:-1] * d[1:] / (d[:-1] + d[1:]) / 2)
        share = pair_value(masses) / 1.5
    # Only overlaps and masses affect the motion. Grains of gauge diameter would be compressed too
    # much for a scene.
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
    """Return the ends of a deck's chain and the constants of its walls."""
    count = diameters.size
    mobile = script.need("group", "mobile", "id")
    first, _, last = script.argument(mobile, 3).partition(":")
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
    """Return the load on the top of a deck's chain, N.

    If grain 1 is driven or below a wall, no command contains a load on it. It then follows from the
    overlap of the first contact at rest.
    """
    imposed = script.find("group", "driven") or script.find("fix", "top", "at_top")
    if "load" in script.variables or not imposed:
        return script.variable("load")
    d = grains.diameters
    overlap = max(0.0, float((d[0] + d[1]) / 2 - (grains.rest[0] - grains.rest[1])))
    weight = script.variable("g") * float(grains.masses[0])
    load = float(power_law(exponent).force(overlap, constant)) - weight
    return load if load > GAPS * weight else 0.0


def _load_grain(script: _Script) -> int:
    """Return the grain on which the load acts."""
    line = script.find("group", "top", "id")
    return script.count(script.argument(line, 3), line) if line else 1


def _contacts(script: _Script, types: Sequence[int]) -> tuple[str, Array, Array]:
    """Return the contact model, and stiffness and damping of each contact, (N-1,)."""
    style, words = _pair_style(script)
    if words[:1] == ["gran/hertz/history"] and len(words) == 7:
        alike = np.ones(len(types) - 1)
        stiffness, damping = (script.value(words[k], style) * alike for k in (1, 3))
        return "hertz", stiffness, damping
    table: dict[tuple[int, int] | None, tuple[float, float]] = {}
    model = ""
    for line in script.lines:
        if line.words[0] != "pair_coeff" or line.words[3:4] == ["dpd"]:
            continue
        # With several pair styles, a coefficient names its style.
        arguments = [word for word in line.words[1:] if word != "granular"]
        if len(arguments) < 5 or arguments[2] not in EXPONENTS:
            raise script.refuse(line, "is not a contact that lmpchain writes")
        first, second, model = arguments[:3]
        key = None
        if first != "*":
            key = script.count(first, line), script.count(second, line)
        table[key] = (script.value(arguments[3], line), script.value(arguments[4], line))
    if words != ["granular"] or not table:
        raise script.refuse(style, "is not a force that lmpchain writes")
    rows = [
        table.get((min(pair), max(pair)), table.get(None, (math.nan, 0.0)))
        for pair in pairwise(types)
    ]
    stiffness, damping = np.array(rows).T
    return model, stiffness, damping


def _pair_style(script: _Script) -> tuple[_DeckLine, list[str]]:
    """Return the command of the pair style, and the arguments for the contacts."""
    style = script.need("pair_style")
    words = style.words[1:]
    if words[:1] == ["hybrid/overlay"] and "dpd" in words:
        # Style dpd acts between no grains, but fix mvv/dpd requires it.
        words = words[1 : words.index("dpd")]
    if not words:
        raise script.refuse(style, "is too short")
    return style, words


def _wall_constant(script: _Script, line: _DeckLine, diameter: float, hertz: bool) -> float:
    """Return the constant of the contact with a wall, N/m^delta."""
    stiffness = script.value(line.words[6], line) if len(line.words) > 6 else math.nan
    return stiffness * math.sqrt(diameter / 2) if hertz else stiffness


def _damping(script: _Script, viscous: Array, masses: Array) -> Damping:
    """Return the damping that a deck describes."""
    drag = 0.0
    if line := script.find("fix", "drag", "mobile", "viscous"):
        moving = masses[1:] if script.find("group", "driven") else masses
        drag = script.value(script.argument(line, 4), line) / float(moving[0])
    elif line := script.find("variable", "drag", "atom"):
        force = script.argument(line, 3)
        drag = script.value(force.removesuffix("*mass*vz").removeprefix("-"), line)
    alike = np.ptp(viscous) <= SAME_NUMBER * np.abs(viscous).max(initial=0.0)
    return Damping(viscoelastic=float(viscous.mean()) if alike else viscous, drag=drag)


def _excitation(script: _Script, grains: _Grains) -> Excitation:
    """Return the excitation that a deck describes."""
    if struck := script.find("group", "struck", "id"):
        grain = script.count(script.argument(struck, 3), struck)
        return Impulse(velocity=script.variable("v0"), grain=grain)
    if line := script.find("variable", "c0"):
        fault = "is given by points, which the deck does not contain: give its scene, --scene"
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
        wave["grain"] = script.count(script.argument(pushed, 3), pushed)
        if script.find("variable", "end") and "cycles" not in wave:
            # The variable stores half a period.
            wave |= {"shape": "half-sine", "duration": 0.5 / wave.pop("frequency")}
        return Force(**wave)
    return Drive(**wave) if script.find("group", "driven") else Drive(grain=0, **wave)


def _check_heights(scene: Scene, grains: _Grains) -> None:
    """Raise `InputError` unless the grains rest and start at the heights of the scene."""
    if scene.chain.grains != grains.rest.size:
        fault = f"has {grains.rest.size} grains, the scene {scene.chain.grains}"
        raise InputError.at(str(grains.path), fault)
    gaps = grains.rest[:-1] - grains.rest[1:]
    overlaps = (grains.diameters[:-1] + grains.diameters[1:]) / 2 - gaps
    expected = scene.chain.equilibrium_overlap
    slack = GAPS * expected + 4 * np.spacing(np.abs(grains.rest).max())
    off = np.abs(overlaps - expected) - slack
    if (off > 0).any():
        worst = int(off.argmax())
        raise InputError.at(
            str(grains.path),
            f"grains {worst + 1} and {worst + 2} overlap by {overlaps[worst]:.6g} m at rest, but "
            f"by {expected[worst]:.6g} under gravity, load and contacts of in.column: write the "
            "deck again with lmpchain deck",
        )
    u, v = scene.initial()
    if isinstance(scene.excitation, Impulse):
        # A deck applies the strike velocity itself.
        v = np.zeros_like(v)
    rounding = 4 * np.spacing(np.abs(grains.rest).max())
    starts = [(grains.rest - grains.heights, u, rounding), (0.0 - grains.speeds, v, 0.0)]
    for values, start, rounding in starts:
        if (np.abs(values - start) > rounding + SAME_NUMBER * np.abs(start).max()).any():
            worst = int(np.abs(values - start).argmax())
            raise InputError.at(
                str(grains.path),
                f"grain {worst + 1} starts with {values[worst]:.6g}, in the scene "
                f"{start[worst]:.6g}: give the scene that the deck was written for, --scene",
            )


def _check_data(column: LammpsColumn, grains: _Grains) -> None:
    """Raise `InputError` unless the rest of a data file is as lmpchain writes it."""
    low, high, bottom, top = map(repr, column.box)
    header = [
        [str(grains.rest.size), "atoms"],
        [str(column.type_count), "atom", "types"],
        [low, high, "xlo", "xhi"],
        [low, high, "ylo", "yhi"],
        [bottom, top, "zlo", "zhi"],
    ]
    if column.formula:
        kinds, coefficients = column.bonds
        header += [[str(len(kinds)), "bonds"], [str(len(coefficients)), "bond", "types"]]
    wrong = [words for words in grains.header if not any(_alike(words, ours) for ours in header)]
    if wrong or len(grains.header) != len(header) or grains.title != f"Atoms # {column.atoms}":
        fault = f"does not have the header of a column of {grains.rest.size} grains"
        raise InputError.at(str(grains.path), f"{fault}: write the deck again with lmpchain deck")
    for key in ("types", "diameters", "densities"):
        values, ours = (np.asarray(getattr(part, key)) for part in (grains, column))
        if not np.allclose(values, ours, rtol=SAME_NUMBER, atol=0.0):
            worst = int(np.abs(values - ours).argmax()) + 1
            fault = f"grain {worst} differs in the {key} from lmpchain's deck, {ours[worst - 1]:g}"
            raise InputError.at(
                str(grains.path), f"{fault}: write the deck again with lmpchain deck"
            )


def _check_formulas(column: LammpsColumn, grains: _Grains) -> None:
    """Raise `InputError` unless bonds, and parameters of the ground, are those of a column."""
    types = np.array(column.bonds[0] if column.formula else [])
    numbers = np.arange(1, types.size + 1)
    bonds = np.column_stack((numbers, types, numbers, numbers + 1))
    if not np.array_equal(grains.bonds, bonds):
        fault = "has other bonds than the contacts of the scene"
        raise InputError.at(str(grains.path), f"{fault}: write the deck again with lmpchain deck")
    own = [*column.own.values()]
    read = grains.own.T
    if len(read) != len(own) or (own and not np.allclose(read, own, SAME_NUMBER, 0.0)):
        fault = f"has other parameters of the grains under {OWN} than the scene"
        raise InputError.at(str(grains.path), f"{fault}: write the deck again with lmpchain deck")


def _check_commands(script: _Script, column: LammpsColumn, integrator: str, step: float) -> None:
    """Raise `InputError` at the first command that lmpchain would not write for this column."""
    expected = _commands(deck.script(column, step, SPLITTINGS[integrator]))
    cure = "only a deck as lmpchain deck writes it can be predicted"
    ours = {line.words[1]: line for line in expected if _is_index(line.words)}
    _check_variables(script, ours, cure)
    rest = [line.words for line in expected if not _is_index(line.words)]
    rest += [ours[name].words for name in ours.keys() - script.variables.keys()]
    _check_order(script, rest, FREE[integrator], cure)


def _check_order(script: _Script, rest: list[list[str]], free: set[str], cure: str) -> None:
    """Raise `InputError` at the first command that is neither the next one of `rest` nor free."""
    # A spline is applied piece by piece, so that each run ends where the next piece begins.
    pieces = sum(words[0] == "run" for words in rest) > 1
    free = free - ({"run"} if pieces else set())
    repeated = set()
    for line in script.lines:
        words = line.words
        if _is_index(words):
            continue
        loose = _is_free(script, line, free)
        if rest and (_alike(words, rest[0]) or (loose and words[0] == rest[0][0])):
            repeated.add(rest.pop(0)[0])
        elif not loose or words[0] not in repeated:
            fault = f"is not `{short(' '.join(rest[0]))}`" if rest else "is not known"
            raise script.refuse(line, f"{fault}: {cure}")
    if rest:
        raise script.refuse(None, f"lacks `{short(' '.join(rest[0]))}`: {cure}")


def _check_variables(script: _Script, ours: dict[str, _DeckLine], cure: str) -> None:
    """Raise `InputError` at the first variable that lmpchain would not define."""
    for name, line in script.variables.items():
        known = name in ours and (name in FREE_VARIABLES or _alike(line.words, ours[name].words))
        if not known:
            raise script.refuse(line, f"is not known: {cure}")


def _is_free(script: _Script, line: _DeckLine, free: set[str]) -> bool:
    """Return whether a command only affects the length of the run or its output."""
    words = line.words
    if words[0] == "dump_modify":
        return words[1:-1] in (["out", "sort", "id", "format", "float"], ["out", "format", "float"])
    if words[0] == "thermo":
        script.count(script.argument(line, 1), line, least=0)
    return words[0] in free and (words[0] == "run" or len(words) == 2)


def _alike(words: Sequence[str], others: Sequence[str]) -> bool:
    """Return whether two commands are equal within rounding."""
    if len(words) != len(others):
        return False
    return all(one == other or _near(one, other) for one, other in zip(words, others, strict=True))


def _near(one: str, other: str) -> bool:
    numbers = LAMMPS_NUMBER.fullmatch(one) and LAMMPS_NUMBER.fullmatch(other)
    return bool(numbers) and math.isclose(float(one), float(other), rel_tol=SAME_NUMBER)
