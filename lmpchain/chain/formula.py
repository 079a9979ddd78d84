"""Formulas of force laws: a safe parser, derivatives, integrals and conversion to functions.

A scene file from a stranger may contain any formula. Python's parser turns the text into a syntax
tree, in which only numbers, names, arithmetic and the functions below are accepted. The text itself
is never evaluated: every formula that is computed or written to a LAMMPS deck is printed from this
tree again.

=====================  ===============================================
in a formula           meaning
=====================  ===============================================
+ - * / **             arithmetic; ``**`` is a power
min max                smallest or largest of two or more values
abs sqrt exp log       log is the natural logarithm
sin cos tanh           sine and cosine of rad; hyperbolic tangent
step                   step(x) is 1 for x >= 0 and 0 below
=====================  ===============================================
"""

from __future__ import annotations

import ast
import math
import re
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import pairwise
from types import CodeType, FunctionType
from typing import Any
from weakref import WeakValueDictionary

import numpy as np

from ..errors import InputError
from ..util.lazy import cached_property

# Largest number of characters, nested levels and operations of a formula, and its largest number.
MAX_LENGTH = 1000
MAX_DEPTH = 40
MAX_OPERATIONS = 200
MAX_NUMBER = 1e100
# Largest number of conditions (min, max, abs, step): each one doubles the branches to examine.
MAX_CONDITIONS = 6
# Largest number of terms of an expanded formula, and largest power multiplied out for integration.
MAX_TERMS = 200
MAX_POWER = 12

FUNCTIONS = ("min", "max", "abs", "sqrt", "exp", "log", "sin", "cos", "tanh", "step")
CHARACTERS = re.compile(r"[\w\s.+\-*/(),]*", re.ASCII)
OPERATORS: dict[type, str] = {
    ast.Add: "+",
    ast.Sub: "-",
    ast.Mult: "*",
    ast.Div: "/",
    ast.Pow: "**",
}
PRECEDENCE = {"+": 1, "-": 1, "*": 2, "/": 2, "negative": 3, "**": 4}


