"""The loop over chains and samples that every compiled march is: made for the steps of a method."""

from __future__ import annotations

import math
from collections.abc import Callable

from .contact_forces import compiled, inlined
from .layout import DONE, SAMPLE, STEPS, Chain, Span
from .window import record

# of the time between two landings: shorter steps would not move the clock, and there would be too many to be counted
SHORTEST = 2.0**-50


@inlined
def _chain(chains, real):
    """Return one chain of a batch."""
    table = chains.table[real]
    return Chain(
        chains.x[real], chains.v[real], chains.history[real], chains.state[real], table[0], table[1], table[2],
        chains.uncompressed[real], chains.scale[real], chains.omega[real], chains.forms[real], chains.precompressed,
        chains.coefficients, chains.imposed, chains.acted[real], chains.drive[real], chains.knots[real],
        chains.pieces[real], chains.team, real,
    )  # fmt: skip


@inlined
def _as_it_is(chain, method, work, clock, span):
    """At a landing nothing is left to do."""


@inlined
def end_of_step(chain, span, left, step):
    """Return `state[DONE]` after a step of at most this length, one of equal ones in the time left.

    The step to take is the difference to `state[DONE]`, not `step`: all steps together then are the span, exactly.
    """
    done = chain.state[DONE]
    steps = max(1, math.ceil(left / max(step, SHORTEST * span.length) - 1e-9))
    return span.length if steps == 1 and left == span.length - done else done + left / steps


def sample_loop(
    advance: Callable[..., int], counted: bool, land: Callable[..., None] = _as_it_is
) -> Callable[..., int]:
    """Make the march of a method from its steps.

    The march moves every chain to the sample `until`, or stops when some `max_steps` steps are made altogether: how
    the steps are shared out over calls makes no difference to the last bit.

    Parameters
    ----------
    advance : function of (chain, method, work, clock, span)
        Takes one step or a burst of them, updates `state[DONE]` and returns how many.
    counted : bool
        Whether `state[DONE]` counts steps, else seconds since the last landing.
    land : function of (chain, method, work, clock, span)
        Completes positions and velocities at a landing.

    Returns
    -------
    function of (chains, method, work, clock, u_out, v_out, offset, until, max_steps)
        Of `Chains`, what the method needs beside them, arrays to work in, a `Clock`, and (R, B, N) arrays for the
        samples from `offset` on; returns the steps made. The `march` of a method's module, which is kept for later
        processes, makes the arrays to work in and calls it.
    """

    @compiled
    def march(chains, method, work, clock, u_out, v_out, offset, until, max_steps):
        done = 0
        for real in range(chains.x.shape[0]):
            chain = _chain(chains, real)
            state = chain.state
            while state[SAMPLE] < until and done < max_steps:
                sample = int(state[SAMPLE])
                landing = min(sample + clock.stride, clock.final)
                length = (landing - sample) * clock.interval
                steps = (clock.steps * (landing - sample) + clock.stride - 1) // clock.stride
                span = Span(sample * clock.interval, landing * clock.interval, length, steps, length / steps)
                goal = float(steps) if counted else length
                while state[DONE] < goal and done < max_steps:
                    made = advance(chain, method, work, clock, span)
                    state[STEPS] += made
                    done += made
                if state[DONE] == goal:
                    land(chain, method, work, clock, span)
                    record(chain, span.end, u_out[real, landing - offset], v_out[real, landing - offset])
                    state[SAMPLE], state[DONE] = landing, 0.0
        return done

    return march
