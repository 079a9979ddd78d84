"""Chains moved forward through time by a kick-drift splitting, compiled.

A row of bodies lies in memory as a wall (or nothing), N grains and a wall (or nothing), grain 1 at the index `PAD`,
where a cache line begins; behind them come bodies that do not exist, up to a whole number of lines. Whatever is held
has no inverse mass. Only a window of each chain is computed: what lies outside has not moved by `TINY` of the strike.
"""

from __future__ import annotations

import math

import numpy as np

from ...util.compilation import compiled_once
from .contact_forces import NEWS, STRICT, bits, compiled, contact_forces, fma, kick_and_drift, number

PAD = 8  # doubles in a cache line
ROWS = 64  # evaluations of the force between two looks at the window, for long chains and for methods of one stage
TILE = 8192  # grains that stay in the cache while ROWS evaluations pass over them
TINY = 1e-19  # of the largest speed and displacement: what has moved less lies outside of the light cone

# what is remembered of a chain between two calls
SAMPLE, DONE, PENDING, FIRST, LAST, LOWEST, CLOSEST, STEPS, STEP = range(9)


@compiled
def watch(x, inverse_length, strength, memo):
    """Remember the smallest r / length, whose -1 is an opening, and the largest r of all contacts.

    Positive numbers compare like their bits: the largest of whole numbers is found many at a time.
    """
    opened, closest = bits(max(-memo[LOWEST], 0.0)), bits(memo[CLOSEST])
    for n in range(strength.size):
        r = x[n] - x[n + 1]
        s = bits(-(r * inverse_length[n]))
        r = r if strength[n] > 0.0 else 0.0
        opened = max(s, opened)
        closest = max(bits(r), closest)
    memo[LOWEST], memo[CLOSEST] = -number(opened), number(closest)