@dataclass(frozen=True, eq=False)
class Formula:
    """An expression of numbers, names, arithmetic and functions; equal expressions are one object.

    Attributes
    ----------
    operation : str
        "number", "name", "negative", an operator, a function, "select" or "growth". "select" is the
        second part if the first part is 0 or more, otherwise the third part. "growth" of s and p is
        (1 + s)^p - 1, and -1 for s < -1.
    parts : tuple of Formula
        Operands of the operation.
    value : float or str
        Value of a number, or text of a name.
    """

    operation: str
    parts: tuple[Formula, ...] = ()
    value: float | str = ""

    @property
    def number(self) -> float | None:
        """The value of a formula that is a number; None for any other formula."""
        return self.value if isinstance(self.value, float) else None

    def walk(self) -> Iterator[Formula]:
        """Yield every distinct part once, each before the expressions that contain it."""
        seen: set[Formula] = set()
        waiting = [(self, False)]
        while waiting:
            node, ready = waiting.pop()
            if node in seen:
                continue
            if ready:
                seen.add(node)
                yield node
            else:
                waiting.append((node, True))
                waiting += ((part, False) for part in node.parts)

    @cached_property
    def names(self) -> list[str]:
        """Names of variables and parameters in the order of their evaluation."""
        return [str(node.value) for node in self.walk() if node.operation == "name"]

    def rebuilt(self, replace: Callable[[Formula], Formula | None]) -> Formula:
        """Return this formula with the parts replaced for which `replace` returns a formula."""
        made: dict[Formula, Formula] = {}
        for node in self.walk():
            other = replace(node)
            if other is None:
                other = build(node.operation, *(made[part] for part in node.parts))
            made[node] = other
        return made[self]

    def substitute(self, values: Mapping[str, Formula | float]) -> Formula:
        """Return this formula with numbers or formulas in place of names."""

        def replace(node: Formula) -> Formula | None:
            if node.operation == "name" and node.value in values:
                other = values[str(node.value)]
                return other if isinstance(other, Formula) else number(float(other))
            return None if node.parts else node

        return self.rebuilt(replace)

    @property
    def text(self) -> str:
        """The formula as written in a scene file; parsing the text returns this formula."""
        return _print(self)[0]

    @property
    def lepton(self) -> str:
        """The formula in the language of LEPTON, which LAMMPS reads."""
        made: dict[Formula, str] = {}
        for node in self.walk():
            made[node] = _in_lepton(node, [made[part] for part in node.parts])
        return made[self]

    @property
    def lammps(self) -> str:
        """The formula in the language of variables of LAMMPS."""
        made: dict[Formula, str] = {}
        for node in self.walk():
            made[node] = _in_lammps(node, [made[part] for part in node.parts])
        return made[self]

    def derivative(self, variable: str) -> Formula:
        """Return the derivative with respect to a variable; jumps contribute nothing."""
        slopes: dict[Formula, Formula] = {}
        for node in self.walk():
            slopes[node] = _slope(node, [slopes[part] for part in node.parts], variable)
        return slopes[self]

    def change(self, variable: str, by: str) -> Formula:
        """Return the change of the formula if a variable grows by `by`.

        The result never subtracts two nearly equal values, so that its relative accuracy does not
        depend on the size of the change.
        """
        after = self._after(variable, by)
        changes: dict[Formula, Formula] = {}
        for node in self.walk():
            if not node.parts:
                changes[node] = name(by) if node.value == variable else ZERO
            elif all(changes[part] is ZERO for part in node.parts):
                changes[node] = ZERO
            else:
                changes[node] = _change(node, [changes[part] for part in node.parts], after)
        return changes[self]

    def _after(self, variable: str, by: str) -> dict[Formula, Formula]:
        """Return a dict from every part to the part with a variable increased by `by`."""
        after: dict[Formula, Formula] = {}
        for node in self.walk():
            if node.parts:
                after[node] = build(node.operation, *(after[part] for part in node.parts))
            else:
                grows = node.value == variable
                after[node] = add(node, name(by)) if grows else node
        return after

    def without(self, known: Iterable[str], stem: str) -> tuple[Formula, list[Formula]]:
        """Replace the parts that depend only on known names by new names; return formula and parts.

        A new name is `stem` followed by a number, counted from 0.
        """
        constant = set(known)
        parts: list[Formula] = []
        alone: dict[Formula, bool] = {}
        for node in self.walk():
            if node.operation == "name":
                alone[node] = node.value in constant
            else:
                alone[node] = all(alone[part] for part in node.parts)

        def replace(node: Formula) -> Formula | None:
            if not node.parts:
                return node
            if not alone[node]:
                return None
            if node not in parts:
                parts.append(node)
            return name(f"{stem}{parts.index(node)}")

        outer = self.rebuilt(replace)
        # A part of another known part needs a name only if it occurs outside of that part as well.
        used = [part for n, part in enumerate(parts) if f"{stem}{n}" in outer.names]
        names = {f"{stem}{parts.index(part)}": name(f"{stem}{n}") for n, part in enumerate(used)}
        return outer.substitute(names), used

    def conditions(self, variable: str) -> list[Formula]:
        """Return the expressions whose changes of sign are kinks of the formula in a variable."""
        found = [_condition(node) for node in self.walk() if node.operation in CONDITIONAL]
        branches = [branch for one in found for branch in _branches(one)]
        return [c for c in dict.fromkeys(branches) if variable in c.names]

    def kinks(self, variable: str) -> list[Formula]:
        """Return the points at which the formula is not smooth in a variable, as formulas.

        Raises
        ------
        InputError
            If a condition of min, max, abs or step is not linear in the variable.
        """
        places = []
        for condition in self.conditions(variable):
            slope = condition.derivative(variable)
            if variable in slope.names:
                fault = f"bends where {condition.text} = 0, which is not linear in {variable}"
                cure = "use min, max, abs and step of linear terms"
                raise InputError.at("force", f"{fault}: {cure}")
            places.append(divide(negative(condition.substitute({variable: 0.0})), slope))
        return list(dict.fromkeys(places))

    def between_kinks(self, variable: str, at: float) -> Formula:
        """Return the smooth formula of one variable that is valid near a value of the variable."""
        made: dict[Formula, Formula] = {}
        for node in self.walk():
            parts = [made[part] for part in node.parts]
            whole = build(node.operation, *parts) if parts else node
            if whole.operation in CONDITIONAL:
                above = _condition(whole).value_at(variable, at) >= 0
                whole = _sides(whole.operation, whole.parts)[0 if above else 1]
            made[node] = whole
        return made[self]

    def value_at(self, variable: str, at: float) -> float:
        """Return the value of a formula of one variable."""
        result = self.substitute({variable: at}).number
        return math.nan if result is None else result

    def integral(self, variable: str) -> Formula | None:
        """Return the integral of a formula of one variable from 0; None without a closed form.

        Between two neighbouring kinks the formula is smooth and has its own antiderivative G. The
        argument of each G is limited to the interval between its kinks, so that the sum over all
        intervals is the integral at any value of the variable.
        """
        kinks = sorted({k for place in self.kinks(variable) if (k := place.number) is not None})
        edges = [-math.inf, *kinks, math.inf]
        total: Formula = number(0.0)
        for low, high in pairwise(edges):
            smooth = self.between_kinks(variable, _inside(low, high))
            primitive = _primitive(smooth, variable)
            if primitive is None:
                return None
            held = name(variable)
            if low > -math.inf:
                held = build("max", held, number(low))
            if high < math.inf:
                held = build("min", held, number(high))
            start = primitive.value_at(variable, min(max(0.0, low), high))
            if not math.isfinite(start):
                return None
            inside = primitive.substitute({variable: held})
            total = add(total, subtract(inside, number(start)))
        return total

    def function(
        self, arguments: str, functions: Mapping[str, Any], codes: Mapping[str, str] | None = None
    ) -> Callable[..., Any]:
        """Return a Python function that evaluates the formula and computes equal parts once.

        Parameters
        ----------
        arguments : str
            Names of the arguments of the function, separated by commas.
        functions : mapping
            Functions that the code calls, by name: ``maximum minimum absolute sqrt exp log sin cos
            tanh select``, and ``expm1 log1p growth`` in a formula of a change. The entry
            ``__name__`` is the module that the function belongs to.
        codes : mapping, optional
            Code that replaces each name of the formula that is not an argument.
        """
        made: dict[Formula, str] = {}
        lines: list[str] = []
        for node in self.walk():
            code = _in_python(node, [made[part] for part in node.parts])
            if node.operation == "name":
                code = (codes or {}).get(code, code)
            if node.parts:
                lines.append(f"    _{len(lines)} = {code}")
                code = f"_{len(lines) - 1}"
            made[node] = code
        body = "\n".join(lines)
        # The source text was printed only from a tree of accepted parts.
        source = f"def formula({arguments}):\n{body}\n    return {made[self]}\n"
        module = compile(source, "<formula of a law>", "exec")
        constants: tuple[Any, ...] = module.co_consts
        (body_code,) = (each for each in constants if isinstance(each, CodeType))
        return FunctionType(body_code, dict(functions), "formula")

    def __repr__(self) -> str:
        return self.text

    def __reduce__(self) -> Any:
        return make, (self.operation, self.parts, self.value)


