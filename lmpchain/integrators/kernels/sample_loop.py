"""The loop over chains and samples that every compiled march is: made for the steps of a method."""

from __future__ import annotations

import math
from collections.abc import Callable

from .contact_forces import compiled, inlined
from .layout import Chain, Clock, Row, Span
from .window import record

# of the time between two landings: shorter steps would not move the clock, and there would be too many to be counted
SHORTEST = 2.0**-50


@inlined
def _chain(chains, real, schedule):
    """Return one chain of a batch, as a schedule moves it."""
    table, row = chains.table[real], schedule * chains.omega.size + real
    return Chain(
        chains.x[row], chains.v[row], chains.history[row], chains.state[row], table[0], table[1], table[2],
        chains.uncompressed[real], chains.scale[real], chains.omega[real], chains.forms[real], chains.precompressed,
        chains.coefficients, chains.imposed, chains.acted[real], chains.drive[real], chains.knots[real],
        chains.pieces[real], chains.team, real, schedule,
    )  # fmt: skip


@inlined
def clock_of(clocks, schedule):
    """Return the clock of a schedule."""
    own = clocks.others[schedule]
    return Clock(
        clocks.interval, clocks.final, int(own[0]), own[1], int(own[2]), own[3] > 0, int(own[4])
    )


@inlined
def _row(fields, real, schedule):
    """Return where the samples of a chain go."""
    if schedule == 0:
        return Row(fields.u[real], fields.v[real], fields.first)
    return Row(
        fields.others_u[schedule - 1, real], fields.others_v[schedule - 1, real], fields.first
    )


@inlined
def _as_it_is(chain, method, work, clock, span, out):
    """At a landing nothing is left to do."""


@inlined
def end_of_step(chain, span, left, step):
    """Return `state.done` after a step of at most this length, one of equal ones in the time left.

    The step to take is the difference to `state.done`, not `step`: all steps together then are the span, exactly.
    """
    done = chain.state.done
    steps = max(1, math.ceil(left / max(step, SHORTEST * span.length) - 1e-9))
    return span.length if steps == 1 and left == span.length - done else done + left / steps


def sample_loop(
    advance: Callable[..., int], counted: bool, land: Callable[..., None] = _as_it_is
) -> Callable[..., int]:
    """Make the march of a method from its steps.

    The march moves chains by every schedule to the sample `until`, or stops when some `max_steps` steps are made
    altogether: how the steps are shared out over calls makes no difference to the last bit.

    Parameters
    ----------
    advance : function of (chain, method, work, clock, span, out)
        Takes one step or a burst of them, updates `state.done` and returns how many.
    counted : bool
        Whether `state.done` counts steps, else seconds since the last landing.
    land : function of (chain, method, work, clock, span, out)
        Completes positions and velocities at a landing.

    Returns
    -------
    function of (chains, method, work, clocks, fields, begin, end, until, max_steps)
        Of `Chains`, what the method needs beside them, arrays to work in, `Clocks` and `Fields`; moves the chains from
        begin to end - 1 and returns the steps made. The `march` of a method's module, which is kept for later
        processes, makes the arrays to work in and calls it.
    """

    @compiled
    def march(chains, method, work, clocks, fields, begin, end, until, max_steps):
        done, size = 0, end - begin
        for each in range(size * clocks.others.shape[0]):
            schedule, real = each // size, begin + each % size
            chain, clock, out = (
                _chain(chains, real, schedule),
                clock_of(clocks, schedule),
                _row(fields, real, schedule),
            )
            state = chain.state
            while state.sample < until and done < max_steps:
                sample = state.sample
                landing = min(sample + clock.stride, clock.final)
                length = (landing - sample) * clock.interval
                steps = (clock.steps * (landing - sample) + clock.stride - 1) // clock.stride
                span = Span(
                    sample * clock.interval, landing * clock.interval, length, steps, length / steps
                )
                goal = float(steps) if counted else length
                while state.done < goal and done < max_steps:
                    made = advance(chain, method, work, clock, span, out)
                    state.steps += made
                    done += made
                if state.done == goal:
                    land(chain, method, work, clock, span, out)
                    record(chain, span.end, out.u[landing - out.first], out.v[landing - out.first])
                    state.sample, state.done = landing, 0.0
        return done

    return march
