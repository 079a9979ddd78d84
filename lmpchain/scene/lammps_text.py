"""Text of LAMMPS files: commands with line numbers, words, variables and numbers."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from ..chain.formula import number, parse
from ..errors import InputError, short, shown
from ..util.files import check_readable

LARGEST_FILE = 2**28  # Bytes.
MOST_DIGITS = 18
MOST_CONTINUED = 1000  # Largest number of lines of one command.
MOST_EVALUATIONS = 10**6  # Largest number of evaluations of variables in one input.
MOST_NESTED = 20  # Largest depth of variables that depend on variables.
PIECES = re.compile(
    r'"""(?P<triple>.*?)"""|"(?P<double>[^"]*)"|\'(?P<single>[^\']*)\''
    r"|\$\{(?P<braces>\w+)\}|\$(?P<letter>\w)|(?P<immediate>\$\()",
    re.ASCII | re.DOTALL,
)
TOKENS = re.compile(r'"""(.*?)"""|"([^"]*)"|\'([^\']*)\'|(\S+)', re.DOTALL)
LAMMPS_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
NUMBER_STYLE = re.compile(r"%(\.\d{1,2})?[gef]", re.ASCII)
REFERENCE = re.compile(r"\bv_(\w+)", re.ASCII)
# In LAMMPS -2^2 is 4 and 2^3^2 is 64, in contrast to other readers.
AMBIGUOUS = re.compile(r"(^|[-+*/^(,])\s*-[^-+*/(,]*\^|\^[^-+*/(,]*\^")


class InputLine(NamedTuple):
    """A command of an input file with its line number."""

    file: str
    number: int
    text: str

    def refuse(self, why: str) -> InputError:
        """Return the error that names this line."""
        command = short(" ".join(self.text.split()))
        return InputError.at(self.file, f"line {self.number} ({command}) {why}")


class Variables:
    """The variables of an input, and words and numbers that use them.

    Attributes
    ----------
    values : dict
        Text of every variable by name; None if its value is known only during a run.
    indices : dict
        Text of the variables of style index, which the command line of LAMMPS can set.
    formulas : set
        Names of the variables of style equal; other variables are words.
    """

    def __init__(self) -> None:
        self.values: dict[str, str | None] = {}
        self.indices: dict[str, str] = {}
        self.formulas: set[str] = set()
        self.evaluations = 0

    def define(self, line: InputLine) -> None:
        """Execute a command `variable`."""
        _, key, style, *_ = [*line.text.split(), "", ""]
        if style == "delete":
            self.values.pop(key, None)
        elif style not in ("equal", "string", "internal", "index"):
            self.values[key] = None
        # LAMMPS ignores a second definition of an index.
        elif style != "index" or key not in self.values:
            try:
                self.values[key] = self.word(line, self.words(line), 3)
                (self.formulas.add if style == "equal" else self.formulas.discard)(key)
                if style == "index":
                    self.indices[key] = str(self.values[key])
            except InputError:
                # The fault is reported only if the variable is used.
                self.values[key] = None

    def words(self, line: InputLine) -> list[str]:
        """Return the words of a command with its variables substituted."""
        text = self._expand(line)
        return ["".join(groups) for groups in TOKENS.findall(text)]

    def _expand(self, line: InputLine) -> str:
        """Return a command with ${x}, $x and $(...) outside quotes replaced by their values."""
        text = line.text
        made = ""
        place = 0
        while match := PIECES.search(text, place):
            made += text[place : match.start()]
            place = match.end()
            if match["immediate"]:
                depth = 1
                begin = place
                while depth and place < len(text):
                    depth += {"(": 1, ")": -1}.get(text[place], 0)
                    place += 1
                if depth:
                    raise line.refuse("has a bracket that is not closed")
                expression, _, style = text[begin : place - 1].partition(":")
                style = style if NUMBER_STYLE.fullmatch(style) else "%.15g"
                made += style % self._evaluate(expression, line)
            elif key := match["braces"] or match["letter"]:
                made += self._value(key, line)
            else:
                made += match[0]
        return made + text[place:]

    def _value(self, key: str, line: InputLine) -> str:
        """Return the text that LAMMPS substitutes for a variable."""
        text = self.values.get(key)
        if text is None:
            raise line.refuse(f"uses the variable {key}, whose value is not known without a run")
        if key not in self.formulas or LAMMPS_NUMBER.fullmatch(text):
            return text
        return f"{self._evaluate(text, line):.15g}"

    def _evaluate(self, text: str, line: InputLine, depth: int = 0) -> float:
        """Return the value of an arithmetic expression of numbers and variables."""
        if depth > MOST_NESTED:
            raise line.refuse("has variables that depend on each other")
        values: dict[str, float] = {}
        for key in dict.fromkeys(REFERENCE.findall(text)):
            inner = self.values.get(key)
            if inner is None:
                raise line.refuse(f"uses the variable {key}, whose value is not known")
            if key not in self.formulas and not LAMMPS_NUMBER.fullmatch(inner):
                raise line.refuse(f"uses the variable {key}, which is not a number")
            values[f"v_{key}"] = self._evaluate(inner, line, depth + 1)
            self.evaluations += 1
            if self.evaluations > MOST_EVALUATIONS:
                raise line.refuse("has variables that depend on too many others: write the number")
        if AMBIGUOUS.search(text):
            raise line.refuse("has powers that LAMMPS evaluates in an unusual order: add brackets")
        if re.search(r"\blog\s*\(", text):
            raise line.refuse("uses log, which has the base 10 in LAMMPS: use ln")
        plain = re.sub(r"\bln\s*\(", "log(", text.replace("^", "**"))
        try:
            found = parse(plain).substitute({**values, "PI": number(math.pi)}).number
        except (InputError, ArithmeticError, ValueError):
            found = None
        if found is None or not math.isfinite(found):
            raise line.refuse(f"has {shown(text)}, whose value is not known without LAMMPS")
        return found

    def number(self, text: str, line: InputLine) -> float:
        """Return the number that a word represents; v_name is the value of a variable."""
        if LAMMPS_NUMBER.fullmatch(text) and math.isfinite(value := float(text)):
            return value
        if text.startswith("v_"):
            return self._evaluate(text, line)
        raise line.refuse(f"has {shown(text)} in place of a number")

    def whole(self, text: str, line: InputLine) -> int:
        """Return the integer of at least 0 that a word represents."""
        if not (text.isascii() and text.isdigit() and len(text) <= MOST_DIGITS):
            raise line.refuse(f"has {shown(text)} in place of a whole number")
        return int(text)

    def word(self, line: InputLine, words: Sequence[str], place: int) -> str:
        """Return a word of a command; raise `InputError` if the command is too short."""
        if place >= len(words):
            raise line.refuse("is too short")
        return words[place]


def read_text(path: Path) -> str:
    """Return the text of a LAMMPS file."""
    try:
        check_readable(path, LARGEST_FILE)
        return path.read_bytes().decode("utf-8-sig")
    except FileNotFoundError:
        raise InputError.at(str(path), "there is no such file") from None
    except UnicodeDecodeError:
        cure = "name an input, a data file or a dump"
        raise InputError.at(str(path), f"is not text: {cure}") from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError.at(str(path), f"cannot be read: {reason}") from None


def commands(file: str, text: str) -> Iterator[InputLine]:
    """Yield the commands of a text without comments, with continuation lines joined."""
    waiting = ""
    begin = 1
    for count, raw in enumerate(text.replace("\r\n", "\n").split("\n"), 1):
        waiting += raw
        # LAMMPS joins lines before it removes comments.
        continued = waiting.rstrip().endswith("&")
        if continued or waiting.count('"""') % 2:
            if count - begin > MOST_CONTINUED:
                break
            waiting = waiting.rstrip()[:-1] + " " if continued else waiting + "\n"
            continue
        if command := _without_comment(waiting).strip():
            yield InputLine(file, begin, command)
        waiting = ""
        begin = count + 1
    if waiting.strip():
        raise InputError.at(file, f"line {begin} is continued, but its end is not found")


def _without_comment(text: str) -> str:
    """Return a line up to the first # outside quotes."""
    quote = ""
    for place, letter in enumerate(text):
        if letter == quote:
            quote = ""
        elif not quote and letter in "\"'":
            quote = letter
        elif not quote and letter == "#":
            return text[:place]
    return text