_formulas: WeakValueDictionary[Any, Formula] = WeakValueDictionary()


def make(operation: str, parts: tuple[Formula, ...] = (), value: float | str = "") -> Formula:
    """Return the unique formula with this operation, these parts and this value."""
    key = operation, parts, value
    formula = _formulas.get(key)
    if formula is None:
        formula = _formulas[key] = Formula(operation, parts, value)
    return formula


def number(value: float) -> Formula:
    """Return a number as a formula."""
    return make("number", value=float(value))


def name(text: str) -> Formula:
    """Return a variable or parameter as a formula."""
    return make("name", value=text)


ZERO = number(0.0)
ONE = number(1.0)
# Operations with a condition, which compute different expressions on its two sides.
CONDITIONAL = ("max", "min", "abs", "step", "select")
CONSTANT: dict[str, Callable[..., float]] = {
    "+": lambda a, b: a + b,
    "-": lambda a, b: a - b,
    "*": lambda a, b: a * b,
    "/": lambda a, b: a / b,
    "**": lambda a, b: float(np.float64(a) ** np.float64(b)),
    "negative": lambda a: -a,
    "max": max,
    "min": min,
    "abs": abs,
    "sqrt": math.sqrt,
    "exp": math.exp,
    "log": math.log,
    "sin": math.sin,
    "cos": math.cos,
    "tanh": math.tanh,
    "step": lambda a: float(a >= 0),
    "expm1": math.expm1,
    "log1p": math.log1p,
    "growth": lambda s, p: math.expm1(p * math.log1p(s)),
    "select": lambda c, a, b: a if c >= 0 else b,
}


def build(operation: str, *parts: Formula) -> Formula:
    """Return an operation on parts, simplified if an operand makes the result trivial."""
    if operation in SIMPLIFIED:
        return SIMPLIFIED[operation](*parts)
    numbers = [part.number for part in parts]
    if None not in numbers:
        return _constant(operation, numbers)
    if operation == "step" or operation not in CONDITIONAL:
        return make(operation, parts)
    if operation == "select":
        condition, above, below = parts
        if condition.number is not None:
            return above if condition.number >= 0 else below
        return above if above is below else make(operation, parts)
    if operation == "abs":
        return make(operation, parts)
    return reduce(lambda a, b: a if a is b else make(operation, (a, b)), parts)


def _constant(operation: str, numbers: Iterable[Any]) -> Formula:
    """Return the result of an operation on numbers; infinity or NaN if it is undefined."""
    with np.errstate(all="ignore"):
        try:
            return number(CONSTANT[operation](*numbers))
        except ZeroDivisionError:
            return number(math.inf)
        except (ValueError, OverflowError):
            return number(math.nan)


def add(a: Formula, b: Formula) -> Formula:
    """Return a + b."""
    if a is ZERO or b is ZERO:
        return b if a is ZERO else a
    return _arithmetic("+", a, b)


def subtract(a: Formula, b: Formula) -> Formula:
    """Return a - b."""
    if a is b:
        return ZERO
    if b is ZERO:
        return a
    return negative(b) if a is ZERO else _arithmetic("-", a, b)


def multiply(a: Formula, b: Formula) -> Formula:
    """Return a b; if a factor is a step, the other factor is not evaluated where the step is 0."""
    if a is ZERO or b is ZERO:
        return ZERO
    if a is ONE or b is ONE:
        return b if a is ONE else a
    for one, other in ((a, b), (b, a)):
        if one.operation == "step":
            return build("select", one.parts[0], other, ZERO)
        if one.operation == "select" and one.parts[2] is ZERO:
            return build("select", one.parts[0], multiply(one.parts[1], other), ZERO)
        if one.operation == "select" and one.parts[1] is ZERO:
            return build("select", one.parts[0], ZERO, multiply(one.parts[2], other))
    return _arithmetic("*", a, b)


