"""Formulas from users: parsed by a whitelist over the syntax tree, differentiated, compiled.

No text is ever evaluated. Python parses the text, this module checks every node of the tree, and
the functions that numba and numpy run are built from the checked tree alone.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from types import CodeType, FunctionType
from typing import Any

import numpy as np

from ..errors import InputError

# Number of arguments of each function that a formula may call.
FUNCTIONS = {
    "min": 2,
    "max": 2,
    "abs": 1,
    "sqrt": 1,
    "exp": 1,
    "log": 1,
    "sin": 1,
    "cos": 1,
    "tanh": 1,
    "step": 1,
}
NUMPY = {"min": "minimum", "max": "maximum", "abs": "abs"}  # names that differ in numpy
OPERATORS = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Pow: "**"}
LONGEST_TEXT = 500  # characters
MOST_NODES = 5000  # of a derivative
LARGEST_NUMBER = 1e100
MOST_HALVES = 8  # powers of up to 4 become products
# Derivatives call a function that formulas may not call, see `where`.
WHERE = "where"
ZERO: ast.expr = ast.Constant(0.0)
ONE: ast.expr = ast.Constant(1.0)


def where(a: Any, b: Any, x: Any, y: Any) -> Any:
    """Return x where a > b, else y; the kernels have a compiled version."""
    return np.where(a > b, x, y)


@cache
def parse(text: str, key: str) -> ast.expr:
    """Return the checked syntax tree of a formula.

    Parameters
    ----------
    text : str
    key : str
        Key of the scene file that an error names.

    Raises
    ------
    InputError
        If the text is too long, is not a formula, or uses anything but numbers, names, operators
        and the functions of `FUNCTIONS`.
    """
    if len(text) > LONGEST_TEXT:
        raise InputError.at(
            key, f"has {len(text)} characters; at most {LONGEST_TEXT} are allowed: shorten it"
        )
    try:
        tree = ast.parse(text.strip(), mode="eval").body
        return _checked(tree, key)
    # Null characters, and too many brackets within each other
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise InputError.at(
            key, f"is not a formula (got {text[:60]!r}): write one such as k*max(o, 0)**1.5"
        ) from None


def _checked(node: ast.expr, key: str) -> ast.expr:
    """Return a node whose parts are all allowed, with numbers as floats and without positions."""
    match node:
        case ast.Constant(value=bool()):
            pass
        case ast.Constant(value=int() | float() as number):
            if not number < LARGEST_NUMBER:
                raise InputError.at(
                    key, f"has a number of {LARGEST_NUMBER:g} or more: use SI units"
                )
            return ast.Constant(float(number))
        case ast.Name(id=name):
            return ast.Name(name, ast.Load())
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            return negative(_checked(operand, key))
        case ast.UnaryOp(op=ast.UAdd(), operand=operand):
            return _checked(operand, key)
        case ast.BinOp(op=op, left=left, right=right) if type(op) in OPERATORS:
            return ast.BinOp(_checked(left, key), op, _checked(right, key))
        case ast.Call(func=ast.Name(id=name), args=given, keywords=[]) if name in FUNCTIONS:
            if len(given) != FUNCTIONS[name]:
                raise InputError.at(
                    key, f"gives {name} {len(given)} arguments; it takes {FUNCTIONS[name]}"
                )
            return call(name, *(_checked(each, key) for each in given))
    allowed = "numbers, names, + - * / ** and " + ", ".join(FUNCTIONS)
    raise InputError.at(key, f"contains {ast.unparse(node)[:60]!r}; only {allowed} are allowed")


def call(name: str, *arguments: ast.expr) -> ast.expr:
    """Return the node of a function of `FUNCTIONS`, or of `WHERE`."""
    return ast.Call(ast.Name(name, ast.Load()), list(arguments), [])


def names_in(tree: ast.expr) -> tuple[str, ...]:
    """Return the variables and parameters of a formula, sorted."""
    called = {id(node.func) for node in ast.walk(tree) if isinstance(node, ast.Call)}
    return tuple(
        sorted(
            {
                node.id
                for node in ast.walk(tree)
                if isinstance(node, ast.Name) and id(node) not in called
            }
        )
    )


def _value(node: ast.expr) -> float | None:
    """Return the value of a constant; None for anything else."""
    return node.value if isinstance(node, ast.Constant) else None  # type: ignore[return-value]


def negative(node: ast.expr) -> ast.expr:
    """Return the node -x."""
    number = _value(node)
    return ast.Constant(-number) if number is not None else ast.UnaryOp(ast.USub(), node)


def plus(a: ast.expr, b: ast.expr) -> ast.expr:
    """Return the node a + b."""
    if _value(a) == 0:
        return b
    return a if _value(b) == 0 else ast.BinOp(a, ast.Add(), b)


def times(a: ast.expr, b: ast.expr) -> ast.expr:
    """Return the node a b.

    A factor that depends on a condition is multiplied branch by branch, because the other factor
    may be infinite where the branch is 0.
    """
    if _value(a) == 0 or _value(b) == 0:
        return ZERO
    if _value(a) == 1:
        return b
    if _value(b) == 1:
        return a
    for one, other in ((a, b), (b, a)):
        if isinstance(one, ast.Call) and one.func.id == WHERE:  # type: ignore[attr-defined]
            low, high, x, y = one.args
            return call(WHERE, low, high, times(x, other), times(y, other))
    return ast.BinOp(a, ast.Mult(), b)


def choose(a: ast.expr, b: ast.expr, x: ast.expr, y: ast.expr) -> ast.expr:
    """Return the node that is x if a > b, else y."""
    return ZERO if _value(x) == 0 and _value(y) == 0 else call(WHERE, a, b, x, y)


def derivative(node: ast.expr, variable: str) -> ast.expr:
    """Return the derivative of a checked formula by a variable, as a tree."""

    def by(part: ast.expr) -> ast.expr:
        return derivative(part, variable)

    match node:
        case ast.Constant():
            return ZERO
        case ast.Name(id=name):
            return ONE if name == variable else ZERO
        case ast.UnaryOp(operand=operand):
            return times(ast.Constant(-1.0), by(operand))
        case ast.BinOp(left=a, op=ast.Add(), right=b):
            return plus(by(a), by(b))
        case ast.BinOp(left=a, op=ast.Sub(), right=b):
            return plus(by(a), times(ast.Constant(-1.0), by(b)))
        case ast.BinOp(left=a, op=ast.Mult(), right=b):
            return plus(times(by(a), b), times(a, by(b)))
        case ast.BinOp(left=a, op=ast.Div(), right=b):
            # a' / b - a b' / b^2
            inverse = ast.BinOp(ONE, ast.Div(), b)
            square = ast.BinOp(inverse, ast.Mult(), inverse)
            return plus(
                times(by(a), inverse), times(ast.Constant(-1.0), times(a, times(square, by(b))))
            )
        case ast.BinOp(left=a, op=ast.Pow(), right=b):
            return _of_power(a, b, by)
        case ast.Call(func=ast.Name(id=name), args=args):
            return _of_call(name, args, by)
    raise AssertionError(ast.dump(node))


def _of_power(a: ast.expr, b: ast.expr, by: Callable[[ast.expr], ast.expr]) -> ast.expr:
    """Return the derivative of a**b."""
    if isinstance(a, ast.Call) and a.func.id in ("max", "min"):  # type: ignore[attr-defined]
        # Branch by branch, because max(o, 0)**p has infinite derivatives at 0 for small p.
        first, second = a.args
        one, other = (_of_power(each, b, by) for each in (first, second))
        greater = a.func.id == "max"  # type: ignore[attr-defined]
        return choose(first, second, one, other) if greater else choose(second, first, one, other)
    slope = ZERO
    if _value(rate := by(a)) != 0:
        number = _value(b)
        less = ast.Constant(number - 1) if number is not None else plus(b, ast.Constant(-1.0))
        lower = (
            a if _value(less) == 1 else ONE if _value(less) == 0 else ast.BinOp(a, ast.Pow(), less)
        )
        slope = times(times(b, lower), rate)
    if _value(rate := by(b)) != 0:
        whole = ast.BinOp(a, ast.Pow(), b)
        slope = plus(slope, times(times(whole, call("log", a)), rate))
    return slope


def _of_call(name: str, args: list[ast.expr], by: Callable[[ast.expr], ast.expr]) -> ast.expr:
    """Return the derivative of a call."""
    a = args[0]
    rates = [by(each) for each in args]
    if name == "sqrt":
        return _of_power(a, ast.Constant(0.5), by)
    if name == "step":
        return ZERO
    if name == WHERE:
        return choose(a, args[1], rates[2], rates[3])
    if name == "max":
        return choose(a, args[1], *rates)
    if name == "min":
        return choose(args[1], a, *rates)
    itself = call(name, a)
    minus = ast.Constant(-1.0)
    slopes = {
        "abs": call(WHERE, a, ZERO, ONE, minus),
        "exp": itself,
        "log": ast.BinOp(ONE, ast.Div(), a),
        "sin": call("cos", a),
        "cos": times(minus, call("sin", a)),
        "tanh": plus(ONE, times(minus, ast.BinOp(itself, ast.Mult(), itself))),
    }
    return times(slopes[name], rates[0])


def compiled(
    tree: ast.expr, arguments: tuple[str, ...], names: Mapping[str, ast.expr], key: str
) -> Any:
    """Return the Python function of a tree, for numbers (by numba) and arrays (by numpy).

    Parameters
    ----------
    tree : ast.expr
    arguments : tuple of str
        Arguments of the function.
    names : mapping of str to ast.expr
        Expressions of the arguments that take the place of names in the formula.
    key : str
        Key of the scene file that an error names.

    Raises
    ------
    InputError
        If the tree is too large.
    """
    if sum(1 for _ in ast.walk(tree)) > MOST_NODES:
        raise InputError.at(key, "is too long to be differentiated: write a shorter formula")
    body = _Numpy(names).visit(ast.Expression(_copy(tree))).body
    inputs = [ast.arg(name) for name in arguments]
    function = ast.Lambda(ast.arguments([], inputs, None, [], [], None, []), body)
    code = compile(ast.fix_missing_locations(ast.Expression(function)), "<formula>", "eval")
    (body_code,) = (each for each in code.co_consts if isinstance(each, CodeType))
    return FunctionType(body_code, {"np": np, WHERE: where, "__name__": __name__})


def _copy(node: ast.expr) -> ast.expr:
    """Return a copy of a tree in which no node occurs twice."""
    return ast.parse(ast.unparse(ast.fix_missing_locations(node)), mode="eval").body


class _Numpy(ast.NodeTransformer):
    """Replace names by expressions, and functions by those of numpy."""

    def __init__(self, names: Mapping[str, ast.expr]):
        self.names = names

    def visit_Name(self, node: ast.Name) -> ast.expr:
        """Return the expression of a variable or parameter."""
        return _copy(self.names[node.id])

    def visit_BinOp(self, node: ast.BinOp) -> ast.expr:
        """Return a power as products and a square root, which are faster, if it is one."""
        node = ast.BinOp(self.visit(node.left), node.op, self.visit(node.right))
        exponent = _value(node.right)
        if not isinstance(node.op, ast.Pow) or exponent is None:
            return node
        doubled = 2 * exponent
        if doubled != int(doubled) or abs(doubled) > MOST_HALVES:
            return node
        factors = [node.left] * (abs(int(doubled)) // 2)
        if doubled % 2:
            factors.append(ast.Call(_of_numpy("sqrt"), [node.left], []))
        product: ast.expr = factors.pop() if factors else ONE
        for factor in factors:
            product = ast.BinOp(product, ast.Mult(), factor)
        return product if doubled > 0 else ast.BinOp(ONE, ast.Div(), product)

    def visit_Call(self, node: ast.Call) -> ast.expr:
        """Return the call of the function of numpy."""
        name = node.func.id  # type: ignore[attr-defined]
        args = [self.visit(each) for each in node.args]
        if name == "step":
            name, args = WHERE, [ZERO, args[0], ZERO, ONE]
        if name == WHERE:
            return call(WHERE, *args)
        return ast.Call(_of_numpy(NUMPY.get(name, name)), args, [])


def _of_numpy(name: str) -> ast.expr:
    return ast.Attribute(ast.Name("np", ast.Load()), name, ast.Load())


def kinks_of(tree: ast.expr) -> Iterator[tuple[ast.expr, ast.expr]]:
    """Yield for each kink an expression that is 0 there, and the jump from branch to branch."""
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call):
            continue
        name = node.func.id  # type: ignore[attr-defined]
        first = node.args[0]
        if name in ("min", "max"):
            branches = first, node.args[1]
            place: ast.expr = ast.BinOp(first, ast.Sub(), node.args[1])
        elif name in ("abs", "step"):
            branches = (first, negative(first)) if name == "abs" else (ONE, ZERO)
            place = first
        else:
            continue
        yield place, difference(*(_Replaced(node, branch).visit(tree) for branch in branches))


def difference(a: ast.expr, b: ast.expr) -> ast.expr:
    """Return a - b of two formulas that differ in one part, without cancellation of the rest."""
    if ast.dump(a) == ast.dump(b):
        return ZERO
    if isinstance(a, ast.BinOp) and isinstance(b, ast.BinOp) and type(a.op) is type(b.op):
        left, right = difference(a.left, b.left), difference(a.right, b.right)
        match a.op:
            case ast.Add():
                return plus(left, right)
            case ast.Sub():
                return plus(left, times(ast.Constant(-1.0), right))
            case ast.Mult():
                return plus(times(left, a.right), times(b.left, right))
            case ast.Div() if _value(right) == 0:
                return ast.BinOp(left, ast.Div(), a.right)
    return ast.BinOp(a, ast.Sub(), b)


class _Replaced(ast.NodeTransformer):
    """Replace one node of a tree, without a change of the tree itself."""

    def __init__(self, old: ast.expr, new: ast.expr):
        self.old = old
        self.new = new

    def generic_visit(self, node: ast.AST) -> ast.AST:
        """Return the node with changed parts, or the new one."""
        if node is self.old:
            return self.new
        parts = {name: self._changed(value) for name, value in ast.iter_fields(node)}
        return type(node)(**parts)

    def _changed(self, value: Any) -> Any:
        if isinstance(value, list):
            return [self.visit(each) for each in value]
        return self.visit(value) if isinstance(value, ast.AST) else value


def canonical(tree: ast.expr) -> str:
    """Return the text of a checked formula in one spelling, which parses to the same tree."""
    return ast.unparse(ast.fix_missing_locations(tree))
