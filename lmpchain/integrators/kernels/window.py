"""The active window of a chain, extremes of its contacts and grains, and samples, compiled.

Only grains in the window are computed. Grains outside of the window are beyond the light cone: they
have moved by less than the fraction `TINY` of the largest motion of the excitation.
"""

from __future__ import annotations

from typing import NamedTuple

from ...util.arrays import MAGNITUDE
from .compiling import bits, inlined, number
from .layout import PAD, WHOLE_ROWS
from .right_hand_side import impose_velocity, imposed_speed
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