def divide(a: Formula, b: Formula) -> Formula:
    """Return a / b."""
    return a if a is ZERO or b is ONE else _arithmetic("/", a, b)


def power(a: Formula, b: Formula) -> Formula:
    """Return a^b."""
    if b is ZERO:
        return ONE
    return a if b is ONE else _arithmetic("**", a, b)


def negative(a: Formula) -> Formula:
    """Return -a."""
    if a.number is not None:
        return number(-a.number)
    return a.parts[0] if a.operation == "negative" else make("negative", (a,))


def root(a: Formula) -> Formula:
    """Return the square root of a; that of a power is a power, whose slope at 0 is known."""
    if a.operation == "**" and (p := a.parts[1].number) is not None and p % 2:
        return power(a.parts[0], number(p / 2))
    return _constant("sqrt", (a.number,)) if a.number is not None else make("sqrt", (a,))


def _arithmetic(operation: str, a: Formula, b: Formula) -> Formula:
    if a.number is not None and b.number is not None:
        return _constant(operation, (a.number, b.number))
    return make(operation, (a, b))


SIMPLIFIED: dict[str, Callable[..., Formula]] = {
    "+": add,
    "-": subtract,
    "*": multiply,
    "/": divide,
    "**": power,
    "negative": negative,
    "sqrt": root,
}


# Reading.


def parse(text: str) -> Formula:
    """Return the formula that a text describes.

    Raises
    ------
    InputError
        With the key "force", if the text is not a formula, is too long, or is nested too deeply.
    """
    if not isinstance(text, str):
        raise _fault("must be a text such as 'k*max(o, 0)**1.5'")
    if len(text) > MAX_LENGTH:
        raise _fault(f"has {len(text)} characters, more than {MAX_LENGTH}: write it shorter")
    if not CHARACTERS.fullmatch(text):
        wrong = next(c for c in text if not CHARACTERS.fullmatch(c))
        hint = ": write ** for a power" if wrong == "^" else ""
        raise _fault(f"has the character {wrong!r}, which is not allowed{hint}")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            tree = ast.parse(text.strip(), mode="eval")
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise _fault(f"is not a valid formula: {_short(text)}") from None
    left = [MAX_OPERATIONS]
    formula = _read(tree.body, 0, left)
    _check_numbers(formula, text)
    if sum(node.operation in CONDITIONAL for node in formula.walk()) > MAX_CONDITIONS:
        raise _fault(f"has more than {MAX_CONDITIONS} different min, max, abs and step")
    return formula


def _check_numbers(formula: Formula, text: str) -> None:
    """Raise `InputError` if numbers make a formula undefined or too large."""
    for node in formula.walk():
        if node.number is not None and not abs(node.number) <= MAX_NUMBER:
            raise _fault(f"has a number that is too large or undefined: {_short(text)}")
        if node.operation == "/" and node.parts[1] is ZERO:
            raise _fault(f"divides by 0: {_short(text)}")
        base = node.parts[0].number if node.operation == "**" else None
        if base is not None and base <= 0:
            raise _fault(
                f"has a power of the number {_digits(base)}, which is undefined: {_short(text)}"
            )


def _fault(message: str) -> InputError:
    return InputError.at("force", message)


def _short(text: str) -> str:
    return repr(text if len(text) <= 60 else f"{text[:57]}...")


def _read(node: ast.AST, depth: int, left: list[int]) -> Formula:
    """Return the formula of a syntax tree of accepted parts; raise `InputError` for others."""
    left[0] -= 1
    if depth > MAX_DEPTH:
        raise _fault(f"is nested more than {MAX_DEPTH} levels deep")
    if left[0] < 0:
        raise _fault(f"has more than {MAX_OPERATIONS} numbers, names and operations")
    leaf = _read_leaf(node)
    if leaf is not None:
        return leaf
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.UAdd | ast.USub):
        part = _read(node.operand, depth + 1, left)
        return negative(part) if isinstance(node.op, ast.USub) else part
    if isinstance(node, ast.BinOp) and type(node.op) in OPERATORS:
        sides = [_read(side, depth + 1, left) for side in (node.left, node.right)]
        return build(OPERATORS[type(node.op)], *sides)
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and not node.keywords:
        _check_call(node.func.id, len(node.args))
        return build(node.func.id, *(_read(part, depth + 1, left) for part in node.args))
    kinds = "numbers, names, + - * / ** and functions"
    raise _fault(f"has {type(node).__name__}: a formula may contain only {kinds}")


