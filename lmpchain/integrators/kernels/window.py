"""The active window of a chain, extremes of its contacts and grains, and samples, compiled.

Only grains in the window are computed. Grains outside of the window are beyond the light cone: they
have moved by less than the fraction `TINY` of the largest motion of the excitation.

Samples inside steps are interpolated (dense output). The polynomial of degree 7 in time matches the
displacement u, the velocity v, the acceleration a and the jerk j at both ends of a step. Its error
is of order h^8, and the error of its rate is of order h^7, both higher than the order of the steps.
With an imposed motion or force, steps end on every sample instead, because interpolation fails at
kinks of the forcing.
"""

from __future__ import annotations

from typing import NamedTuple

from ...util.arrays import MAGNITUDE, Array
from .compiling import bits, fma, inlined, number
from .contact_forces import contact_stiffnesses, touching_stiffness
from .layout import PAD, WHOLE_ROWS
from .right_hand_side import impose_velocity, imposed_speed, slice_links
from .team import share

# Grains that move less than this fraction of the largest speed and displacement are outside of the
# light cone.
TINY = 1e-19
# Motion below this fraction is set to 0, because it does not affect any result.
NOTHING = 1e-40


class WindowLooks(NamedTuple):
    """Frequency of the observations of the largest motion.

    Attributes
    ----------
    radians : float
        Phase omega t from one of the first observations to the next. The observed peak of the
        fastest mode is at most 12 % too small.
    settled : int
        Later observations are separated by 1 / `settled` of the number of steps so far, because new
        extremes are rare then.
    longest : float
        Largest number of steps between two observations, so that integers do not overflow.
    """

    radians: float = 1.0
    settled: int = 32
    longest: float = 2.0**30


LOOKS = WindowLooks()


@inlined
def widen(chain, margin):
    """Extend the window until `margin` grains at either end are at rest and without excitation."""
    x = chain.x
    v = chain.v
    state = chain.state
    still_x = TINY * chain.scale[0]
    still_v = TINY * chain.scale[1]
    last = state.last
    end = x.size - PAD
    if last < end:
        n = last - 1
        inner = max(PAD, chain.imposed.reach[1])
        while n > inner and abs(x[n]) <= still_x and abs(v[n]) <= still_v:
            n -= 1
        # The window consists of whole cache lines, so that threads and tiles do not share a line.
        state.last = min(end, max(last, (n + 1 + margin + PAD - 1) // PAD * PAD))
    first = state.first
    if first > PAD:
        n = first
        inner = min(end - 1, chain.imposed.reach[0])
        while n < inner and abs(x[n]) <= still_x and abs(v[n]) <= still_v:
            n += 1
        state.first = max(PAD, min(first, (n - margin) // PAD * PAD))


@inlined
def rest_ahead(chain):
    """Set grains that have hardly moved at either end of the window to rest.

    The many stages of a step extend so far ahead of a wave that motions would become subnormal
    numbers, with which a processor computes ten times slower.
    """
    x = chain.x
    v = chain.v
    still_x = NOTHING * chain.scale[0]
    still_v = NOTHING * chain.scale[1]
    n = chain.state.last - 1
    while n > chain.state.first and abs(x[n]) <= still_x and abs(v[n]) <= still_v:
        x[n] = 0.0
        v[n] = 0.0
        n -= 1
    n = chain.state.first
    while n < chain.state.last - 1 and abs(x[n]) <= still_x and abs(v[n]) <= still_v:
        x[n] = 0.0
        v[n] = 0.0
        n += 1


@inlined
def watch(chain):
    """Update the smallest r / length (-1 is an opening) and the largest r of all contacts.

    Numbers are compared by their bit patterns, because positive numbers have the same order as
    their bit patterns, and the compiler vectorises the maximum of integers.
    """
    state = chain.state
    first, last = share(chain)
    x = chain.x[first - 1 : last + 1]
    inverse_length = chain.links.inverse_length[first - 1 : last]
    strength = chain.links.strength[first - 1 : last]
    opened = bits(max(-state.least_strain, 0.0))
    closest = bits(state.largest_approach)
    for n in range(strength.size):
        r = x[n] - x[n + 1]
        s = bits(-(r * inverse_length[n]))
        r = r if strength[n] > 0.0 else 0.0
        opened = max(s, opened)
        closest = max(bits(r), closest)
    state.least_strain = -number(opened)
    state.largest_approach = number(closest)


@inlined
def look(chain, clock, steps, t, complete):
    """Update the largest displacement and speed of all grains at time t, if an observation is due.

    `steps` is the number of steps so far. The speeds do not yet include the last kick of a step.
    `complete` is a lower bound on the ratio of the largest complete speed to the largest observed
    speed.
    """
    state = chain.state
    if steps < state.next_look or clock.ratio != 1.0:
        return
    interval = int(min(max(LOOKS.radians / (clock.step * chain.omega), 1.0), LOOKS.longest))
    state.next_look = steps + interval + steps // LOOKS.settled
    first, last = share(chain)
    x = chain.x[first:last]
    v = chain.v[first:last]
    farthest = bits(state.largest_displacement)
    fastest = 0
    for n in range(v.size):
        farthest = max(bits(x[n]) & MAGNITUDE, farthest)
        fastest = max(bits(v[n]) & MAGNITUDE, fastest)
    state.largest_displacement = number(farthest)
    state.largest_speed = max(
        state.largest_speed, complete * number(fastest), imposed_speed(chain, t)
    )


@inlined
def record(chain, t, u_out, v_out):
    """Copy the grains up to the end of the window at time t into a sample, (N,) m and m/s."""
    first, last = share(chain)
    # The first thread also copies the grains above the window.
    first = PAD if chain.team.part == 0 else first
    last = chain.x.size if v_out.size <= WHOLE_ROWS else last
    x = chain.x[first:last]
    v = chain.v[first:last]
    u_row = u_out[first - PAD :]
    v_row = v_out[first - PAD :]
    for n in range(min(u_row.size, x.size)):
        u_row[n] = x[n]
        v_row[n] = v[n]
    impose_velocity(chain, v_out, 0, t)


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
