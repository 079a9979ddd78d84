"""Input and data files of LAMMPS, parsed for their physics and never executed.

A command that could change the motion but is not understood is rejected with its line number, so
that no force is ignored silently.
"""

from __future__ import annotations

import copy
import math
import re
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from ..errors import InputError, shown
from ..util.units import CONSISTENT, read_units
from .lammps_state import RunAtom, RunBond, RunFix, RunGrains, RunPair, RunState, is_data, read_data
from .lammps_text import (
    LAMMPS_NUMBER,
    MOST_DIGITS,
    TOKENS,
    InputLine,
    Variables,
    commands,
    read_text,
)

MOST_TYPES = 10**4
ALL_TYPES = range(1, 10**MOST_DIGITS + 1)  # All types, as * means.
# Commands that affect neither grains nor forces.
WITHOUT_PHYSICS = {
    *("log", "echo", "print", "info", "timer", "suffix", "package", "shell"),
    *("thermo", "thermo_style", "thermo_modify", "compute", "compute_modify", "uncompute"),
    *("dump_modify", "undump", "restart", "write_restart", "write_data", "write_dump"),
    *("neighbor", "neigh_modify", "comm_modify", "comm_style", "processors", "newton"),
    *("atom_modify", "special_bonds"),
}
# Fixes that only observe.
OBSERVERS = ("print", "ave/time", "ave/chunk", "ave/histo", "ave/atom", "ave/correlate")
FIXES = {
    *("nve", "nve/sphere", "freeze", "setforce", "gravity", "wall/gran", "addforce", "viscous"),
    *("enforce2d", *OBSERVERS),
}
# Commands that place grains; a dump replaces them.
PLACES = ("create_atoms", "displace_atoms", "minimize", "velocity")
LOOPS = ("label", "next", "jump", "if")
# First words of a condition that only repeats or ends a loop.
WITHOUT_EFFECT = (["then"], ["else"], ["jump"], ["print"])
# Default time steps of inputs without the command timestep, by unit style.
DEFAULT_STEPS = {"si": 1e-8, "cgs": 1e-8, "micro": 2.0, "nano": 0.00045, "lj": 0.005}
DUMP_CURE = "name a dump of its frames, too: --from IN own.lammpstrj"


