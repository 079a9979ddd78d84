"""The active window of a chain, extremes of its contacts and grains, and samples, compiled.

Only the window is computed: what lies outside, beyond the light cone, has not moved by `TINY` of the strike.
"""

from __future__ import annotations

from ...util.arrays import MAGNITUDE
from .contact_forces import bits, inlined, number
from .layout import PAD, WHOLE_ROWS
from .right_hand_side import impose_velocity, imposed_speed
from .team import mine

TINY = 1e-19  # of the largest speed and displacement: what has moved less lies outside of the light cone
# omega t between the first looks for the largest motion: of one period of the fastest at most 12 % is missed; they are
# at least a 32nd of the steps so far apart: later, what is new is rare
LOOK, SETTLED, SELDOM = 1.0, 32, 2.0**30


@inlined
def widen(chain, margin):
    """Let the window grow until `margin` grains at either end are at rest and not acted on."""
    x, v, state = chain.x, chain.v, chain.state
    still_x, still_v = TINY * chain.scale[0], TINY * chain.scale[1]
    last, end = state.last, x.size - PAD
    if last < end:
        n, least = last - 1, max(PAD, chain.acted[1])
        while n > least and abs(x[n]) <= still_x and abs(v[n]) <= still_v:
            n -= 1
        state.last = min(end, max(last, (n + 1 + margin + PAD - 1) // PAD * PAD))
    first = state.first
    if first > PAD:
        n, most = first, min(end - 1, chain.acted[0])
        while n < most and abs(x[n]) <= still_x and abs(v[n]) <= still_v:
            n += 1
        state.first = max(PAD, min(first, (n - margin) // PAD * PAD))


@inlined
def watch(chain):
    """Note the smallest r / length (-1 is an opening) and the largest r of all contacts in the window.

    Positive numbers compare like their bits: the largest of whole numbers is found many at a time.
    """
    state = chain.state
    first, last = mine(chain)
    x = chain.x[first - 1 : last + 1]
    inverse_length, strength = (
        chain.inverse_length[first - 1 : last],
        chain.strength[first - 1 : last],
    )
    opened, closest = bits(max(-state.least_strain, 0.0)), bits(state.largest_approach)
    for n in range(strength.size):
        r = x[n] - x[n + 1]
        s = bits(-(r * inverse_length[n]))
        r = r if strength[n] > 0.0 else 0.0
        opened = max(s, opened)
        closest = max(bits(r), closest)
    state.least_strain, state.largest_approach = -number(opened), number(closest)


@inlined
def look(chain, clock, made, t, complete):
    """Note the largest displacement and speed of all grains at time t, if a look is due.

    `made` steps have been made. `complete` is the least part of its largest value to which a speed without the last
    kick may have grown.
    """
    state = chain.state
    if made < state.next_look or not clock.looks:
        return
    every = int(min(max(LOOK / (clock.step * chain.omega), 1.0), SELDOM))
    state.next_look = made + every + made // SETTLED
    first, last = mine(chain)
    x, v = chain.x[first:last], chain.v[first:last]
    farthest, fastest = bits(state.largest_displacement), 0
    for n in range(v.size):
        farthest = max(bits(x[n]) & MAGNITUDE, farthest)
        fastest = max(bits(v[n]) & MAGNITUDE, fastest)
    state.largest_displacement = number(farthest)
    state.largest_speed = max(
        state.largest_speed, complete * number(fastest), imposed_speed(chain, t)
    )


@inlined
def record(chain, t, u_out, v_out):
    """Copy the grains up to the end of the window at time t to where they are recorded, (N,) m and m/s."""
    first, last = mine(chain)
    first = PAD if chain.team.part == 0 else first  # before the window, too
    last = chain.x.size if v_out.size <= WHOLE_ROWS else last
    x, v, u_some, v_some = (
        chain.x[first:last],
        chain.v[first:last],
        u_out[first - PAD :],
        v_out[first - PAD :],
    )
    for n in range(min(u_some.size, x.size)):
        u_some[n] = x[n]
        v_some[n] = v[n]
    impose_velocity(chain, v_out, 0, t)