def _read_leaf(node: ast.AST) -> Formula | None:
    """Return a number or a name as a formula; None for any other node."""
    value = node.value if isinstance(node, ast.Constant) else None
    if isinstance(value, int | float) and not isinstance(value, bool):
        if abs(value) > MAX_NUMBER:
            raise _fault(f"has a number above {MAX_NUMBER:g}")
        return number(float(value))
    if isinstance(node, ast.Name):
        if node.id in FUNCTIONS:
            raise _fault(f"has {node.id} without brackets: write {node.id}(...)")
        if node.id.startswith("_") or len(node.id) > 30:
            raise _fault(f"has the name {_short(node.id)}: use up to 30 letters and digits")
        return name(node.id)
    return None


def _check_call(called: str, count: int) -> None:
    """Raise `InputError` unless a function has this name and this number of arguments."""
    if called not in FUNCTIONS:
        raise _fault(f"has the unknown function {_short(called)}: {', '.join(FUNCTIONS)}")
    several = called in ("min", "max")
    if count != 1 if not several else count < 2:
        raise _fault(f"calls {called} with {count} values")


# Printing.


def _digits(value: float) -> str:
    """Return the shortest decimal text that is read as the same number."""
    return repr(int(value)) if value.is_integer() and abs(value) < 1e15 else repr(value)


def _print(node: Formula) -> tuple[str, int]:
    """Return the text of a formula and its precedence."""
    if node.number is not None:
        return _digits(node.number), 3 if node.number < 0 else 5
    if node.operation == "name":
        return str(node.value), 5
    if node.operation == "select" and node.parts[2] is ZERO:
        node = make("*", (make("step", node.parts[:1]), node.parts[1]))
    rank = PRECEDENCE.get(node.operation)
    printed = [_print(part) for part in node.parts]
    if rank is None:
        return f"{node.operation}({', '.join(text for text, _ in printed)})", 5
    if node.operation == "negative":
        text, inner = printed[0]
        # A sum is enclosed in brackets; a product is not, because -a*b and -(a*b) have equal
        # values.
        return f"-({text})" if inner < 4 else f"-{text}", rank
    return _infix(node.operation, rank, *printed), rank


def _infix(operation: str, rank: int, first: tuple[str, int], second: tuple[str, int]) -> str:
    """Return two operands, with their precedence, around an operator, in brackets where needed."""
    left, low = first
    right, high = second
    left_associative = operation != "**"
    if low < rank or (low == rank and not left_associative):
        left = f"({left})"
    if high < rank or (high == rank and left_associative):
        right = f"({right})"
    spaced = f" {operation} " if rank == 1 else operation
    return f"{left}{spaced}{right}"


def _in_lepton(node: Formula, parts: list[str]) -> str:
    if node.number is not None:
        # Neither blanks nor names of numbers are allowed in a deck.
        return f"({node.number!r})" if node.number < 0 else repr(node.number)
    if node.operation == "name":
        return str(node.value)
    if node.operation == "negative":
        return f"(-{parts[0]})"
    if node.operation == "select":
        return f"select(step({parts[0]}),{parts[1]},{parts[2]})"
    if node.operation in PRECEDENCE:
        return f"({parts[0]}{'^' if node.operation == '**' else node.operation}{parts[1]})"
    return f"{node.operation}({','.join(parts)})"


# Functions that variables of LAMMPS lack, or name otherwise, by comparisons and exponentials.
LAMMPS_FUNCTIONS = {
    "log": "ln({0})",
    "tanh": "(1.0-2.0/(exp(2.0*{0})+1.0))",
    "step": "({0}>=0.0)",
    "select": "ternary({0}>=0.0,{1},{2})",
    "max": "ternary({0}>{1},{0},{1})",
    "min": "ternary({0}<{1},{0},{1})",
}


def _in_lammps(node: Formula, parts: list[str]) -> str:
    if node.operation in LAMMPS_FUNCTIONS:
        return LAMMPS_FUNCTIONS[node.operation].format(*parts)
    # Arithmetic and the other functions are those of LEPTON.
    return _in_lepton(node, parts)


NUMPY_NAMES = {"max": "maximum", "min": "minimum", "abs": "absolute"}


def _in_python(node: Formula, parts: list[str]) -> str:
    if node.number is not None:
        return f"({node.number!r})"
    if node.operation == "name":
        return str(node.value)
    if node.operation == "negative":
        return f"-{parts[0]}"
    if node.operation == "**":
        return _power_in_python(node.parts[1].number, *parts)
    if node.operation in PRECEDENCE:
        return f"{parts[0]} {node.operation} {parts[1]}"
    if node.operation == "step":
        return f"select({parts[0]} >= 0.0, 1.0, 0.0)"
    if node.operation == "select":
        return f"select({parts[0]} >= 0.0, {parts[1]}, {parts[2]})"
    return f"{NUMPY_NAMES.get(node.operation, node.operation)}({', '.join(parts)})"


def _power_in_python(exponent: float | None, base: str, other: str) -> str:
    """Return the Python text of a power; products and roots are faster than the power function."""
    if exponent is None or not (2 * exponent).is_integer() or abs(exponent) > 6:
        return f"{base} ** {other}"
    whole = int(abs(exponent))
    factors = [base] * whole + [f"sqrt({base})"] * (abs(exponent) != whole)
    product = " * ".join(factors)
    return product if exponent > 0 else f"1.0 / ({product})"