class LammpsInput:
    """The physics of an input file, with the grains that it places.

    Parameters
    ----------
    path : Path
        Path of an input file or a data file.
    dumped : RunGrains, optional
        Grains from a dump of this input, which replace the grains that the input places.
    units : str or (length, time, mass), optional
        Unit style of LAMMPS, or its units in m, s and kg, as in `read_units`.

    Raises
    ------
    InputError
        If a line that may change the motion is not understood.
    """

    def __init__(
        self,
        path: Path,
        dumped: RunGrains | None = None,
        units: str | Sequence[float] | None = None,
    ):
        self.path = path
        self.dumped = dumped
        self.given_units = units
        self.units_line: InputLine | None = None
        self.units_name = ""
        self.units = read_units(units) if units is not None else read_units("si")
        self.state = RunState()
        self.atom_style: list[str] = ["sphere"]
        self.text = Variables()
        self.regions: dict[str, list[str]] = {}
        self.periodic = [True, True, True]
        self.box: list[float] = []
        self.running: InputLine | None = None
        self.changed: InputLine | None = None
        # A copy of the state at a run, and whether a later command has changed the state.
        self.run_state: RunState | None = None
        self.outdated = True
        self.steps = 0
        self.total = 0
        self.every = 0
        self.changes: list[tuple[int, InputLine]] = []
        # Last step, forces and changes of the runs before every command reset_timestep.
        self.counted: list[tuple[int, RunState | None, list[tuple[int, InputLine]]]] = []
        self.ignored: dict[str, None] = {}
        self.data_only = False
        text = read_text(path)
        if is_data(text):
            self.data_only = True
            read_data(path, text, (), self.state, placed=False)
        else:
            for line in commands(str(path), text):
                self._read(line)
        if self.dumped is None and not self.state.atoms:
            raise InputError.at(str(path), f"places no grains that can be read: {DUMP_CURE}")
        self._choose_state()
        self._check_units()
        self._check_changes()

    # Commands -----------------------------------------------------------------------------------

    def _read(self, line: InputLine) -> None:
        """Parse one command."""
        command = line.text.split()[0]
        if command == "neigh_modify" and "exclude" in line.text.split():
            raise line.refuse(
                "removes forces between pairs, which a scene does not support: remove it"
            )
        if command in WITHOUT_PHYSICS:
            self.ignored[command] = None
            return
        if command in PLACES and self.dumped is not None:
            self._note_change(line)
            self.ignored[f"{command} (the grains are those of the dump)"] = None
            return
        if command in LOOPS:
            self._loop(line, command)
            return
        if command == "variable":
            self.text.define(line)
            return
        reader: Callable[[InputLine, list[str]], None] | None = getattr(
            self, f"_do_{command}", None
        )
        if reader is None:
            raise line.refuse(
                "is not understood, and could change the motion: take it out, or write its effect "
                "in other commands"
            )
        reader(line, self.text.words(line)[1:])

    def _loop(self, line: InputLine, command: str) -> None:
        """Skip a loop that places grains contained in the dump; reject any other loop."""
        if self.dumped is None:
            raise line.refuse(f"is a loop or a condition, which is not executed: {DUMP_CURE}")
        if command == "label":
            return
        if self.steps:
            raise line.refuse("is after a run: write the runs without a loop or a condition")
        # The first two words are the command and its condition.
        executed = ["".join(groups) for groups in TOKENS.findall(line.text)[2:]]
        harmless = all(each.split()[:1] in WITHOUT_EFFECT for each in executed)
        if command == "if" and not harmless:
            raise line.refuse("executes commands on a condition: write those that apply")
        self.ignored[command] = None

    def _do_units(self, line: InputLine, words: list[str]) -> None:
        style = self.text.word(line, words, 0)
        self.units_line = line
        self.units_name = style
        if style not in (*CONSISTENT, "lj"):
            raise line.refuse(f"is not a style for grains: use {', '.join(CONSISTENT)} or lj")
        if style == "lj" and self.given_units in (None, "lj"):
            raise line.refuse("has no scale: add --units LENGTH,TIME,MASS in m, s and kg")
        if style != "lj" and self.given_units not in (None, style):
            raise line.refuse(f"contradicts --units {self.given_units}: leave the option out")
        self.units = read_units(self.given_units, style)

    def _check_units(self) -> None:
        """Raise `InputError` if LAMMPS would use the file with units that have no SI scale."""
        if not self.data_only and self.units_line is None and self.given_units is None:
            raise InputError.at(
                str(self.path),
                "has no command units, so LAMMPS uses lj, which has no scale: "
                "add --units LENGTH,TIME,MASS in m, s and kg",
            )

    def _do_atom_style(self, line: InputLine, words: list[str]) -> None:
        styles = words[1:] if words[:1] == ["hybrid"] else words
        if not styles or set(styles) - {"sphere", "bond", "atomic", "molecular"}:
            raise line.refuse("must be sphere, bond, or hybrid sphere bond")
        self.atom_style = styles

    def _do_dimension(self, line: InputLine, words: list[str]) -> None:
        if words not in (["2"], ["3"]):
            raise line.refuse("must be 2 or 3")

    def _do_boundary(self, line: InputLine, words: list[str]) -> None:
        if len(words) != 3:
            raise line.refuse("must have three words, such as boundary f f f")
        self.periodic = ["p" in word for word in words]

    def _do_lattice(self, line: InputLine, words: list[str]) -> None:
        if self.dumped is not None:
            return
        if words[:1] != ["none"] or (words[1:] and self.text.number(words[1], line) != 1.0):
            raise line.refuse(f"scales positions: write them in units of the box, or {DUMP_CURE}")

    def _do_region(self, line: InputLine, words: list[str]) -> None:
        if words:
            self.regions[words[0]] = words[1:]

    def _do_create_box(self, line: InputLine, words: list[str]) -> None:
        region = self.regions.get(self.text.word(line, words, 1), [])
        bounds = region[1:7] if region[:1] == ["block"] else []
        if len(bounds) == 6 and all(map(LAMMPS_NUMBER.fullmatch, bounds)):
            self.box = [float(bound) for bound in bounds]

    def _do_timestep(self, line: InputLine, words: list[str]) -> None:
        step = self.text.number(self.text.word(line, words, 0), line)
        if not step > 0:
            raise line.refuse(f"must be a time above 0 (got {step:g})")
        self._note_change(line)
        self.state.step = step

    def _do_dump(self, line: InputLine, words: list[str]) -> None:
        every = self.text.word(line, words, 3)
        self.every = int(every) if every.isdigit() and len(every) <= MOST_DIGITS else 0

    def _do_reset_timestep(self, line: InputLine, words: list[str]) -> None:
        first = self.text.whole(self.text.word(line, words, 0), line)
        # Earlier changes have a different step count.
        self.counted.append((self.steps, self.run_state, self.changes))
        self.steps = first
        self.changes = []

    def _do_run(self, line: InputLine, words: list[str]) -> None:
        count = self.text.whole(self.text.word(line, words, 0), line)
        options = words[1:]
        if options[:1] == ["upto"]:
            count = max(0, count - self.steps)
            options = options[1:]
        if options and set(options) - {"pre", "post", "yes", "no"}:
            raise line.refuse("has options that are not understood: write `run` with a number")
        if not count:
            return
        begin = self.steps
        self.steps += count
        self.total += count
        if self.changed is not None and self.running is not None and self.dumped is None:
            raise self.changed.refuse(
                f"is between the runs of lines {self.running.number} and {line.number}, where the "
                f"state of the grains is not known: {DUMP_CURE}"
            )
        # A run that begins after the dump may have other forces than the dump.
        if self.outdated and (self.run_state is None or begin < self._dump_steps()[1]):
            self.run_state = copy.deepcopy(self.state)
            self.outdated = False
        self.running = line
        self.changed = None

    def _note_change(self, line: InputLine) -> None:
        """Note a command that changes grains or forces."""
        self.changed = line
        self.outdated = True
        self.changes.append((self.steps, line))

    def _dump_steps(self) -> tuple[float, float]:
        """Return the steps of the first and the last frame of the dump; infinite without one."""
        steps = None if self.dumped is None else self.dumped.steps
        return steps or (math.inf, math.inf)

    def _choose_state(self) -> None:
        """Choose the forces of the instance, of the run that wrote the dump, or of the last run."""
        if self.dumped is not None and self.dumped.acting is not None and not self.data_only:
            self.state = self._state_with(self.dumped.acting)
            return
        _, last = self._dump_steps()
        counted = [(self.steps, self.run_state, self.changes), *reversed(self.counted)]
        for steps, state, changes in counted:
            if state is not None and steps >= last:
                self.state, self.changes = state, changes
                return
        # Commands after the last run have no effect.
        self.state = self.run_state or self.state

    def _state_with(self, acting: frozenset[str]) -> RunState:
        """Return the state with the fixes of an instance: at the end of the file or at its run."""
        # Styles in capitals are those that LAMMPS creates for itself.
        styles = {style for style in acting if not style.isupper()} - {*OBSERVERS}
        for state in (self.state, self.run_state):
            if state is not None and {fix.style for fix in state.fixes.values()} == styles:
                return state
        raise InputError.at(
            str(self.path),
            f"does not end with the fixes of the instance, {', '.join(sorted(styles)) or 'none'}: "
            "name the input that was executed",
        )

    def _check_changes(self) -> None:
        """Raise `InputError` if forces change while the dump is written."""
        first, last = self._dump_steps()
        for step, line in self.changes:
            if first < step < last:
                raise line.refuse(
                    f"changes the run at step {step}, within the dump, whose frames are from step "
                    f"{first} to {last}: begin the dump after this change"
                )

    def _do_group(self, line: InputLine, words: list[str]) -> None:
        key, style = self.text.word(line, words, 0), self.text.word(line, words, 1)
        groups = self.state.groups
        before = groups.get(key, frozenset())
        added = self._grouped(line, style, words[2:])
        # LAMMPS adds to an existing group.
        members = None if before is None or added is None else before | added
        if style in ("delete", "clear"):
            members = frozenset()
        elif style == "subtract" and members is not None:
            members = members.difference(*(self.members(other, line) for other in words[3:]))
        groups[key] = members
        # A fix acts on the atoms that are in its group during the run.
        if members != before and any(fix.group == key for fix in self.state.fixes.values()):
            self._note_change(line)

    def _grouped(self, line: InputLine, style: str, rest: list[str]) -> frozenset[int] | None:
        """Return the atoms that a command adds to a group; None if they are not known."""
        atoms = self._atoms()
        if style in ("id", "type"):
            if style == "type" and any(atom.kind == 0 for atom in atoms.values()):
                raise line.refuse("depends on types, which the dump does not have: dump type")
            of = (lambda n: n) if style == "id" else (lambda n: atoms[n].kind)
            found = self._select(line, rest)
            return frozenset(n for n in atoms if found(of(n)))
        if style in ("subtract", "union", "intersect") and rest:
            first, *others = (self.members(other, line) for other in rest)
            if style == "subtract":
                return first
            return first.union(*others) if style == "union" else first.intersection(*others)
        return frozenset() if style in ("delete", "clear", "empty", "static") else None

    def members(self, group: str, line: InputLine) -> frozenset[int]:
        """Return the atoms of a group."""
        if group == "all":
            return frozenset(self._atoms())
        members = self.state.groups.get(group)
        if members is None:
            raise line.refuse(f"uses the group {group}, which is not defined by id or type")
        return members

    def _select(self, line: InputLine, words: list[str]) -> Callable[[int], bool]:
        """Return whether a number matches a range such as 1:19, or a comparison such as <= 19."""
        compare: dict[str, Callable[[int, int], bool]] = {
            "<": lambda a, b: a < b,
            "<=": lambda a, b: a <= b,
            ">": lambda a, b: a > b,
            ">=": lambda a, b: a >= b,
            "==": lambda a, b: a == b,
            "!=": lambda a, b: a != b,
        }
        if words[:1] == ["<>"] and len(words) == 3:
            low, high = (self.text.whole(word, line) for word in words[1:])
            return lambda n: low <= n <= high
        if len(words) == 2 and words[0] in compare:
            bound = self.text.whole(words[1], line)
            return lambda n: compare[words[0]](n, bound)
        ranges = [self._range(word, line) for word in words]
        if not ranges:
            raise line.refuse("is too short")
        return lambda n: any(n in each for each in ranges)

    def _range(self, word: str, line: InputLine) -> range:
        """Return the numbers of a range, such as 3, 1:19, 1:19:2, 1*19 or *."""
        parts = re.split(r"[:*]", word)
        if len(parts) > 3 or (len(parts) == 3 and "*" in word):
            raise line.refuse(f"has a range that is not understood, {shown(word)}")
        ends = [self.text.whole(part, line) if part else None for part in parts]
        first = 1 if ends[0] is None else ends[0]
        if len(ends) == 1:
            return range(first, first + 1)
        last = 10**MOST_DIGITS if ends[1] is None else ends[1]
        stride = (ends[2] or 1) if len(ends) == 3 else 1
        return range(first, last + 1, stride)

    # Forces -------------------------------------------------------------------------------------

    def _do_fix(self, line: InputLine, words: list[str]) -> None:
        key, group, style = (self.text.word(line, words, place) for place in range(3))
        if style not in FIXES:
            raise line.refuse(_unread_fix(style))
        if style not in OBSERVERS:
            self._note_change(line)
            self.members(group, line)
            self.state.fixes[key] = RunFix(line, style, words[3:], group)

    def _do_unfix(self, line: InputLine, words: list[str]) -> None:
        if self.state.fixes.pop(self.text.word(line, words, 0), None):
            self._note_change(line)

    def _do_pair_style(self, line: InputLine, words: list[str]) -> None:
        self.text.word(line, words, 0)
        self._note_change(line)
        self.state.pair = (line, words)
        self.state.pair_coefficients = []

    def _do_pair_coeff(self, line: InputLine, words: list[str]) -> None:
        first, second = (self._range(self.text.word(line, words, place), line) for place in (0, 1))
        self._note_change(line)
        self.state.pair_coefficients.append(RunPair(line, first, second, words[2:]))

    def _do_bond_style(self, line: InputLine, words: list[str]) -> None:
        style = self.text.word(line, words, 0)
        if style not in ("harmonic", "lepton", "none", "zero"):
            raise line.refuse("is not a supported bond style: use harmonic or lepton")
        self._note_change(line)
        self.state.bond = (line, words)

    def _do_bond_coeff(self, line: InputLine, words: list[str]) -> None:
        kinds = self._range(self.text.word(line, words, 0), line)
        self._note_change(line)
        for kind in kinds[:MOST_TYPES]:
            self.state.bond_coefficients[kind] = (line, words[1:])

    def _do_mass(self, line: InputLine, words: list[str]) -> None:
        kinds = self._range(self.text.word(line, words, 0), line)
        mass = self.text.number(self.text.word(line, words, 1), line)
        self._note_change(line)
        self.state.type_masses |= dict.fromkeys(kinds[:MOST_TYPES], mass)

    def pair_lines(self, first: int, second: int) -> tuple[InputLine, list[str]] | None:
        """Return the last pair_coeff of two types; types may be written as ranges."""
        low, high = sorted((first, second))
        for pair in reversed(self.state.pair_coefficients):
            if low == 0 and not (pair.first == pair.second == ALL_TYPES):
                raise pair.line.refuse("depends on types, which the dump does not have: dump type")
            if low == 0 or (low in pair.first and high in pair.second):
                return pair.line, pair.words
        return None

    # Grains -------------------------------------------------------------------------------------

    def _atoms(self) -> dict[int, RunAtom]:
        """Return the atoms by number, from the dump if there is one."""
        if not self.state.atoms and self.dumped is not None:
            grains = self.dumped
            length, mass = self.units.length, self.units.mass
            columns = (grains.numbers, grains.types, grains.diameters, grains.masses)
            self.state.atoms = {
                int(n): RunAtom(
                    int(kind), (x / length).tolist(), diameter=d / length, mass=m / mass
                )
                for n, kind, d, m, x in zip(*columns, grains.positions, strict=True)
            }
        return self.state.atoms

    def _do_create_atoms(self, line: InputLine, words: list[str]) -> None:
        if self.text.word(line, words, 1) != "single":
            raise line.refuse(f"places grains that are not read: use `single`, or {DUMP_CURE}")
        self._note_change(line)
        kind = self.text.whole(words[0], line)
        x = [self.text.number(self.text.word(line, words, place), line) for place in (2, 3, 4)]
        if words[5:] not in ([], ["units", "box"], ["units", "lattice"]):
            raise line.refuse(f"has options that are not read: leave them out, or {DUMP_CURE}")
        for place, low, high in zip(x, self.box[::2], self.box[1::2], strict=False):
            if not low <= place < high:
                raise line.refuse("is outside of the box, where LAMMPS creates no grain")
        state = self.state
        state.last_number += 1
        state.atoms[state.last_number] = RunAtom(kind, x)
        if "sphere" in self.atom_style:
            # LAMMPS has a default diameter and density of 1.
            state.atoms[state.last_number] = RunAtom(kind, x, diameter=1.0, mass=math.pi / 6)

    def _do_read_data(self, line: InputLine, words: list[str]) -> None:
        path = Path(self.text.word(line, words, 0))
        if set(words[1::2]) - {"extra/bond/per/atom", "extra/special/per/atom"}:
            raise line.refuse("has options that are not read: leave them out")
        self._note_change(line)
        path = path if path.is_absolute() else self.path.parent / path
        self._atoms()
        placed = self.dumped is not None
        read_data(path, read_text(path), self.atom_style, self.state, placed)

    def _do_set(self, line: InputLine, words: list[str]) -> None:
        style, which = self.text.word(line, words, 0), self.text.word(line, words, 1)
        self._note_change(line)
        atoms = self._atoms()
        if style == "group":
            chosen = [atoms[n] for n in self.members(which, line) if n in atoms]
        elif style in ("atom", "type"):
            found = self._range(which, line)
            chosen = [a for n, a in atoms.items() if (n if style == "atom" else a.kind) in found]
        else:
            raise line.refuse(f"chooses grains by {style}: use atom, type or group")
        rest = words[2:]
        while rest:
            key = rest[0]
            value = self.text.number(self.text.word(line, rest, 1), line)
            for atom in chosen:
                _set(line, atom, key, value)
            rest = rest[2:]

    def _do_velocity(self, line: InputLine, words: list[str]) -> None:
        members = self.members(self.text.word(line, words, 0), line)
        self._note_change(line)
        if words[1:3] == ["zero", "angular"]:
            return
        if words[1:2] != ["set"] or len(words) < 5:
            raise line.refuse(f"gives velocities that are not read: use set, or {DUMP_CURE}")
        options = dict(zip(words[5::2], words[6::2], strict=False))
        if len(words) % 2 == 0 or options.keys() - {"sum", "units"}:
            raise line.refuse(f"has options that are not read: leave them out, or {DUMP_CURE}")
        add = options.get("sum") == "yes"
        for axis, word in enumerate(words[2:5]):
            if word == "NULL":
                continue
            value = self.text.number(word, line)
            for n in members:
                v = self.state.atoms[n].v
                v[axis] = value + (v[axis] if add else 0.0)

    def _do_create_bonds(self, line: InputLine, words: list[str]) -> None:
        self._note_change(line)
        atoms = self._atoms()
        if words[:1] == ["single/bond"] and len(words) >= 4:
            kind, first, second = (self.text.whole(word, line) for word in words[1:4])
            if not {first, second} <= atoms.keys():
                raise line.refuse("names a grain that does not exist")
            self.state.bonds.append(RunBond(kind, first, second))
        elif words[:1] == ["many"] and len(words) == 6:
            one, other = (self.members(word, line) for word in words[1:3])
            kind = self.text.whole(words[3], line)
            low, high = (self.text.number(word, line) for word in words[4:6])
            self.state.bonds += _bonds_within(atoms, one, other, kind, low, high)
        else:
            raise line.refuse("is not read: use many or single/bond, or a data file")

    def grains(self) -> RunGrains:
        """Return the grains, from the dump if there is one, otherwise as the input places them."""
        atoms = self._atoms()
        numbers = np.array(sorted(atoms))
        ordered = [atoms[n] for n in numbers]
        length, mass = self.units.length, self.units.mass
        diameters = length * np.array([atom.diameter or math.nan for atom in ordered])
        masses = mass * np.array([self._mass(atom) for atom in ordered])
        if self.dumped is not None:
            grains = copy.copy(self.dumped)
            known = ~np.isnan(grains.diameters)
            grains.diameters = np.where(known, grains.diameters, diameters)
            grains.masses = np.where(np.isnan(grains.masses), masses, grains.masses)
            grains.types = np.array([atom.kind for atom in ordered])
            return grains
        x = length * np.array([atom.x for atom in ordered])
        v = self.units.velocity * np.array([atom.v for atom in ordered])
        kinds = np.array([atom.kind for atom in ordered])
        slack = 4 * float(np.spacing(np.abs(x).max()))
        grains = RunGrains(str(self.path), numbers, kinds, x, v, diameters, masses, slack)
        if self.running is not None:
            grains.duration = self.total * self.step_s
            even = self.every and self.total % self.every == 0
            grains.samples = self.total // self.every + 1 if even else 0
        if not self.data_only:
            sides = length * np.diff(self.box)[::2] if self.box else math.nan
            grains.period = np.where(self.periodic, sides, math.inf)
        return grains

    def _mass(self, atom: RunAtom) -> float:
        """Return the mass of a grain; for point particles, the mass of its type."""
        of_type = self.state.type_masses.get(atom.kind, math.nan)
        return of_type if math.isnan(atom.mass) else atom.mass

    @property
    def step_s(self) -> float:
        """Time step, s, by default the time step of the unit style."""
        step = self.state.step or DEFAULT_STEPS.get(self.units_name or "lj", 0.0)
        return step * self.units.time


