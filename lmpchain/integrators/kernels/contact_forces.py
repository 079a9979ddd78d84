"""The force of a contact, compiled: its forms, and the two loops that are made of each.

Every form gives the force minus what the contact carries at rest, ``strength f(r / length)``, where
``r = phi_n - phi_(n+1)`` is how much closer the two bodies are than at rest. `precompressed` is the
overlap at rest over the length: 1, or 0 where nothing is pressed (length 1 m, strength K).
`coefficients` are the first seven of the binomial series of (1 + s)^delta - 1, and delta.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from enum import IntEnum
from functools import cache, partial
from typing import Any, NamedTuple

import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from ...util.compilation import Ingredient, compiled_once
from .layout import Links, Rows

# no reordering and no contraction but the explicit fma: every blocking of the loops gives the same
# bits
STRICT = {"nnan", "ninf", "nsz"}
# functions that are called from Python, and kept for later processes
compiled_engine = partial(compiled_once, "the native engine", 10, error_model="numpy")
# these make no arrays, either: Python does
compiled_filler = partial(compiled_engine, _nrt=False)
compiled_march = partial(compiled_filler, nogil=True, fastmath=STRICT)
llvm: Any = intrinsic  # to a type checker it takes the arguments of the compiled function

# without numba's runtime: such functions make no arrays and count no references, which would take
# half of the time; nor can Python call them
_OPTIONS: dict[str, Any] = {
    "error_model": "numpy",
    "fastmath": STRICT,
    "_nrt": False,
    "no_cpython_wrapper": True,
    "no_cfunc_wrapper": True,
    "pipeline_class": Ingredient,
}
compiled = numba.njit(**_OPTIONS)
# inlined functions take records of arrays for nothing, of which a call would copy every field; LLVM
# puts them in place, in a tenth of the time that numba takes for it
inlined = numba.njit(**_OPTIONS, forceinline=True)
# sums of many numbers in any order, that is several at a time: their bits depend on the count alone
summed = numba.njit(**_OPTIONS | {"fastmath": {*STRICT, "reassoc"}})
# numba does so for what returns arrays, which a call would have to count, or a record, which none
# can, and for steps, which are long and called in one place, so that they are compiled once
pasted = numba.njit(**_OPTIONS, inline="always")


@llvm
def fma(typing: Any, a: Any, b: Any, c: Any) -> Any:
    """Return a b + c, rounded once, whatever the loop around is compiled to."""
    return types.float64(
        types.float64, types.float64, types.float64
    ), lambda _c, builder, _s, args: builder.fma(*args)


@llvm
def bits(typing: Any, x: Any) -> Any:
    """Return the bits of a number as a whole number."""
    return types.int64(types.float64), lambda _c, builder, _s, args: builder.bitcast(
        args[0], ir.IntType(64)
    )


@llvm
def number(typing: Any, n: Any) -> Any:
    """Return the number with these bits."""
    return types.float64(types.int64), lambda _c, builder, _s, args: builder.bitcast(
        args[0], ir.DoubleType()
    )


@llvm
def apart(typing: Any) -> Any:
    """Tell the compiler that no two arrays that a function takes overlap."""

    def mark(context: Any, builder: Any, _signature: Any, _args: Any) -> Any:
        for arg in builder.function.args[2:]:
            if arg.type.is_pointer:
                arg.add_attribute("noalias")
        return context.get_dummy_value()

    return types.void(), mark


@llvm
def select(typing: Any, condition: Any, a: Any, b: Any) -> Any:
    """Return a where the condition holds, else b, without a branch in any version of Python.

    What 3.13 makes of ``a if condition else b`` keeps loops from vector instructions: powers take
    six times as long.
    """
    return types.float64(
        types.boolean, types.float64, types.float64
    ), lambda _c, builder, _s, args: builder.select(*args)


class Bits(NamedTuple):
    """Parts of a double: 1 bit of sign, 11 of its exponent plus 1023, and 52 of its mantissa.

    Attributes
    ----------
    mantissa, one : int
        A mantissa of ones; the bits of 1.
    shift : float
        Adding it to a number rounds that to a whole one, which the last bits then hold.
    shift_bits, power_bits : int
        The bits of `shift`, and of 2^52: an exponent in the last bits of these adds that to 2^52.
    power_zero : float
        2^52 with the exponent of 1.
    high, low : float
        Their sum is ln 2 to 33 more digits.
    """

    mantissa: int = (1 << 52) - 1
    one: int = 1023 << 52
    shift: float = float(3 << 51)
    shift_bits: int = int(np.float64(3 << 51).view(np.int64))
    power_bits: int = int(np.float64(1 << 52).view(np.int64))
    power_zero: float = float((1 << 52) + 1023)
    high: float = 0.6931471803691238
    low: float = 1.9082149292705877e-10


BITS = Bits()


@compiled
def logarithm(y, rest):
    """Return log(y + rest) of y > 0 and a tiny rest, by the series of artanh, without a branch."""
    pattern = bits(y)
    power = number(BITS.power_bits | (pattern >> 52)) - BITS.power_zero
    m = number((pattern & BITS.mantissa) | BITS.one)
    # the mantissa around 1, from sqrt(1/2) to sqrt(2), where the series is shortest
    high = m > 1.4142135623730951
    m = 0.5 * m if high else m
    power = power + 1.0 if high else power
    f = (m - 1.0) / (m + 1.0)
    q = f * f
    p = fma(q, fma(q, fma(q, fma(q, 2 / 21, 2 / 19), 2 / 17), 2 / 15), 2 / 13)
    p = q * fma(q, fma(q, fma(q, fma(q, fma(q, p, 2 / 11), 2 / 9), 2 / 7), 2 / 5), 2 / 3)
    return fma(power, BITS.high, fma(power, BITS.low, fma(f, p, rest / y)) + 2.0 * f)


@compiled
def exponential(t, less):
    """Return exp(t) - less, less = 0 or 1, |t| < 700, by powers of two and a Taylor series."""
    # t = power ln 2 + r, |r| < ln 2 / 2, by 1 / ln 2
    power = fma(t, 1.4426950408889634, BITS.shift)
    scale = number((bits(power) - BITS.shift_bits + 1023) << 52)
    power -= BITS.shift
    r = fma(-power, BITS.low, fma(-power, BITS.high, t))
    p = fma(
        r,
        fma(
            r,
            fma(r, fma(r, fma(r, 1 / 6227020800, 1 / 479001600), 1 / 39916800), 1 / 3628800),
            1 / 362880,
        ),
        1 / 40320,
    )
    p = fma(r, fma(r, fma(r, fma(r, fma(r, p, 1 / 5040), 1 / 720), 1 / 120), 1 / 24), 1 / 6)
    p = fma(r * r, fma(r, p, 0.5), r)
    return fma(scale, p, scale - less)


@compiled
def _corrected(r, inverse_length, strength, precompressed, coefficients):
    """delta = 3/2 without cancellation: relative accuracy at any amplitude for one square root."""
    s = r * inverse_length
    s = s if s > -1.0 else -1.0
    u = math.sqrt(1.0 + s) - 1.0
    # one step of Newton's method gives back the digits that 1 + s lost
    u = fma(0.5, fma(-u, u, fma(-2.0, u, s)), u)
    return (strength * u) * fma(u, 3.0 + u, 3.0)


@compiled
def _polynomial(r, inverse_length, strength, precompressed, coefficients):
    """Any delta while |s| is small enough for seven binomial terms; no contact may open."""
    s = r * inverse_length
    p = fma(s, fma(s, fma(s, coefficients[6], coefficients[5]), coefficients[4]), coefficients[3])
    return (strength * s) * fma(
        s, fma(s, fma(s, p, coefficients[2]), coefficients[1]), coefficients[0]
    )


@compiled
def _spring(r, inverse_length, strength, precompressed, coefficients):
    """delta = 1: linear until the contact opens."""
    s = r * inverse_length
    return strength * (s if s > -precompressed else -precompressed)


@compiled
def _power(r, inverse_length, strength, precompressed, coefficients):
    """Any delta without cancellation."""
    s = r * inverse_length
    # an open contact is computed as one at rest and its value thrown away: a branch would keep the
    # compiler from making vector instructions
    inside = select(s > -1.0, s, 0.0)
    y = 1.0 + inside
    change = exponential(coefficients[7] * logarithm(y, inside - (y - 1.0)), 1.0)
    return strength * select(s > -1.0, change, -1.0)


@compiled
def _uncompressed_power(r, inverse_length, strength, precompressed, coefficients):
    """Any delta where nothing is pressed."""
    # the logarithm of 0 is none, and so small an overlap gives no force that matters
    y = select(r > 1e-90, r, 1.0)
    power = exponential(coefficients[7] * logarithm(y, 0.0), 0.0)
    return select(r > 1e-90, strength * power, 0.0)


def _roots(quarters: int) -> Callable[..., Any]:
    """Return the force for delta = quarters / 4, y^delta - precompressed, by square roots alone."""
    factors = quarters // 4
    half = quarters % 4 // 2
    quarter = quarters % 2

    @compiled
    def force(r, inverse_length, strength, precompressed, coefficients):
        y = fma(r, inverse_length, precompressed)
        y = y if y > 0.0 else 0.0
        product = strength
        for _ in range(factors):
            product = product * y
        root = math.sqrt(y) if half + quarter > 0 else 1.0
        fraction = root if half > 0 else 1.0
        if quarter > 0:
            fraction = fraction * math.sqrt(root)
        return fma(product, fraction, -(strength * precompressed))

    return force


@compiled
def touching(r, uncompressed, coefficients):
    """Return the force of a first contact that only touches, in a chain that is pressed."""
    return uncompressed * r ** coefficients[7] if r > 0.0 else 0.0


_ROW = types.float64[::1]
_LINKS = types.NamedTuple(
    [_ROW, _ROW, types.float64, types.int64, types.int64[::1], types.float64, _ROW], Links
)
_ROWS = types.NamedUniTuple(_ROW, len(Rows._fields), Rows)
# what the two loops of a form take; they return nothing
FORCES = types.void(_ROW, _ROW, _LINKS)
SWEEP = types.void(_ROW, _ROW, _ROW, _LINKS, _ROWS, types.boolean, types.int64, types.boolean)


def _loops(form: int, force: Callable[..., Any]) -> tuple[Any, Any]:
    """Make the two loops over contacts that are all of Eq. (1), for one form of the force.

    They are compiled when a scene needs the form, apart from the marches, which call them where
    `addresses` says.
    """
    kept = compiled_filler(fastmath=STRICT, kind=str(int(form)))

    @kept
    def forces(out, x, links):
        """Fill out (C,) with the force of every contact between the bodies x (C+1,), N."""
        il = links.inverse_length
        st = links.strength
        pressed = links.precompressed
        for n in range(out.size):
            out[n] = force(x[n] - x[n + 1], il[n], st[n], pressed, links.coefficients)

    @kept
    def sweep_rows(x, v, inverse_mass, links, rows, top, body, forced):
        """Kick and drift all grains once a row, in one pass: each contact's force is found once.

        x (G+2,) has a body more at either end than v (G,); contacts n = 0 ... G lie between x[n]
        and x[n+1]. The force on the first grain from above is that of contact 0 if it is the `top`,
        else the one that is carried, in whose place the force below the last grain is left for the
        part of the chain that follows. What is imposed, if anything is, is where the body x[body]
        of the `top` is, or a force on it if it is `forced` and among those that move.
        """
        il = links.inverse_length
        st = links.strength
        pressed = links.precompressed
        coefficients = links.coefficients
        for row in range(rows.kick.size):
            kick = rows.kick[row]
            drift = rows.drift[row]
            # the one that is pushed may lie in another tile
            if rows.path.size > 0:
                if forced:
                    if 1 <= body <= v.size:
                        push = kick * inverse_mass[body - 1]
                        v[body - 1] = fma(push, rows.path[row], v[body - 1])
                elif top:
                    x[body] = rows.path[row]
            above = rows.carried[row]
            if top:
                above = 0.0
                if st[0] > 0.0:
                    above = force(x[0] - x[1], il[0], st[0], pressed, coefficients)
                if links.uncompressed > 0.0:
                    above += touching(x[0] - x[1], links.uncompressed, coefficients)
            # a kick takes the forces at one time: a grain moves when both of its contacts are known
            for n in range(v.size):
                below = force(x[n + 1] - x[n + 2], il[n + 1], st[n + 1], pressed, coefficients)
                faster = fma(kick, inverse_mass[n] * (above - below), v[n])
                v[n] = faster
                x[n + 1] = fma(drift, faster, x[n + 1])
                above = below
            rows.carried[row] = above

    return forces, sweep_rows


class Form(IntEnum):
    """Forms of the force of a contact; those of ROOTS are others."""

    CORRECTED = 0
    POLYNOMIAL = 1
    SPRING = 2
    POWER = 3
    UNCOMPRESSED_POWER = 4


ROOTS = range(5, 9)  # forms of delta = quarters / 4
FORMS: dict[int, tuple[str, Callable[..., Any]]] = {
    Form.CORRECTED: ("corrected square root", _corrected),
    Form.POLYNOMIAL: ("polynomial", _polynomial),
    Form.SPRING: ("spring", _spring),
    Form.POWER: ("vectorised power", _power),
    Form.UNCOMPRESSED_POWER: ("vectorised power", _uncompressed_power),
} | {form: ("plain square roots", _roots(form)) for form in ROOTS}
LOOPS = {form: _loops(form, force) for form, (_, force) in FORMS.items()}


@cache
def addresses(form: int) -> tuple[int, ...]:
    """Return where the two loops of a form lie in memory, once they are compiled."""
    forces, sweep_rows = LOOPS[form]
    return address_of(forces, FORCES), address_of(sweep_rows, SWEEP)


def address_of(function: Any, signature: Any) -> int:
    """Return where a function lies in memory, once it is compiled for this signature."""
    function.compile(signature)
    code = function.overloads[signature.args]
    return code.library.get_pointer_to_function(code.fndesc.llvm_func_name)


def caller(signature: Any) -> Any:
    """Make the function that calls a compiled one of this signature at an address."""

    @llvm
    def call(typing: Any, address: Any, arguments: Any) -> Any:
        def generate(context: Any, builder: Any, _signature: Any, args: Any) -> Any:
            convention = context.call_conv
            values = [
                context.cast(builder, value, given, taken)
                for value, given, taken in zip(
                    cgutils.unpack_tuple(builder, args[1]), arguments, signature.args, strict=True
                )
            ]
            returned = signature.return_type
            function = convention.get_function_type(returned, signature.args)
            place = builder.inttoptr(args[0], function.as_pointer())
            _, result = convention.call_function(builder, place, returned, signature.args, values)
            return result

        return signature.return_type(types.int64, arguments), generate

    return call


_call_forces = caller(FORCES)
_call_sweep = caller(SWEEP)


@inlined
def contact_forces(links, out, x):
    """Fill out (C,) with the force of every contact between the bodies x (C+1,), N."""
    _call_forces(links.loops[0], (out, x, links))


@inlined
def kick_and_drift(links, x, v, inverse_mass, rows, top, body, forced):
    """Kick and drift all grains once a row, as `sweep_rows` says."""
    _call_sweep(links.loops[1], (x, v, inverse_mass, links, rows, top, body, forced))


def by_form(loops: dict[int, Callable[..., Any]]) -> Callable[..., Any]:
    """Make the function of a form, and of what its loop takes, that runs the loop of that form.

    A dictionary of functions cannot be compiled: the choice is made of comparisons, one in another.
    """
    *first_forms, (_, last) = loops.items()

    @pasted
    def choose(form, arguments):
        return last(*arguments)

    for form, loop in first_forms:
        choose = _choose_form(int(form), loop, choose)

    @compiled
    def run(form, *arguments):
        return choose(form, arguments)

    return run


def _choose_form(
    number: int, loop: Callable[..., Any], choose: Callable[..., Any]
) -> Callable[..., Any]:
    """Make the function that runs a loop if the form is its own, and else looks further."""

    @pasted
    def choose_form(form, arguments):
        if form == number:
            return loop(*arguments)
        return choose(form, arguments)

    return choose_form