# Derivatives and conditions.


def _slope(node: Formula, slopes: list[Formula], variable: str) -> Formula:
    """Return the derivative of a formula, given the derivatives of its parts."""
    if not node.parts:
        return ONE if node.value == variable else ZERO
    if all(slope is ZERO for slope in slopes):
        return ZERO
    a = node.parts[0]
    da = slopes[0]
    match node.operation:
        case "+" | "-" | "negative":
            return build(node.operation, *slopes)
        case "*":
            b = node.parts[1]
            return add(multiply(da, b), multiply(a, slopes[1]))
        case "/":
            b = node.parts[1]
            return divide(subtract(da, multiply(node, slopes[1])), b)
        case "**":
            return _slope_of_power(node, slopes)
        case "step":
            return ZERO
        case "select":
            return build("select", a, slopes[1], slopes[2])
        case "max" | "min" | "abs":
            return build("select", _condition(node), *_sides(node.operation, slopes))
    return multiply(OUTER[node.operation](node, a), da)


OUTER: dict[str, Callable[[Formula, Formula], Formula]] = {
    "sqrt": lambda node, a: divide(number(0.5), node),
    "exp": lambda node, a: node,
    "log": lambda node, a: divide(ONE, a),
    "sin": lambda node, a: build("cos", a),
    "cos": lambda node, a: negative(build("sin", a)),
    "tanh": lambda node, a: subtract(ONE, multiply(node, node)),
}


def _slope_of_power(node: Formula, slopes: list[Formula]) -> Formula:
    base, exponent = node.parts
    total = ZERO
    if slopes[0] is not ZERO:
        lower = power(base, subtract(exponent, ONE))
        total = multiply(multiply(exponent, lower), slopes[0])
    if slopes[1] is not ZERO:
        slope = multiply(multiply(node, build("log", base)), slopes[1])
        # A power of 0 stays 0, although the logarithm is infinite.
        total = add(total, build("select", subtract(base, NEARLY_ZERO), slope, ZERO))
    return total


# Added to a sum of two roots, which may be 0; negligible compared with every other number.
NEARLY_ZERO = number(1e-300)
TWO = number(2.0)


def _change(node: Formula, changes: list[Formula], after: Mapping[Formula, Formula]) -> Formula:
    """Return the change of a formula, given the changes of its parts (see `Formula.change`)."""
    a = node.parts[0]
    da = changes[0]
    ends = after[node]
    match node.operation:
        case "+" | "-" | "negative":
            return build(node.operation, *changes)
        case "*":
            return add(multiply(da, after[node.parts[1]]), multiply(a, changes[1]))
        case "/":
            return divide(subtract(da, multiply(node, changes[1])), after[node.parts[1]])
        case "**":
            return _change_of_power(node, changes, after)
        case "sqrt":
            return divide(da, add(add(ends, node), NEARLY_ZERO))
        case "exp":
            return multiply(node, build("expm1", da))
        case "log":
            return build("log1p", divide(da, a))
        case "sin" | "cos":
            half = multiply(number(0.5), da)
            middle = add(a, half)
            if node.operation == "sin":
                return multiply(multiply(TWO, build("cos", middle)), build("sin", half))
            return multiply(multiply(number(-2.0), build("sin", middle)), build("sin", half))
        case "tanh":
            return multiply(build("tanh", da), subtract(ONE, multiply(ends, node)))
        case "step":
            return subtract(ends, node)
    return _change_across(node, changes, after)


def _change_of_power(
    node: Formula, changes: list[Formula], after: Mapping[Formula, Formula]
) -> Formula:
    base, exponent = node.parts
    p = exponent.number
    if p is not None and 0 < p <= 4 and (2 * p).is_integer():
        # x^p is a product x x ... sqrt(x).
        factors = [(base, changes[0], after[base])] * int(p)
        if p != int(p):
            root = build("sqrt", base)
            ends = build("sqrt", after[base])
            slope = divide(changes[0], add(add(ends, root), NEARLY_ZERO))
            factors.append((root, slope, ends))
        return reduce(_change_of_product, factors)[1]
    if p is not None and p.is_integer():
        return _change_of_whole_power((base, changes[0], after[base]), int(p))
    if changes[0] is ZERO:
        return multiply(node, build("expm1", multiply(build("log", base), changes[1])))
    by_base = build("growth", divide(changes[0], base), after[exponent])
    by_exponent = build("expm1", multiply(build("log", base), changes[1]))
    grows = add(by_base, multiply(by_exponent, add(ONE, by_base)))
    # A base that is 0 at rest, or changes its sign, has no growth.
    grown = subtract(multiply(base, after[base]), NEARLY_ZERO)
    return build("select", grown, multiply(node, grows), subtract(after[node], node))


# A value, its change, and the changed value.
Changed = tuple[Formula, Formula, Formula]


def _change_of_product(a: Changed, b: Changed) -> Changed:
    change = add(multiply(a[1], b[2]), multiply(a[0], b[1]))
    return multiply(a[0], b[0]), change, multiply(a[2], b[2])