def units_of(path: Path) -> str | None:
    """Return the unit style that an input file names; None without one."""
    found = re.search(r"^[ \t]*units[ \t]+(\w+)", read_text(path), re.MULTILINE | re.ASCII)
    return found[1] if found else None


def _set(line: InputLine, atom: RunAtom, key: str, value: float) -> None:
    """Apply one keyword of the command `set`, as LAMMPS does."""
    if key in ("x", "y", "z"):
        atom.x["xyz".index(key)] = value
    elif key in ("vx", "vy", "vz"):
        atom.v["xyz".index(key[1])] = value
    elif key == "diameter":
        # The mass remains unchanged until the density is set.
        atom.diameter = value
    elif key == "density":
        atom.mass = math.pi / 6 * atom.diameter**3 * value
    elif key == "mass":
        atom.mass = value
    elif key == "type":
        atom.kind = int(value)
    else:
        raise line.refuse(f"sets {key}, which is not read")


def _bonds_within(
    atoms: dict[int, RunAtom],
    one: frozenset[int],
    other: frozenset[int],
    kind: int,
    low: float,
    high: float,
) -> list[RunBond]:
    """Return bonds between atoms of two groups whose distance is within two bounds."""
    if not atoms:
        return []
    places = np.array([atom.x for atom in atoms.values()])
    axis = int(np.argmax(np.ptp(places, axis=0)))
    order = sorted(atoms, key=lambda n: atoms[n].x[axis])
    found = []
    for place, a in enumerate(order):
        for b in order[place + 1 :]:
            if atoms[b].x[axis] - atoms[a].x[axis] > high:
                break
            chosen = (a in one and b in other) or (b in one and a in other)
            if chosen and low <= math.dist(atoms[a].x, atoms[b].x) <= high:
                found.append(RunBond(kind, a, b))
    return found


def _unread_fix(style: str) -> str:
    """Return the reason why a fix cannot be part of a scene, and the remedy."""
    if style == "move":
        return 'moves grains: take it out, and write the motion as [excitation] kind = "drive"'
    if style.startswith("wall/"):
        return "is a wall that is not read: use fix wall/gran with xplane, yplane or zplane"
    return "is a fix that is not understood, and could change the motion: take it out"
