"""The tangent of a run by a kick-drift splitting, compiled; see `adjoint`."""

from __future__ import annotations

from ...util.compilation import compiled_once
from .adjoint import BURST, NEWS, _fill, _rows, _touch
from .adjoint_rows import _OPTIONS, _hertz, _loop, _other, apart
from .layout import BODY, PAD


@_loop
def _evaluate(less, chain, table, row, first, last, tops, near):
    """Fill slope, p, f of the contacts, and what the constant does; `near` is as in `tangent`."""
    c, power, force, slope, soften = chain.precompressed, near[0], near[1], near[2], near[3]
    for n in range(first, last):
        s = (chain.x[n - 1] - chain.x[n]) * table[0, n]
        s = s if s > -c else -c
        p = _hertz(s, c) if less == 0.5 else _other(s, c, less)
        power[n], slope[n] = p, table[2, n] * (c + p)
        force[n] = table[1, n] * (c * (s + p) + s * p)
    if chain.uncompressed > 0.0 and first == PAD:
        force[PAD] = _touch(chain.x[PAD - 1] - chain.x[PAD], chain.uncompressed, less, 0, tops)
        power[PAD] = tops[0, 0]
        slope[PAD] = (less + 1.0) * chain.uncompressed * power[PAD]
    for n in range(first, last):
        soften[n] = (force[n] - near[5, n] * power[n]) * near[4, n]


@_loop
def _move(x, v, inverse_mass, force, kick, drift):
    """Kick and drift bodies x and v (C-1,) by the forces (C,) between them."""
    apart()
    for n in range(v.size):
        faster = v[n] + kick * inverse_mass[n] * (force[n] - force[n + 1])
        v[n] = faster
        x[n] += drift * faster


@_loop
def _change(
    x, v, inverse_mass, slope, power, force, soften, by_force, by_constant, by_mass, kick, drift
):
    """Kick and drift small changes of the bodies x (C+1,) but the last, as fast as v (C,)."""
    apart()
    above, f_above = 0.0, 0.0
    for n in range(v.size):
        below = slope[n] * (x[n] - x[n + 1]) + power[n] * by_force[n] + soften[n] * by_constant[n]
        faster = v[n] + kick * inverse_mass[n] * (above - below - (f_above - force[n]) * by_mass[n])
        v[n] = faster
        x[n] += drift * faster
        above, f_above = below, force[n]


@compiled_once(*NEWS, nogil=True, **_OPTIONS)
def tangent(
    less, chain, table, course, room, path, look, q, count, near, tops, change, dx, dv, seen
):
    """Move a chain, and D small changes dx and dv (D, W) of it, by some rows as `forward` does.

    `near` is (6, W): room for four, the inverse of the constant of every contact and what it carries at rest. `change`
    has directions: relative masses, constants and forces at rest (D, W) each, and what is imposed (D, rows).
    """
    columns, looks = seen
    by_mass, by_constant, by_force, by_path = change
    im, first, last = chain.inverse_mass, PAD, chain.x.size
    body = int(chain.drive[BODY]) if path.size > 0 else 0
    done = 0
    while done < count:
        some = min(BURST, count - done, _rows(course, look) - q)
        kick, drift = room[0, :some], room[1, :some]
        _fill(course, look, q, kick, drift)
        for row in range(some):
            place = done + row
            if body > 0:
                chain.x[body] = path[place]
            _evaluate(less, chain, table, 0, first, last, tops, near)
            for d in range(dx.shape[0]):
                if body > 0:
                    dx[d, body] = by_path[d, place]
                elif body < 0:
                    dv[d, -body] += (
                        kick[row]
                        * im[-body]
                        * (by_path[d, place] - path[place] * by_mass[d, -body])
                    )
                _change(
                    dx[d, first - 1 : last], dv[d, first - 1 : last - 1], im[first - 1 : last - 1], near[2, first:last],
                    near[0, first:last], near[1, first:last], near[3, first:last], by_force[d, first:last],
                    by_constant[d, first:last], by_mass[d, first - 1 : last - 1], kick[row], drift[row],
                )  # fmt: skip
            if body < 0:
                chain.v[-body] += kick[row] * im[-body] * path[place]
            _move(
                chain.x[first : last - 1], chain.v[first : last - 1], im[first : last - 1], near[1, first:last],
                kick[row], drift[row],
            )  # fmt: skip
        q, done = q + some, done + some
        if q == _rows(course, look):
            look, q = look + 1, 0
            for column in range(columns.size):
                for d in range(dx.shape[0]):
                    looks[d, 0, look, column] = dx[d, columns[column]]
                    looks[d, 1, look, column] = dv[d, columns[column]]
