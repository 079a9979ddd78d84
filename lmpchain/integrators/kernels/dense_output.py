"""Samples inside steps, by Hermite interpolation (dense output), compiled.

The polynomial of degree 7 in time matches the displacement u, the velocity v, the acceleration a
and the jerk j at both ends of a step. Its error is of order h^8, and the error of its rate is of
order h^7, both higher than the order of the steps. With an imposed motion or force, steps end on
every sample instead, because interpolation fails at kinks of the forcing.
"""

from __future__ import annotations

from typing import NamedTuple

from ...util.arrays import Array
from .compiling import fma, inlined
from .contact_forces import contact_stiffnesses, touching_stiffness
from .layout import PAD, WHOLE_ROWS
from .right_hand_side import slice_links


class DenseRates(NamedTuple):
    """Forces on bodies, accelerations, rates of the forces, and jerks, (W,) arrays."""

    force: Array
    pull: Array
    rate: Array
    jerk: Array


@inlined
def passes(chain, clock, begin, end):
    """Return the first sample in begin < t <= end, or 0 without one.

    Samples and times, s, are counted from the last landing. The sample at the next landing is
    excluded, because a step ends there. Only every `clock.dense`-th sample counts.
    """
    before = chain.state.sample
    stride = clock.dense
    interval = clock.interval
    sample = int(begin / interval) // stride * stride - before % stride
    while sample * interval <= begin:
        sample += stride
    return sample if sample * interval <= end and sample * interval < clock.length else 0


@inlined
def fill_rates(chain, first, last, force, rate, beyond):
    """Fill rate (W,) with dF/dt of the elastic forces of the contacts of bodies first ... last-1.

    `force[n - beyond]` is the force of the contact below body n minus its force at rest, N.
    """
    x = chain.x
    v = chain.v
    links = chain.links
    near = slice(first - 1, last)
    found = force[first - 1 - beyond : last - beyond]
    contact_stiffnesses(slice_links(links, near, 0.0), rate[near], found, x[first - 1 : last + 1])
    if first == PAD and links.uncompressed > 0.0:
        r = x[PAD - 1] - x[PAD]
        rate[PAD - 1] = touching_stiffness(r, force[PAD - 1 - beyond], links.coefficients)
    for n in range(first - 1, last):
        rate[n] *= v[n] - v[n + 1]


@inlined
def fill_jerk(chain, first, last, rates, beyond):
    """Compute jerks of the bodies first ... last-1 from the forces (see `fill_rates`)."""
    fill_rates(chain, first, last, rates.force, rates.rate, beyond)
    for n in range(first, last):
        rates.jerk[n] = chain.inverse_mass[n] * (rates.rate[n - 1] - rates.rate[n])


@inlined
def keep(chain, first, last, rates):
    """Store the state of the bodies first ... last-1 at the start of a step that passes samples."""
    history = chain.history
    for n in range(first, last):
        history[0, n] = chain.x[n]
        history[1, n] = chain.v[n]
        history[2, n] = rates.pull[n]
        history[3, n] = rates.jerk[n]


@inlined
def fill_samples(chain, clock, first, last, rates, out):
    """Interpolate the bodies first ... last-1 at all samples inside the completed step."""
    history = chain.history
    begin = chain.state.step_begin
    end = chain.state.done
    u_0 = history[0, first:last]
    v_0 = history[1, first:last]
    a_0 = history[2, first:last]
    j_0 = history[3, first:last]
    u_1 = chain.x[first:last]
    v_1 = chain.v[first:last]
    a_1 = rates.pull[first:last]
    j_1 = rates.jerk[first:last]
    h = end - begin
    interval = clock.interval
    sample = passes(chain, clock, begin, end)
    while sample > 0 and sample * interval <= end and sample * interval < clock.length:
        s = (sample * interval - begin) / h
        q = 1.0 - s
        s3 = s * s * s
        q3 = q * q * q
        # Weights of u, v, a and j at the start (0) and the end (1) of the step, for u. The weight
        # of u at the end is 1 - `along`, so that grains at rest stay exactly in place.
        along = q3 * q * (1.0 + s * (4.0 + s * (10.0 + 20.0 * s)))
        v0 = h * s * q3 * q * (1.0 + s * (4.0 + 10.0 * s))
        v1 = -h * q * s3 * s * (1.0 + q * (4.0 + 10.0 * q))
        a0 = h * h / 2 * s * s * q3 * q * (1.0 + 4.0 * s)
        a1 = h * h / 2 * q * q * s3 * s * (1.0 + 4.0 * q)
        j0 = h * h * h / 6 * s3 * q3 * q
        j1 = -h * h * h / 6 * q3 * s3 * s
        # Weights for v, the derivative of this polynomial, of degree 6.
        rise = 140.0 / h * s3 * q3
        w0 = q3 * (1.0 + s * (3.0 + s * (6.0 - 70.0 * s)))
        w1 = s3 * (1.0 + q * (3.0 + q * (6.0 - 70.0 * q)))
        b0 = h * q3 * s * (1.0 + s * (3.0 - 14.0 * s))
        b1 = -h * s3 * q * (1.0 + q * (3.0 - 14.0 * q))
        k0 = h * h * q3 * s * s * (0.5 - 7.0 / 6.0 * s)
        k1 = h * h * s3 * q * q * (0.5 - 7.0 / 6.0 * q)
        number = chain.state.sample + sample
        u_row = out.u[number - out.first, first - PAD :]
        v_row = out.v[number - out.first, first - PAD :]
        grains = min(last - first, u_row.size)
        # One loop for each row, because the compiler then vectorises it.
        for n in range(grains):
            u = fma(along, u_0[n] - u_1[n], u_1[n])
            u = fma(v0, v_0[n], fma(v1, v_1[n], u))
            u_row[n] = fma(j0, j_0[n], fma(j1, j_1[n], fma(a0, a_0[n], fma(a1, a_1[n], u))))
        for n in range(grains):
            v = fma(w0, v_0[n], fma(w1, v_1[n], rise * (u_1[n] - u_0[n])))
            v_row[n] = fma(k0, j_0[n], fma(k1, j_1[n], fma(b0, a_0[n], fma(b1, a_1[n], v))))
        # Longer rows are allocated as zeros, so that pages outside the window cost no memory.
        if out.u.shape[1] <= WHOLE_ROWS:
            u_rest = out.u[number - out.first]
            v_rest = out.v[number - out.first]
            u_rest[: first - PAD] = 0.0
            v_rest[: first - PAD] = 0.0
            u_rest[last - PAD :] = 0.0
            v_rest[last - PAD :] = 0.0
        sample += clock.dense