@compiled
def widen(x, v, memo, scale, margin):
    """Let the window grow until `margin` grains at either end have not moved by TINY of the scale."""
    still_x, still_v = TINY * scale[0], TINY * scale[1]
    last, end = int(memo[LAST]), x.size - PAD
    if last < end:
        n = last - 1
        while n > PAD and abs(x[n]) <= still_x and abs(v[n]) <= still_v:
            n -= 1
        memo[LAST] = min(end, max(last, (n + 1 + margin + PAD - 1) // PAD * PAD))
    first = int(memo[FIRST])
    if first > PAD:
        n = first
        while n < end - 1 and abs(x[n]) <= still_x and abs(v[n]) <= still_v:
            n += 1
        memo[FIRST] = max(PAD, min(first, (n - margin) // PAD * PAD))


@compiled
def _sweep(form, x, v, table, first, last, kicks, drifts, carried, loose, base, shape, path):
    """Kick and drift the window once a row; long chains in tiles, each moved ahead by all rows while it is cached.

    Every row of a tile ends a cache line before the one above it, so that it needs nothing of the tile to come.
    """
    il, st, im = table[0], table[1], table[2]
    rows, tile = kicks.size, TILE if last - first > 2 * TILE else last - first
    for begin in range(first, last, tile):
        end = begin + tile if begin + 2 * tile <= last else last
        together = rows if tile == last - first else 1
        for row in range(0, rows, together):
            a, b = begin, end
            if together == 1:
                a = max(first, begin - PAD * row)
                b = end - PAD * row if end < last else last
            some = slice(row, row + together)
            kick_and_drift(
                form, x[a - 1 : b + 1], v[a:b], il[a - 1 : b], st[a - 1 : b], im[a:b],
                kicks[some], drifts[some], carried[some],
                a == first, loose if a == PAD else 0.0, base, shape, path[some],
            )  # fmt: skip
        if end == last:
            break


@compiled
def place(t, drive, knots, pieces, order):
    """Return displacement (order 0) or speed (order 1) of a driven grain at time t; a sine, or pieces of cubics.

    `drive` holds amplitude, frequency in rad/s and the number of knots, 0 for a sine.
    """
    count = int(drive[2])
    if count == 0:
        return drive[0] * math.sin(drive[1] * t) if order == 0 else drive[0] * drive[1] * math.cos(drive[1] * t)
    piece = min(max(np.searchsorted(knots[:count], t, "right") - 1, 0), count - 2)
    s = t - knots[piece]
    a, b, c, d = pieces[0, piece], pieces[1, piece], pieces[2, piece], pieces[3, piece]
    return ((a * s + b) * s + c) * s + d if order == 0 else (3 * a * s + 2 * b) * s + c


@compiled
def record(x, v, u_out, v_out, driven, speed):
    """Copy the grains of the window (x and v begin with grain 1) to where they are recorded."""
    for n in range(min(u_out.size, x.size)):
        u_out[n] = x[n]
        v_out[n] = v[n]
    if driven:
        v_out[0] = speed


@compiled_once(*NEWS, nogil=True, error_model="numpy", fastmath=STRICT)
def march(
    x, v, memo, table, loose, scale, forms, base, shape, drive, knots, pieces,
    kicks, drifts, clock, u_out, v_out, offset, until, most,
):  # fmt: skip
    """Advance every realisation to the sample `until` by steps of one length, or by `most` steps altogether.

    The last kick of a step and the first of the next are one, except where a sample lies between them. The result does
    not depend on how the steps are shared out over calls.

    Parameters
    ----------
    x, v : (R, W) arrays, bodies as described above, m and m/s
    memo : (R, 9) array, see SAMPLE ... STEP
    table : (R, 3, W) array, 1 / length and strength of the contact below each body, and its inverse mass
    loose : (R,) array, N/m^delta: the constant of a first contact that touches without pressing, else 0
    scale : (R, 2) array, largest displacement and speed, m and m/s
    forms, base, shape : (R,) array, number and (8,) array, see `forces`
    drive, knots, pieces : (R, 3), (R, P) and (R, 4, P-1) arrays, see `place`; (0, 3) if nothing is driven
    kicks, drifts : (S+1,) and (S,) arrays, b_i and a_i of the splitting, as parts of a step
    clock : (4,) array, sample interval in s, steps between two landings, samples between them, last sample
    u_out, v_out : (R, B, N) arrays, where the samples from `offset` on are put

    Returns
    -------
    Steps done.
    """
    stages, driven = drifts.size, drive.shape[0] > 0
    interval, count, stride, final = clock[0], int(clock[1]), int(clock[2]), int(clock[3])
    kick, drift, carried = np.zeros(ROWS + stages), np.zeros(ROWS + stages), np.zeros(ROWS + stages)
    path = np.zeros(ROWS + stages if driven else 0)
    reach = np.cumsum(drifts)
    done = 0
    for real in range(x.shape[0]):
        y, w, own, tab = x[real], v[real], memo[real], table[real]
        while own[SAMPLE] < until and done < most:
            sample = int(own[SAMPLE])
            landing = min(sample + stride, final)
            steps = (count * (landing - sample) + stride - 1) // stride
            h = (landing - sample) * interval / steps
            while own[DONE] < steps and done < most:
                full = own[FIRST] == PAD and own[LAST] == y.size - PAD
                wide = stages == 1 or full or own[LAST] - own[FIRST] > TILE
                burst = min(steps - int(own[DONE]), max(1, ROWS // stages) if wide else 1)
                rows = burst * stages
                widen(y, w, own, scale[real], rows + 1)
                begun = sample * interval + own[DONE] * h
                for step in range(burst):
                    for stage in range(stages):
                        row = step * stages + stage
                        kick[row], drift[row] = kicks[stage] * h, drifts[stage] * h
                        if driven:
                            t = begun + (step + (reach[stage - 1] if stage > 0 else 0.0)) * h
                            path[row] = place(t, drive[real], knots[real], pieces[real], 0)
                    kick[step * stages] += own[PENDING]
                    own[PENDING] = kicks[stages] * h
                first, last = int(own[FIRST]), int(own[LAST])
                _sweep(
                    forms[real], y, w, tab, first, last, kick[:rows], drift[:rows], carried[:rows],
                    loose[real], base, shape, path[:rows],
                )  # fmt: skip
                watch(y[first - 1 : last + 1], tab[0, first - 1 : last], tab[1, first - 1 : last], own)
                own[DONE] += burst
                own[STEPS] += burst
                done += burst
            if own[DONE] == steps:
                first, last = int(own[FIRST]), int(own[LAST])
                kick[0], drift[0], t, speed = own[PENDING], 0.0, landing * interval, 0.0
                if driven:
                    path[0] = place(t, drive[real], knots[real], pieces[real], 0)
                    speed = place(t, drive[real], knots[real], pieces[real], 1)
                _sweep(
                    forms[real], y, w, tab, first, last, kick[:1], drift[:1], carried[:1],
                    loose[real], base, shape, path[:1],
                )  # fmt: skip
                own[SAMPLE], own[DONE], own[PENDING] = landing, 0.0, 0.0
                here = landing - offset
                record(y[PAD:last], w[PAD:last], u_out[real, here], v_out[real, here], driven, speed)
    return done


@compiled
def accelerate(form, y, tab, first, last, loose, base, shape, force, pull):
    """Fill pull (W,) with the accelerations of bodies first ... last-1 of a row y (W,); force (W,) is room for work."""
    near = slice(first - 1, last)
    f, im = force[: last - first + 1], tab[2, first:last]
    contact_forces(form, f, y[first - 1 : last + 1], tab[0, near], tab[1, near], base, shape)
    if first == PAD and loose > 0.0 and y[PAD - 1] > y[PAD]:
        f[0] += loose * (y[PAD - 1] - y[PAD]) ** shape[7]
    a = pull[first:last]
    for n in range(a.size):
        a[n] = im[n] * (f[n] - f[n + 1])


@compiled
def ahead(t, whole, drive, knots, resolution):
    """Return the time to the next knot of a driven motion, if that clearly comes before `whole`, else infinity."""
    count = int(drive[2])
    if count > 0:
        following = np.searchsorted(knots[:count], t + resolution, "right")
        if following < count and knots[following] < whole - resolution:
            return knots[following] - t
    return 1e300


@compiled
def _score(gap, rate, bend, weight, omega, nearest):
    """Return how near a contact is to opening or closing, weighed by what that does to the motion, squared.

    For a contact with the overlap `gap` and its two rates, the force behaves like t^(3/2) around the time at which the
    overlap is 0; of a quadratic through them the nearest root counts, also a complex one (a contact that all but
    opens). The local error of a step h there goes as (h / distance)^7 distance^(5/2).
    """
    inside = rate * rate - 2.0 * gap * bend
    size = inside if inside > 0.0 else -inside
    root, modulus = math.sqrt(size), math.sqrt(rate * rate + size)
    towards = abs(rate) if gap > 0.0 else rate  # behind a contact that has just opened lies nothing
    fast = towards + root if inside > 0.0 else modulus
    comes = gap if gap > inside else inside
    fast = fast if comes > 0.0 else 0.0
    near = fast / (2.0 * omega * (abs(gap) + 1e-300))
    near = near if near > 0.0 else 0.0
    near = near if near < nearest else nearest
    near2 = near * near
    near4 = near2 * near2
    return weight * (size * root) * (near4 * near4) * near


@compiled
def _pace(y, rates, bends, inverse_length, weight, base, loose, omega, nearest):
    """Return the largest score of all contacts between the bodies y."""
    largest = 0  # as bits, see `watch`
    for n in range(inverse_length.size):
        il = inverse_length[n]
        gap, rate, bend = base + (y[n] - y[n + 1]) * il, (rates[n] - rates[n + 1]) * il, (bends[n] - bends[n + 1]) * il
        largest = max(bits(_score(gap, rate, bend, weight[n], omega, nearest)), largest)
    most = number(largest)
    if loose > 0.0:
        score = _score(y[0] - y[1], rates[0] - rates[1], bends[0] - bends[1], weight[0], omega, nearest)
        most = score if score > most else most
    return most


@compiled_once(*NEWS, nogil=True, error_model="numpy", fastmath=STRICT)
def march_adaptive(
    x, v, memo, table, loose, scale, forms, base, shape, drive, knots, pieces,
    kicks, drifts, clock, adaptivity, weight, u_out, v_out, offset, until, most,
):  # fmt: skip
    """Advance as `march` does, by steps that shorten where a contact is about to open or has just closed.

    A method of order p needs p derivatives of the force, which goes like t^delta where a contact opens or closes; steps
    that shorten like the distance to that time to the power 9/14 keep the error of every step the same, and the order.

    Parameters
    ----------
    clock : (5,) array, sample interval in s, step in s, samples between two landings, last sample, length of
        adaptive steps
    adaptivity : (R, 2) array, highest frequency in rad/s, and the largest 1 / (distance x frequency) that is told apart
    weight : (R, W) array, for each contact: square of the acceleration that it gives, over what changes the motion
    """
    stages, driven = drifts.size, drive.shape[0] > 0
    interval, longest, stride, final = clock[0], clock[1], int(clock[2]), int(clock[3])
    adaptive = clock[4]
    kick, drift, carried = kicks[1:stages] * 0.0, drifts[1:] * 0.0, drifts[1:] * 0.0
    path = np.zeros(stages - 1 if driven else 0)
    force, pull = np.zeros(x.shape[1]), np.zeros(x.shape[1])
    reach = np.cumsum(drifts)
    done = 0
    for real in range(x.shape[0]):
        y, w, own, tab = x[real], v[real], memo[real], table[real]
        while own[SAMPLE] < until:
            sample = int(own[SAMPLE])
            landing = min(sample + stride, final)
            now, whole = sample * interval, (landing - sample) * interval
            widen(y, w, own, scale[real], stages + 1)
            first, last = int(own[FIRST]), int(own[LAST])
            near, grains, speeds, a = slice(first - 1, last), y[first:last], w[first:last], pull[first:last]
            accelerate(forms[real], y, tab, first, last, loose[real], base, shape, force, pull)
            for n in range(speeds.size):
                speeds[n] = fma(own[PENDING], a[n], speeds[n])
            own[PENDING] = 0.0
            if own[DONE] == whole:
                speed = 0.0
                if driven:
                    speed = place(landing * interval, drive[real], knots[real], pieces[real], 1)
                record(
                    y[PAD:last],
                    w[PAD:last],
                    u_out[real, landing - offset],
                    v_out[real, landing - offset],
                    driven,
                    speed,
                )
                own[SAMPLE], own[DONE] = landing, 0.0
                continue
            if done >= most:
                break
            bodies = slice(first - 1, last + 1)
            watch(y[bodies], tab[0, near], tab[1, near], own)
            left = whole - own[DONE]
            if driven:
                t = now + own[DONE]
                w[PAD] = place(t, drive[real], knots[real], pieces[real], 1)
                left = min(left, ahead(t, now + whole, drive[real], knots[real], 1e-9 * longest))
            closeness = _pace(
                y[bodies], w[bodies], pull[bodies], tab[0, near], weight[real, near], base,
                loose[real] if first == PAD else 0.0, adaptivity[real, 0], adaptivity[real, 1],
            )  # fmt: skip
            h = longest * min(1.0, adaptive * closeness ** (-1 / 14)) if closeness > 0.0 else longest
            steps = max(1, math.ceil(left / h - 1e-9))
            h = left / steps
            if driven:
                w[PAD] = 0.0
                for stage in range(stages - 1):
                    t = now + own[DONE] + reach[stage] * h
                    path[stage] = place(t, drive[real], knots[real], pieces[real], 0)
            for n in range(speeds.size):
                speeds[n] = fma(kicks[0] * h, a[n], speeds[n])
                grains[n] = fma(drifts[0] * h, speeds[n], grains[n])
            for stage in range(stages - 1):
                kick[stage], drift[stage] = kicks[stage + 1] * h, drifts[stage + 1] * h
            _sweep(forms[real], y, w, tab, first, last, kick, drift, carried, loose[real], base, shape, path)
            ends = own[DONE] + h
            own[DONE] = whole if steps == 1 and left == whole - own[DONE] else ends
            own[PENDING] = kicks[stages] * h
            own[STEPS] += 1.0
            done += 1
            if driven:
                y[PAD] = place(now + own[DONE], drive[real], knots[real], pieces[real], 0)
    return done
