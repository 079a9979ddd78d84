"""Compilation of the kernels: options, instructions that numba lacks, calls by address."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from ...util.compilation import Ingredient, compiled_once

# Neither reordering nor contraction is allowed except for the explicit fma, so that every blocking
# of the loops gives the same bits.
STRICT = {"nnan", "ninf", "nsz"}
# Functions called from Python that are cached for later processes.
compiled_engine = partial(compiled_once, "the native engine", 10, error_model="numpy")
# These functions create no arrays either; Python creates them.
compiled_filler = partial(compiled_engine, _nrt=False)
compiled_march = partial(compiled_filler, nogil=True, fastmath=STRICT)
llvm: Any = intrinsic  # The type `Any` allows the arguments of the compiled function.

# These functions work without numba's runtime: they create no arrays and count no references, which
# would take half of the time. Python cannot call them.
_OPTIONS: dict[str, Any] = {
    "error_model": "numpy",
    "fastmath": STRICT,
    "_nrt": False,
    "no_cpython_wrapper": True,
    "no_cfunc_wrapper": True,
    "pipeline_class": Ingredient,
}
compiled = numba.njit(**_OPTIONS)
# Formulas of users may divide by 0 or overflow in a branch that is not taken.
compiled_formula = numba.njit(**_OPTIONS | {"fastmath": False})
# Inlined functions receive records of arrays at no cost, whereas a call would copy every field.
# LLVM inlines them in a tenth of the time that numba needs.
inlined = numba.njit(**_OPTIONS, forceinline=True)
# Sums of many numbers may be evaluated in any order, several at a time; their bits depend only on
# the count.
summed = numba.njit(**_OPTIONS | {"fastmath": {*STRICT, "reassoc"}})
# Numba itself inlines functions that return arrays or records, which a call without the runtime
# cannot, and steps, which are long and called in one place, so that they are compiled once.
pasted = numba.njit(**_OPTIONS, inline="always")


@llvm
def fma(typing: Any, a: Any, b: Any, c: Any) -> Any:
    """Return a b + c, rounded once, independent of the compiler options of the surrounding loop."""
    return types.float64(
        types.float64, types.float64, types.float64
    ), lambda _c, builder, _s, args: builder.fma(*args)


@llvm
def bits(typing: Any, x: Any) -> Any:
    """Return the bits of a number as an integer."""
    return types.int64(types.float64), lambda _c, builder, _s, args: builder.bitcast(
        args[0], ir.IntType(64)
    )


@llvm
def number(typing: Any, n: Any) -> Any:
    """Return the number that has these bits."""
    return types.float64(types.int64), lambda _c, builder, _s, args: builder.bitcast(
        args[0], ir.DoubleType()
    )


@llvm
def apart(typing: Any) -> Any:
    """Declare to the compiler that the array arguments of a function do not overlap."""

    def mark(context: Any, builder: Any, _signature: Any, _args: Any) -> Any:
        for arg in builder.function.args[2:]:
            if arg.type.is_pointer:
                arg.add_attribute("noalias")
        return context.get_dummy_value()

    return types.void(), mark


@llvm
def select(typing: Any, condition: Any, a: Any, b: Any) -> Any:
    """Return a if the condition is true, else b, without a branch in any version of Python.

    Python 3.13 compiles ``a if condition else b`` to code that prevents vector instructions in
    loops, so that powers would take six times as long.
    """
    return types.float64(
        types.boolean, types.float64, types.float64
    ), lambda _c, builder, _s, args: builder.select(*args)


class Bits(NamedTuple):
    """Parts of a double: 1 bit of sign, 11 of its exponent plus 1023, and 52 of its mantissa.

    Attributes
    ----------
    mantissa : int
        Mask of the 52 bits of the mantissa.
    one : int
        Bit pattern of the number 1.
    shift : float
        Number 3 * 2^51. Adding it to a smaller number rounds that number to an integer, which is
        then in the last bits of the sum.
    shift_bits : int
        Bit pattern of `shift`.
    power_bits : int
        Bit pattern of 2^52. An integer n in its last bits gives the number 2^52 + n.
    power_zero : float
        Number 2^52 + 1023, where 1023 is the biased exponent of 1.
    high : float
        ln 2 with a mantissa that ends in zeros, so that its product with an exponent is exact.
    low : float
        Remainder of ln 2: the sum of `high` and `low` has 33 more bits than a double.
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
    """Return log(y + rest) for y > 0 and a tiny rest, by the series of artanh, without a branch."""
    pattern = bits(y)
    power = number(BITS.power_bits | (pattern >> 52)) - BITS.power_zero
    m = number((pattern & BITS.mantissa) | BITS.one)
    # The mantissa is between sqrt(1/2) and sqrt(2), where the series is shortest.
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
    # Here t = power ln 2 + r with |r| < ln 2 / 2.
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


def address_of(function: Any, signature: Any) -> int:
    """Return the memory address of a function, compiled for this signature."""
    function.compile(signature)
    code = function.overloads[signature.args]
    return code.library.get_pointer_to_function(code.fndesc.llvm_func_name)


def caller(signature: Any) -> Any:
    """Create a function that calls a compiled function of this signature at an address."""

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


def by_form(loops: dict[int, Callable[..., Any]]) -> Callable[..., Any]:
    """Create a function of a force form and arguments that runs the loop of this form.

    A dictionary of functions cannot be compiled. The returned function therefore compares the form
    with each key in turn.
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
    """Create a function that runs a loop if the form matches, and else tries the next loop."""

    @pasted
    def choose_form(form, arguments):
        if form == number:
            return loop(*arguments)
        return choose(form, arguments)

    return choose_form
