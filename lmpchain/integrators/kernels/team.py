"""Threads that share a chain: which grains are whose, and where they wait for each other, compiled.

All run the same march, each with a state of its own that goes through the same values; only loops
over grains are those of a thread, and `meet` stands where one goes on with what another has
written.
"""

from __future__ import annotations

import os
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.np import arrayobj

from .compiling import compiled, inlined, llvm
from .layout import GIVEN_UP, LEAST_SHARE, PAD

# looks for the others, some microseconds, before the core is offered to whoever wants it
LOOKS_BEFORE_YIELD = 4000
_INT64 = ir.IntType(64)


def _place(context: Any, builder: Any, kind: Any, gate: Any, index: Any) -> Any:
    return builder.gep(arrayobj.make_array(kind)(context, builder, gate).data, [index])


@llvm
def _count_in(typing: Any, gate: Any) -> Any:
    """Add 1 to gate[0] and return what it was, at once for all threads."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        place = _place(context, builder, signature.args[0], args[0], ir.Constant(_INT64, 0))
        return builder.atomic_rmw("add", place, ir.Constant(_INT64, 1), "seq_cst")

    return types.int64(gate), generate


@llvm
def _seen(typing: Any, gate: Any, index: Any) -> Any:
    """Return gate[index] as it is in memory now."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        place = _place(context, builder, signature.args[0], args[0], args[1])
        return builder.load_atomic(place, "seq_cst", 8, typ=_INT64)

    return types.int64(gate, types.int64), generate


@llvm
def _stand_back(typing: Any) -> Any:
    """Offer the core to other threads."""

    def generate(context: Any, builder: Any, _signature: Any, _args: Any) -> Any:
        # Windows has none: there the thread goes on looking
        if hasattr(os, "sched_yield"):
            kind = ir.FunctionType(ir.IntType(32), [])
            builder.call(cgutils.get_or_insert_function(builder.module, kind, "sched_yield"), [])
        return context.get_dummy_value()

    return types.void(), generate


@compiled
def _wait(team):
    """Wait until all threads are here, or one has given up."""
    # arrivals are never reset: the goal is the next multiple of the number of threads
    goal = (_count_in(team.gate) // team.parts + 1) * team.parts
    looks = 0
    while _seen(team.gate, 0) < goal and _seen(team.gate, GIVEN_UP) == 0:
        looks += 1
        if looks > LOOKS_BEFORE_YIELD:
            _stand_back()


@inlined
def meet(team):
    """Wait until all threads of a team are here."""
    if team.parts > 1:
        _wait(team)


@compiled
def largest(team, value):
    """Return the largest of the values of all threads, to each of them."""
    if team.parts == 1:
        return value
    team.nearness[team.part, 0] = value
    meet(team)
    value = team.nearness[0, 0]
    for part in range(1, team.parts):
        value = max(value, team.nearness[part, 0])
    return value


@inlined
def share(chain):
    """Return the first grain of the window that is this thread's, and the one behind its last.

    There is none if they agree. A short window is left to the first thread.
    """
    first = chain.state.first
    last = chain.state.last
    team = chain.team
    if team.parts == 1:
        return first, last
    # threads beyond that would wait longer than they work
    shares = max(1, min(team.parts, (last - first) // LEAST_SHARE))
    part = min(team.part, shares)
    lines = (last - first) // PAD
    begin = first + lines * part // shares * PAD if part < shares else last
    end = first + lines * (part + 1) // shares * PAD if part + 1 < shares else last
    return begin, end
