"""Gear's predictor-corrector, the method of the paper, on the same contact forces."""

from __future__ import annotations

import numpy as np

from ...util.compilation import compiled_once
from .contact_forces import NEWS, STRICT
from .splitting import DONE, FIRST, LAST, PAD, SAMPLE, STEP, STEPS, accelerate, place, record, watch, widen


@compiled_once(*NEWS, nogil=True, error_model="numpy", fastmath=STRICT)
def march_gear(
    x, v, memo, table, loose, scale, forms, base, shape, drive, knots, pieces,
    corrections, extra, clock, u_out, v_out, offset, until, most,
):  # fmt: skip
    """Advance as `kernels.march` does by Gear's predictor-corrector of five values, by steps of one length.

    Parameters
    ----------
    corrections : (5,) array, Gear's coefficients for x'' = a(x)
    extra : (R, 3, W) array, second, third and fourth derivatives of the displacements, times h^k / k!
    clock : (4,) array, sample interval in s, steps between two landings, samples between them, last sample
    """
    driven, width = drive.shape[0] > 0, x.shape[1]
    interval, count, stride, final = clock[0], int(clock[1]), int(clock[2]), int(clock[3])
    force, pull, z = np.zeros(width), np.zeros(width), np.zeros(width)
    done = 0
    for real in range(x.shape[0]):
        y, w, own, tab, form, more = x[real], v[real], memo[real], table[real], forms[real], extra[real]
        while own[SAMPLE] < until and done < most:
            sample = int(own[SAMPLE])
            landing = min(sample + stride, final)
            now = sample * interval
            steps = (count * (landing - sample) + stride - 1) // stride
            h = (landing - sample) * interval / steps
            while own[DONE] < steps and done < most:
                widen(y, w, own, scale[real], 4)
                first, last = int(own[FIRST]), int(own[LAST])
                if own[STEP] != h:  # the derivatives at the start, from the motion of a moment before and after
                    own[STEP] = h
                    accelerate(form, y, tab, first, last, loose[real], base, shape, force, pull)
                    more[0, first:last] = pull[first:last]
                    for side in (1.0, -1.0):
                        t = now + (own[DONE] + side) * h
                        for n in range(first, last):
                            z[n] = y[n] + side * h * w[n] + 0.5 * h * h * more[0, n]
                        if driven:
                            z[PAD] = place(t, drive[real], knots[real], pieces[real], 0)
                        accelerate(form, z, tab, first, last, loose[real], base, shape, force, pull)
                        for n in range(first, last):
                            more[1, n] = pull[n] if side > 0 else (more[1, n] - pull[n]) * h * h / 12
                            more[2, n] = pull[n] + (more[2, n] if side < 0 else 0.0)
                    for n in range(first, last):
                        more[2, n] = (more[2, n] - 2.0 * more[0, n]) * h * h / 24
                        more[0, n] *= 0.5 * h * h
                for n in range(first, last):
                    a, b, c = more[0, n], more[1, n], more[2, n]
                    y[n] += h * w[n] + a + b + c
                    w[n] += (2.0 * a + 3.0 * b + 4.0 * c) / h
                    more[0, n], more[1, n] = a + 3.0 * b + 6.0 * c, b + 4.0 * c
                if driven:
                    y[PAD] = place(now + (own[DONE] + 1) * h, drive[real], knots[real], pieces[real], 0)
                accelerate(form, y, tab, first, last, loose[real], base, shape, force, pull)
                for n in range(first, last):
                    off = 0.5 * h * h * pull[n] - more[0, n]
                    y[n] += corrections[0] * off
                    w[n] += corrections[1] * off / h
                    more[0, n] += corrections[2] * off
                    more[1, n] += corrections[3] * off
                    more[2, n] += corrections[4] * off
                if driven:
                    y[PAD], w[PAD] = place(now + (own[DONE] + 1) * h, drive[real], knots[real], pieces[real], 0), 0.0
                    more[:, PAD] = 0.0
                watch(y[first - 1 : last + 1], tab[0, first - 1 : last], tab[1, first - 1 : last], own)
                own[DONE] += 1.0
                own[STEPS] += 1.0
                done += 1
            if own[DONE] == steps:
                speed = place(landing * interval, drive[real], knots[real], pieces[real], 1) if driven else 0.0
                last, row = int(own[LAST]), landing - offset
                record(y[PAD:last], w[PAD:last], u_out[real, row], v_out[real, row], driven, speed)
                own[SAMPLE], own[DONE] = landing, 0.0
    return done
