"""Two methods that are no splittings, on the same forces: DOP853 and Gear's predictor-corrector.

They are there to be compared with: the explicit method of order 8 that is most used for smooth problems, and the one
of the paper.
"""

from __future__ import annotations

import math

import numpy as np

from ...util.compilation import compiled_once
from .contact_forces import NEWS, STRICT
from .splitting import DONE, FIRST, LAST, PAD, SAMPLE, STEP, STEPS, accelerate, ahead, place, record, watch, widen


@compiled_once(*NEWS, nogil=True, error_model="numpy", fastmath=STRICT)
def march_dop853(
    x, v, memo, table, loose, scale, forms, base, shape, drive, knots, pieces,
    nodes, inner, weights, clock, u_out, v_out, offset, until, most,
):  # fmt: skip
    """Advance as `kernels.march` does by DOP853 in Nystrom's form: the stages of x'' = a(x) need no velocities.

    Parameters
    ----------
    nodes, inner : (12,) and (12, 12) arrays, c and A^2 of the method
    weights : (6, 12) array, for displacement and velocity: of the step, of the error of order 5, of that of order 3
    clock : (6,) array, sample interval in s, step in s, samples between two landings, last sample, largest error of a
        step over the scale of the motion or 0 for steps of one length, and steps between two landings for those
    """
    stages, driven, width = nodes.size, drive.shape[0] > 0, x.shape[1]
    interval, longest, stride, final = clock[0], clock[1], int(clock[2]), int(clock[3])
    allowed, count = clock[4], int(clock[5])
    force, z = np.zeros(width), np.zeros(width)
    slopes = np.zeros((stages, width))
    done = 0
    for real in range(x.shape[0]):
        y, w, own, tab, form = x[real], v[real], memo[real], table[real], forms[real]
        while own[SAMPLE] < until and done < most:
            sample = int(own[SAMPLE])
            landing = min(sample + stride, final)
            now, whole = sample * interval, (landing - sample) * interval
            equal = whole / ((count * (landing - sample) + stride - 1) // stride)
            while own[DONE] < whole and done < most:
                widen(y, w, own, scale[real], stages + 2)
                first, last = int(own[FIRST]), int(own[LAST])
                here = slice(first, last)
                left = whole - own[DONE]
                if driven:
                    left = min(left, ahead(now + own[DONE], now + whole, drive[real], knots[real], 1e-9 * longest))
                h = equal if allowed == 0.0 else (own[STEP] if own[STEP] > 0.0 else longest)
                steps = max(1, math.ceil(left / h - 1e-9))
                h = left / steps
                grains, speeds, stage_grains = y[here], w[here], z[here]
                z[first - 1 : last + 1] = y[first - 1 : last + 1]
                for stage in range(stages):
                    for n in range(grains.size):
                        stage_grains[n] = grains[n] + nodes[stage] * h * speeds[n]
                    for earlier in range(stage):
                        part, slope = inner[stage, earlier] * h * h, slopes[earlier, here]
                        if part != 0.0:
                            for n in range(grains.size):
                                stage_grains[n] += part * slope[n]
                    if driven:
                        z[PAD] = place(now + own[DONE] + nodes[stage] * h, drive[real], knots[real], pieces[real], 0)
                    accelerate(form, z, tab, first, last, loose[real], base, shape, force, slopes[stage])
                error = 0.0
                if allowed > 0.0:
                    for n in range(first, last):
                        x5, v5, x3, v3 = 0.0, 0.0, 0.0, 0.0
                        for stage in range(stages):
                            slope = slopes[stage, n]
                            x5 += weights[2, stage] * slope
                            v5 += weights[3, stage] * slope
                            x3 += weights[4, stage] * slope
                            v3 += weights[5, stage] * slope
                        x5, x3 = abs(x5) * h * h / scale[real, 0], abs(x3) * h * h / scale[real, 0]
                        v5, v3 = abs(v5) * h / scale[real, 1], abs(v3) * h / scale[real, 1]
                        # the error of order 5, made smaller where that of order 3 says that it is an overestimate
                        ex = x5 * x5 / math.sqrt(x5 * x5 + 0.01 * x3 * x3) if x5 > 0.0 else 0.0
                        ev = v5 * v5 / math.sqrt(v5 * v5 + 0.01 * v3 * v3) if v5 > 0.0 else 0.0
                        error = max(error, ex, ev)
                    factor = 0.9 * (allowed / error) ** 0.125 if error > 0.0 else 4.0
                    own[STEP] = min(4.0 * longest, h * min(4.0, max(0.2, factor)))
                own[STEPS] += 1.0
                done += 1
                if error > allowed and allowed > 0.0 and h > 1e-9 * longest:
                    continue
                for stage in range(stages):
                    wx, wv, slope = weights[0, stage] * h * h, weights[1, stage] * h, slopes[stage, here]
                    if stage == 0:
                        for n in range(grains.size):
                            grains[n] += h * speeds[n]
                    for n in range(grains.size):
                        grains[n] += wx * slope[n]
                        speeds[n] += wv * slope[n]
                own[DONE] = whole if steps == 1 and left == whole - own[DONE] else own[DONE] + h
                if driven:
                    y[PAD] = place(now + own[DONE], drive[real], knots[real], pieces[real], 0)
                watch(y[first - 1 : last + 1], tab[0, first - 1 : last], tab[1, first - 1 : last], own)
            if own[DONE] == whole:
                speed = place(landing * interval, drive[real], knots[real], pieces[real], 1) if driven else 0.0
                last, row = int(own[LAST]), landing - offset
                record(y[PAD:last], w[PAD:last], u_out[real, row], v_out[real, row], driven, speed)
                own[SAMPLE], own[DONE] = landing, 0.0
    return done
