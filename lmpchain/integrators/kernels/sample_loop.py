"""The loop over chains and samples of all compiled marches, and steps of a splitting as rows.

A row is a kick and a drift. The last kick of a step and the first kick of the next step form one
row, unless grains are observed between them. An observation is called a look.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from ...util.arrays import Array
from ...util.compilation import Ingredient, compiled_once
from .compiling import inlined, pasted
from .layout import BatchMember, Imposed, Links, SampleRow
from .window import record

# Shortest step, as a fraction of the time between two landings. Shorter steps would not change the
# clock, and their number would overflow.
SHORTEST = 2.0**-50


@pasted
def links_of(batch, real):
    """Return the contacts of one chain of a batch."""
    return Links(
        inverse_length=batch.inverse_length[real],
        strength=batch.strength[real],
        uncompressed=batch.uncompressed[real],
        form=batch.form[real],
        loops=batch.loops[real],
        precompressed=batch.precompressed,
        coefficients=batch.coefficients,
        parameters=batch.parameters[real],
        first=0,
    )


@pasted
def chain_of(chains, real, schedule):
    """Return one chain of a batch, at the state of one schedule."""
    batch = chains.batch
    row = schedule * batch.omega.size + real
    return BatchMember(
        x=chains.x[row],
        v=chains.v[row],
        history=chains.history[row],
        state=chains.state[row],
        inverse_mass=batch.inverse_mass[real],
        links=links_of(batch, real),
        ground=batch.ground,
        ground_parameters=batch.ground_parameters[real],
        opening_length=batch.opening_length[real],
        opening_weight=batch.opening_weight[real],
        opening_reach=batch.opening_reach[real],
        opening_rest=batch.opening_rest,
        ground_kinks=batch.ground_kinks[real],
        imposed=Imposed(
            acts=batch.acts,
            reach=batch.reach[real],
            wave=batch.wave[real],
            knots=batch.knots[real],
            pieces=batch.pieces[real],
            laws=batch.laws,
        ),
        scale=batch.scale[real],
        omega=batch.omega[real],
        damped=batch.damped,
        alike=batch.alike,
        viscosity=batch.viscosity[real],
        drag=batch.drag[real],
        mass=batch.mass[real],
        team=chains.team,
        number=real,
        schedule=schedule,
    )


@pasted
def _row(fields, real, schedule):
    """Return the views into which the samples of a chain are written."""
    balance = fields.balance[schedule, real]
    if schedule == 0:
        return SampleRow(fields.u[real], fields.v[real], fields.first, balance)
    return SampleRow(
        fields.others_u[schedule - 1, real],
        fields.others_v[schedule - 1, real],
        fields.first,
        balance,
    )


@inlined
def end_of_step(chain, clock, remaining, step):
    """Return `state.done` after a step no longer than `step`; equal steps fill the remaining time.

    The length of the step is the result minus `state.done`, not `step`, so that the sum of all
    steps is exactly the time between landings.
    """
    done = chain.state.done
    # The tolerance 1e-9 prevents an extra step that only rounding would require.
    steps = max(1, math.ceil(remaining / max(step, SHORTEST * clock.length) - 1e-9))
    # The last step ends exactly on the sample, without a rounding error.
    lands = steps == 1 and remaining == clock.length - done
    return clock.length if lands else done + remaining / steps


def sample_loop(advance: Callable[..., int], counted: bool) -> Callable[..., int]:
    """Make the march of a method from its steps.

    The march advances chains by every schedule to a sample, or stops after a total number of steps.
    Its results do not depend on the division of the steps into calls: all bits are the same.

    Parameters
    ----------
    advance : function of (chain, method, work, clock, out, landed)
        Function that takes one step or a burst of steps, updates `state.done` and returns the
        number of steps. If `landed` is true, a step has ended on a sample: the function then
        completes displacements and velocities and returns 0.
    counted : bool
        Whether `state.done` is the number of steps since the last landing (True) or the time since
        then, s (False).

    Returns
    -------
    function of (chains, method, work, clocks, fields, begin, end, until, max_steps)
        March that advances the chains begin ... end - 1 to the sample `until`, or by about
        `max_steps` steps in total, and returns the number of steps. The other arguments are
        `Chains`, the parameters of the method, scratch arrays, clocks and `Fields`. The caller
        must compile the march and call it from Python, because a compiled function inside another
        one is compiled twice.
    """

    def march(chains, method, work, clocks, fields, begin, end, until, max_steps):
        done = 0
        size = end - begin
        for row in range(size * clocks.size):
            schedule = row // size
            real = begin + row % size
            chain = chain_of(chains, real, schedule)
            clock = clocks[schedule]
            out = _row(fields, real, schedule)
            state = chain.state
            while state.sample < until and done < max_steps:
                sample = state.sample
                landing = min(sample + clock.stride, clock.final)
                count = landing - sample
                clock.begin = sample * clock.interval
                clock.end = landing * clock.interval
                clock.length = count * clock.interval
                clock.steps = (clock.per_landing * count + clock.stride - 1) // clock.stride
                clock.equal_step = clock.length / clock.steps
                landing_at = float(clock.steps) if counted else clock.length
                landed = False
                # The only call of `advance`, because LLVM inlines it at every call.
                while not landed and (state.done == landing_at or done < max_steps):
                    landed = state.done == landing_at
                    steps_made = advance(chain, method, work, clock, out, landed)
                    state.steps += steps_made
                    done += steps_made
                if landed:
                    record(chain, clock.end, out.u[landing - out.first], out.v[landing - out.first])
                    if out.balance.shape[0] > 0:
                        out.balance[landing, 0] = state.lost
                        out.balance[landing, 1] = state.work
                    state.sample = landing
                    state.done = 0.0
        return done

    # The compiled march is cached under the name of the method's module, until that module changes.
    march.__module__ = advance.__module__
    march.__qualname__ = f"{march.__module__.rpartition('.')[-1]}.march"
    return march


# Multiplications and additions may be fused, because derivatives, unlike runs, need not have the
# same bits for every partition of a chain. See `compiling` about numba's runtime.
OPTIONS: dict[str, Any] = {
    "error_model": "numpy",
    "fastmath": {"nnan", "ninf", "nsz", "contract"},
    "_nrt": False,
}
loop = numba.njit(**OPTIONS, pipeline_class=Ingredient)
compiled_gradient = partial(
    compiled_once, "gradients of the native engine", 30, nogil=True, **OPTIONS
)


class Course(NamedTuple):
    """Steps of a run, and the number of steps before each observation.

    Attributes
    ----------
    kicks : (S+1,) array
        Lengths of the kicks of a step, as fractions of the step.
    drifts : (S,) array
        Lengths of the drifts of a step, as fractions of the step.
    lengths : (K,) array
        Lengths of all steps, s.
    begun : (looks+1,) array
        Number of steps before each observation.
    """

    kicks: Array
    drifts: Array
    lengths: Array
    begun: NDArray[np.int64]


class Stretch(NamedTuple):
    """`size` consecutive rows, which begin `row` rows after observation number `look`."""

    look: int
    row: int
    size: int


class Looks(NamedTuple):
    """Observed bodies (G,), and a displacement and a velocity of each, (2, looks+1, G).

    Attributes
    ----------
    bodies : (G,) array
        Index of each observed body in a row of bodies.
    values : (2, looks+1, G) or (D, 2, looks+1, G) array
        Displacements, m, and velocities, m/s; or derivatives with respect to these values; or
        changes of these values in D directions.
    """

    bodies: NDArray[np.int64]
    values: Array


@loop
def fill_rows(steps, look, row, kick, drift):
    """Compute kick and drift (Q,), s, of the rows that begin `row` rows after an observation."""
    kicks, drifts, lengths, begun = steps
    stages = drifts.size
    step = begun[look] + row // stages
    stage = row % stages
    for n in range(kick.size):
        # The last kick before an observation forms a row of its own.
        if step == begun[look + 1]:
            kick[n] = kicks[stages] * lengths[step - 1]
            drift[n] = 0.0
            return
        kick[n] = kicks[stage] * lengths[step]
        drift[n] = drifts[stage] * lengths[step]
        if stage == 0 and step > begun[look]:
            kick[n] += kicks[stages] * lengths[step - 1]
        stage += 1
        if stage == stages:
            step += 1
            stage = 0


@loop
def drift_before(steps, look, row):
    """Return the drift, s, of the row before row number `row` after an observation.

    The result is 0 if row number `row` directly follows the observation.
    """
    if row == 0:
        return 0.0
    stages = steps.drifts.size
    step = steps.begun[look] + (row - 1) // stages
    return steps.drifts[(row - 1) % stages] * steps.lengths[step]


@loop
def count_rows(steps, look):
    """Return the number of rows from one observation to the next."""
    return steps.drifts.size * (steps.begun[look + 1] - steps.begun[look]) + 1