def _change_of_whole_power(base: Changed, p: int) -> Formula:
    """Return the change of an integer power other than 0, of a base of either sign, by squaring."""
    if p < 0:
        value, change, end = base
        base = divide(ONE, value), negative(divide(divide(change, value), end)), divide(ONE, end)
    factors = []
    for digit in reversed(f"{abs(p):b}"):
        if digit == "1":
            factors.append(base)
        base = _change_of_product(base, base)
    return reduce(_change_of_product, factors)[1]


def _change_across(
    node: Formula, changes: list[Formula], after: Mapping[Formula, Formula]
) -> Formula:
    """Return the change of a conditional operation whose condition may change its sign."""
    condition = _condition(node)
    above, below = _sides(node.operation, node.parts)
    if node.operation == "abs":
        by = changes[0], negative(changes[0])
    else:
        by = changes[-2], changes[-1]
    ended = condition.rebuilt(lambda part: after.get(part, None if part.parts else part))
    if ended is condition:
        return build("select", condition, *by)
    ahead = subtract(above, below)
    passed = build("select", condition, ZERO, ahead)
    returned = build("select", condition, negative(ahead), ZERO)
    return build("select", ended, add(by[0], passed), add(by[1], returned))


def _condition(node: Formula) -> Formula:
    """Return the expression that is at least 0 on the first branch of a conditional operation."""
    if node.operation == "max":
        return subtract(*node.parts)
    if node.operation == "min":
        return subtract(node.parts[1], node.parts[0])
    return node.parts[0]


def _sides(operation: str, parts: Sequence[Formula]) -> tuple[Formula, Formula]:
    """Return both branches of a conditional operation: condition at least 0, and below 0."""
    if operation == "abs":
        return parts[0], negative(parts[0])
    if operation == "step":
        return ONE, ZERO
    return parts[-2], parts[-1]


def _branches(condition: Formula) -> list[Formula]:
    """Return the smooth formulas that a condition can become if it contains conditions itself."""
    found = {condition}
    smooth = []
    while found:
        one = found.pop()
        inner = next((node for node in one.walk() if node.operation in CONDITIONAL), None)
        if inner is None:
            smooth.append(one)
            continue
        for side in _sides(inner.operation, inner.parts):
            found.add(_replaced(one, inner, side))
    return sorted(smooth, key=lambda formula: formula.text)


def _replaced(formula: Formula, old: Formula, new: Formula) -> Formula:
    return formula.rebuilt(lambda node: new if node is old else (None if node.parts else node))


# Integrals of sums of products, by textbook rules.

Term = tuple[float, dict[Formula, float]]  # A factor, and exponents by formula.


def _inside(low: float, high: float) -> float:
    """Return a number between two numbers, one of which may be infinite."""
    if low == -math.inf:
        return high - 1.0 - abs(high) if high < math.inf else 0.0
    return low + 1.0 + abs(low) if high == math.inf else (low + high) / 2


def _primitive(smooth: Formula, variable: str) -> Formula | None:
    """Return an integral of a smooth formula of one variable; None if no rule gives it."""
    terms = _expand(smooth, variable)
    if terms is None:
        return None
    total: Formula = ZERO
    for factor, powers in terms:
        part = _integrate(dict(powers), variable)
        if part is None:
            return None
        total = add(total, multiply(number(factor), part))
    return total


def _expand(node: Formula, variable: str) -> list[Term] | None:
    """Return the terms of a formula of one variable; None if there are too many."""
    if node.number is not None:
        return [(node.number, {})]
    if node.operation in ("+", "-", "negative"):
        return _sum(node.operation, [_expand(part, variable) for part in node.parts])
    if node.operation in ("*", "/"):
        left, right = (_expand(part, variable) for part in node.parts)
        if left is None or right is None:
            return None
        return _times(left, right if node.operation == "*" else _raised(node.parts[1], right, -1.0))
    if node.operation in ("**", "sqrt"):
        exponent = 0.5 if node.operation == "sqrt" else node.parts[1].number
        inner = _expand(node.parts[0], variable)
        if exponent is not None and inner is not None:
            return _raised(node.parts[0], inner, exponent)
    return [(1.0, {node: 1.0})]


def _sum(operation: str, sides: list[list[Term] | None]) -> list[Term] | None:
    """Return the terms of a sum or a difference of two lists of terms, or the negated terms."""
    first, last = sides[0], sides[-1]
    if first is None or last is None:
        return None
    sign = 1.0 if operation == "+" else -1.0
    signed = [(sign * factor, powers) for factor, powers in last]
    terms = signed if len(sides) == 1 else [*first, *signed]
    return terms if len(terms) <= MAX_TERMS else None


def _times(left: list[Term], right: list[Term] | None) -> list[Term] | None:
    if right is None or len(left) * len(right) > MAX_TERMS:
        return None
    product = []
    for a, powers in left:
        for b, others in right:
            merged = dict(powers)
            for base, exponent in others.items():
                merged[base] = merged.get(base, 0.0) + exponent
            product.append((a * b, {base: e for base, e in merged.items() if e != 0}))
    return product


