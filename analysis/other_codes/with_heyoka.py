"""heyoka: Taylor series of high order, compiled for one scene and tolerance.

Its step control does not see a contact that is about to close, and steps over it. So each of the
top contacts can be guarded: events switch its force off when it opens and on again when it closes.
The force is not analytic there, so the switch is put at a force of 1e-7^1.5 of that at rest, where
it changes nothing that doubles can hold.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache, partial
from itertools import pairwise
from time import perf_counter
from typing import Any

import heyoka as hy
from problem import Answer, Code, Problem

from lmpchain import RunFailed

# Number of guarded contacts from the top (three open in the strong scene), and 1 + s at an event.
GUARDED = 8
SWITCH = 1e-7
ORDERS = 3, 4, 5, 6, 8, 10, 12, 14, 16, 18
INLINED_GRAINS = 200  # Longer chains would take too long to compile to straight-line code.
# Strike number below which (1 + s)^(3/2) - 1 loses too many digits for the tightest tolerances.
WEAK = 0.1


def _tolerance(order: int) -> float:
    """Return the loosest tolerance for which heyoka chooses this order."""
    return math.exp(-2 * (order - 1)) * 1.0001


def _change(s: Any, careful: bool) -> Any:
    if careful:
        u = s / (1.0 + hy.sqrt(1.0 + s))
        return u * (3.0 + u * (3.0 + u))
    return (1.0 + s) ** 1.5 - 1.0


@lru_cache(maxsize=1)
def _integrator(problem: Problem, tolerance: float, guarded: int, inlined: bool) -> Any:
    closer = problem.closer.tolist()
    strength = problem.strength.tolist()
    count = len(closer)
    x = [*hy.make_vars(*(f"x{n}" for n in range(count))), 0.0]
    v = hy.make_vars(*(f"v{n}" for n in range(count)))
    s = [(above - below) * c for (above, below), c in zip(pairwise(x), closer, strict=True)]
    careful = problem.scene.strike_number < WEAK and tolerance < 1e-10
    shut = [hy.par[n] if n < guarded else 1.0 + each for n, each in enumerate(s)]
    changes = [
        hy.select(hy.gt(what, 0.0), _change(each, careful), -1.0)
        for what, each in zip(shut, s, strict=True)
    ]
    force = [0.0, *(k * change for k, change in zip(strength, changes, strict=True))]
    gains = [above - below for above, below in pairwise(force)]
    system = [*zip(x[:-1], v, strict=True), *zip(v, gains, strict=True)]
    events = [hy.t_event(1.0 + s[n] - SWITCH, callback=_switch(n)) for n in range(guarded)]
    return hy.taylor_adaptive(system, problem.start, tol=tolerance, compact_mode=not inlined,
                              fast_math=True,
                              pars=[1.0] * guarded, t_events=events)  # fmt: skip


def _switch(contact: int) -> Callable[[Any, int], bool]:
    def callback(integrator: Any, sign: int) -> bool:
        integrator.pars[contact] = float(sign > 0)
        return True

    return callback


def _solve(guarded: int, inlined: bool, problem: Problem, tolerance: float) -> Answer:
    integrator = _integrator(problem, tolerance, guarded, inlined)
    integrator.time = 0.0
    integrator.state[:] = problem.start
    if guarded:
        integrator.pars[:] = 1.0
        integrator.reset_cooldowns()
    begin = perf_counter()
    outcome, *_ = integrator.propagate_until(problem.duration)
    seconds = perf_counter() - begin
    if outcome != hy.taylor_outcome.time_limit:
        raise RunFailed(f"heyoka gave up: {outcome}")
    return problem.answer(integrator.state, seconds)


def codes(problem: Problem) -> list[Code]:
    """Return heyoka without and with events.

    It is compiled to straight-line code for short chains, else in compact mode.
    """
    inlined = problem.scene.chain.grains <= INLINED_GRAINS
    tolerances = [_tolerance(order) for order in ORDERS]
    return [
        Code(
            "heyoka" + ", events" * bool(guarded),
            hy.__version__,
            tolerances,
            partial(_solve, guarded, inlined),
        )
        for guarded in (0, min(GUARDED, problem.scene.chain.movable))
    ]
