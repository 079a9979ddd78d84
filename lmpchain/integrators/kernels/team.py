"""Threads that share a chain: their grains, and the points at which they synchronise, compiled.

All threads run the same march. Each thread has its own copy of the state, and all copies have the
same values. Loops over grains are divided between the threads, and `meet` synchronises the threads
before one of them reads values that another one has written.
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

# Number of polls, some microseconds, before a waiting thread yields its core.
LOOKS_BEFORE_YIELD = 4000
_INT64 = ir.IntType(64)


def _place(context: Any, builder: Any, kind: Any, gate: Any, index: Any) -> Any:
    return builder.gep(arrayobj.make_array(kind)(context, builder, gate).data, [index])


@llvm
def _count_arrival(typing: Any, gate: Any) -> Any:
    """Add 1 to gate[0] atomically and return its previous value."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        place = _place(context, builder, signature.args[0], args[0], ir.Constant(_INT64, 0))
        return builder.atomic_rmw("add", place, ir.Constant(_INT64, 1), "seq_cst")

    return types.int64(gate), generate


@llvm
def _load(typing: Any, gate: Any, index: Any) -> Any:
    """Return the current value of gate[index] by an atomic load."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        place = _place(context, builder, signature.args[0], args[0], args[1])
        return builder.load_atomic(place, "seq_cst", 8, typ=_INT64)

    return types.int64(gate, types.int64), generate


@llvm
def _yield_core(typing: Any) -> Any:
    """Yield the core to other threads."""

    def generate(context: Any, builder: Any, _signature: Any, _args: Any) -> Any:
        # Windows has no `sched_yield`; a waiting thread continues to poll there.
        if hasattr(os, "sched_yield"):
            kind = ir.FunctionType(ir.IntType(32), [])
            builder.call(cgutils.get_or_insert_function(builder.module, kind, "sched_yield"), [])
        return context.get_dummy_value()

    return types.void(), generate


@compiled
def _wait(team):
    """Wait until all threads of the team have arrived, or one has failed."""
    # Arrivals are never reset, so the goal is the next multiple of the number of threads.
    goal = (_count_arrival(team.gate) // team.parts + 1) * team.parts
    looks = 0
    while _load(team.gate, 0) < goal and _load(team.gate, GIVEN_UP) == 0:
        looks += 1
        if looks > LOOKS_BEFORE_YIELD:
            _yield_core()


@inlined
def meet(team):
    """Wait until all threads of a team have arrived."""
    if team.parts > 1:
        _wait(team)


@compiled
def largest(team, value):
    """Return the largest of the values of all threads, on each of them."""
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
    """Return the first grain of the window that belongs to this thread, and the one after its last.

    Both are equal if the thread has no grains. Short windows are processed by fewer threads.
    """
    first = chain.state.first
    last = chain.state.last
    team = chain.team
    if team.parts == 1:
        return first, last
    # More threads would spend more time waiting than working.
    shares = max(1, min(team.parts, (last - first) // LEAST_SHARE))
    part = min(team.part, shares)
    lines = (last - first) // PAD
    begin = first + lines * part // shares * PAD if part < shares else last
    end = first + lines * (part + 1) // shares * PAD if part + 1 < shares else last
    return begin, end