def _raised(base: Formula, terms: list[Term], exponent: float) -> list[Term] | None:
    """Return a power of a sum of terms: factor by factor, multiplied out, or as a single factor."""
    whole = exponent.is_integer()
    if len(terms) == 1:
        factor, powers = terms[0]
        plain = all(e == 1 for e in powers.values()) and len(powers) <= 1
        if (factor > 0 and plain) or (whole and factor != 0):
            return [(factor**exponent, {b: e * exponent for b, e in powers.items()})]
    # A power of a linear term is integrated without expanding it.
    if whole and 1 < exponent <= MAX_POWER and not _is_linear(base):
        product: list[Term] | None = [(1.0, {})]
        for _ in range(int(exponent)):
            product = None if product is None else _times(product, terms)
        return product
    return [(1.0, {base: exponent})]


def _is_linear(base: Formula) -> bool:
    """Return whether a formula of one variable is linear in this variable."""
    names = base.names
    return not names or names[0] not in base.derivative(names[0]).names


def _linear(node: Formula, variable: str) -> tuple[float, float] | None:
    """Return a and b of a + b x if b is not 0; None for any other formula."""
    slope = node.derivative(variable).number
    offset = node.value_at(variable, 0.0)
    return (offset, slope) if slope and math.isfinite(offset) else None


def _integrate(powers: dict[Formula, float], variable: str) -> Formula | None:
    """Return the integral of a product of powers; None if no rule applies."""
    x = name(variable)
    degree = powers.pop(x, 0.0)
    powers = _one_exponential(powers)
    if not powers:
        return _power_integral(x, degree)
    if len(powers) > 1 or not 0 <= degree <= MAX_POWER or not degree.is_integer():
        return None
    ((base, exponent),) = powers.items()
    inner = base.parts[0] if base.operation in PRIMITIVES else base
    linear = _linear(inner, variable)
    if linear is None:
        return None
    if base.operation in PRIMITIVES:
        if exponent != 1:
            return None
        if base.operation in ("tanh", "log") and degree > 0:
            return None
        return _by_parts(base.operation, inner, linear[1], int(degree), x)
    return _shifted(inner, linear, int(degree), exponent)


def _power_integral(base: Formula, exponent: float) -> Formula:
    if exponent == -1:
        return build("log", build("abs", base))
    raised = power(base, number(exponent + 1))
    return divide(raised, number(exponent + 1))


def _one_exponential(powers: dict[Formula, float]) -> dict[Formula, float]:
    """Return a product in which all exponential functions are merged into one."""
    exponentials = {base: e for base, e in powers.items() if base.operation == "exp"}
    if not exponentials:
        return powers
    argument: Formula = ZERO
    for base, exponent in exponentials.items():
        argument = add(argument, multiply(number(exponent), base.parts[0]))
    rest = {base: e for base, e in powers.items() if base not in exponentials}
    return rest | {build("exp", argument): 1.0}


def _shifted(inner: Formula, linear: tuple[float, float], degree: int, exponent: float) -> Formula:
    """Return the integral of x^n L^p with L = a + b x as a sum of powers of L."""
    a, b = linear
    total: Formula = ZERO
    for j in range(degree + 1):
        factor = math.comb(degree, j) * (-a) ** (degree - j) / b ** (degree + 1)
        total = add(total, multiply(number(factor), _power_integral(inner, exponent + j)))
    return total


def _by_parts(operation: str, inner: Formula, slope: float, degree: int, x: Formula) -> Formula:
    """Return the integral of x^n f(L) by parts, for a function f with known integrals."""
    total: Formula = ZERO
    sign = 1.0
    factor = 1.0
    function = operation
    for j in range(degree, -1, -1):
        primitive, function, turned = PRIMITIVES[function](inner)
        factor /= slope
        term = multiply(power(x, number(float(j))), primitive)
        sign *= turned
        total = add(total, multiply(number(sign * factor), term))
        # The next term contains the integral of the primitive, with the opposite sign.
        factor *= j
        sign = -sign
    return total


def _log_cosh(inner: Formula) -> Formula:
    size = build("abs", inner)
    decays = build("exp", multiply(number(-2.0), size))
    return add(size, build("log", multiply(number(0.5), add(ONE, decays))))


# For each function f(L): its integral over L without the sign, the name of the function in the
# integral, and the sign.
PRIMITIVES: dict[str, Callable[[Formula], tuple[Formula, str, float]]] = {
    "exp": lambda inner: (build("exp", inner), "exp", 1.0),
    "sin": lambda inner: (build("cos", inner), "cos", -1.0),
    "cos": lambda inner: (build("sin", inner), "sin", 1.0),
    "tanh": lambda inner: (_log_cosh(inner), "", 1.0),
    "log": lambda inner: (
        subtract(multiply(inner, build("log", inner)), inner),
        "",
        1.0,
    ),
}
