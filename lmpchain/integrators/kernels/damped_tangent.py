"""The map of an explicit Runge-Kutta method on a damped chain, and its tangent, compiled.

The equation of motion is derived in `chain.damping`. In displacements x and reduced velocities w,
no force depends on a velocity: x' = w + b(x) - gamma x and w' = a(x). The tangent is therefore the
exact derivative of the computed map.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...util.arrays import Array
from ...util.compilation import compiled_once
from .compiling import STRICT, fma, inlined, pasted
from .layout import PAD
from .sample_loop import links_of
from .tangent import BodyRow, ContactResponse, add_exactly, evaluate


class RungeKutta(NamedTuple):
    """Inner weights (S, S) and weights (S,) of a Runge-Kutta method."""

    inner: Array
    weights: Array


class Body(NamedTuple):
    """Masses and damping of N grains.

    Attributes
    ----------
    inverse_mass : (W,) array
        Inverse mass of every body, 1/kg; 0 for a body that is held or driven.
    viscosity : (N+1,) array
        Viscosity A of every contact, s.
    drag : (N,) array
        Drag gamma of every grain, 1/s.
    """

    inverse_mass: Array
    viscosity: Array
    drag: Array


class ImposedStages(NamedTuple):
    """The motion or force imposed on a body: its index, the kind, and values (K, S) at the stages.

    Attributes
    ----------
    body : int
        Index of the body.
    pushes : bool
        Whether a force is imposed (True) or a motion (False).
    values : (K, S) array
        Imposed force, N, or displacement, m, at the stages of all steps; empty if nothing is
        imposed.
    """

    body: int
    pushes: bool
    values: Array


class StageSlopes(NamedTuple):
    """Rates of change of x and w at the stages, (S, N), and of their deviations, (S, N, C)."""

    x: Array
    w: Array
    dx: Array
    dw: Array


@pasted
def _gather(sums, begin, slopes, weights, h):
    """Fill sums (N, C) with begin + h sum_j w_j slopes_j, and skip the weights that are 0."""
    used = np.flatnonzero(weights)
    for n in range(begin.shape[0]):
        total = sums[n]
        start = begin[n]
        for c in range(total.size):
            total[c] = start[c]
        # Two terms are added at once, so that the sums are read and written less often.
        for first in range(0, used.size, 2):
            one = used[first]
            other = used[min(first + 1, used.size - 1)]
            weight = h * weights[one]
            other_weight = h * weights[other] if other > one else 0.0
            slope = slopes[one, n]
            other_slope = slopes[other, n]
            for c in range(total.size):
                total[c] = fma(weight, slope[c], fma(other_weight, other_slope[c], total[c]))


@inlined
def _fill_slopes(body, x, w, response, force, pushed, slopes, stage):
    """Compute the rates of change of x and w, both (W,), at a stage.

    The external `force`, N, acts on the body with the index `pushed`.
    """
    f = response.force
    viscosity = body.viscosity
    for n in range(body.drag.size):
        mobility = body.inverse_mass[PAD + n]
        # A held or driven grain does not react to forces.
        if mobility == 0.0:
            slopes.x[stage, n] = 0.0
            slopes.w[stage, n] = 0.0
            continue
        creep = mobility * (viscosity[n] * f[n] - viscosity[n + 1] * f[n + 1])
        slopes.x[stage, n] = w[PAD + n] + creep - body.drag[n] * x[PAD + n]
        pull = f[n] - f[n + 1]
        if PAD + n == pushed:
            pull += force
        slopes.w[stage, n] = mobility * pull


@inlined
def _fill_deviations(body, x, w, response, stretch, slopes, stage):
    """Compute the rates of change of deviations x and w (N, C) at a stage."""
    stiffness = response.stiffness
    viscosity = body.viscosity
    grains, columns = x.shape
    for n in range(grains):
        mobility = body.inverse_mass[PAD + n]
        dx = slopes.dx[stage, n]
        dw = slopes.dw[stage, n]
        if mobility == 0.0:
            for c in range(columns):
                dx[c] = 0.0
                dw[c] = 0.0
            continue
        above = mobility * stiffness[n]
        below = mobility * stiffness[n + 1]
        # Bodies beyond the ends have no deviation.
        upper = above if n > 0 else 0.0
        lower = below if n < grains - 1 else 0.0
        slower = above * viscosity[n] + below * viscosity[n + 1] + body.drag[n]
        faster_above = upper * viscosity[n]
        faster_below = lower * viscosity[n + 1]
        rate_x = slopes.x[stage, n]
        rate_w = slopes.w[stage, n]
        up = x[max(n - 1, 0)]
        here = x[n]
        down = x[min(n + 1, grains - 1)]
        speed = w[n]
        for c in range(columns):
            longer = stretch[c]
            along = fma(longer, rate_x, fma(-slower, here[c], speed[c]))
            dx[c] = fma(faster_above, up[c], fma(faster_below, down[c], along))
            middle = fma(longer, rate_w, -(above + below) * here[c])
            dw[c] = fma(upper, up[c], fma(lower, down[c], middle))


@compiled_once("the tangent map", 20, nogil=True, error_model="numpy", fastmath=STRICT)
def march(batch, body, motion, deviations, method, lengths, course, states):
    """Advance a damped chain of N grains, and deviations of its state, by given steps.

    Parameters
    ----------
    batch : BatchArrays
        Arrays of a batch that contains only this chain.
    body : Body
        Masses and damping of the chain.
    motion : BodyRow
        Displacements, m, and reduced velocities, m/s, at the start; overwritten with those at the
        end.
    deviations : Deviations
        Deviations of the initial state; overwritten with those of the final state.
    method : RungeKutta
        Coefficients of the method.
    lengths : (K,) array
        Lengths of the steps, s.
    course : ImposedStages
        Motion or force that is imposed on a body.
    states : (2, K+1, N) array
        Filled with displacements, m, and reduced velocities, m/s, before the first and after every
        step.

    Notes
    -----
    Sums over steps are compensated for rounding errors, as in `tangent`.
    """
    links = links_of(batch, 0)
    x, w = motion
    dx, dw, stretch = deviations
    grains, columns = dx.shape
    inner, weights = method
    stages = weights.size
    imposed = course.values.size > 0
    pushed = course.body if imposed and course.pushes else -1
    driven = course.body if imposed and not course.pushes else -1
    force = 0.0
    response = ContactResponse(np.zeros(grains + 1), np.zeros(grains + 1))
    lost = BodyRow(np.zeros(x.size), np.zeros(x.size))
    stage_x = x.copy()
    stage_w = w.copy()
    stage_dx = np.zeros((grains, columns))
    stage_dw = np.zeros((grains, columns))
    slopes = StageSlopes(
        np.zeros((stages, grains)),
        np.zeros((stages, grains)),
        np.zeros((stages, grains, columns)),
        np.zeros((stages, grains, columns)),
    )
    states[0, 0] = x[PAD : PAD + grains]
    states[1, 0] = w[PAD : PAD + grains]
    for k in range(lengths.size):
        h = lengths[k]
        for stage in range(stages):
            for n in range(grains):
                grown_x = 0.0
                grown_w = 0.0
                for earlier in range(stage):
                    grown_x += inner[stage, earlier] * slopes.x[earlier, n]
                    grown_w += inner[stage, earlier] * slopes.w[earlier, n]
                stage_x[PAD + n] = x[PAD + n] + h * grown_x
                stage_w[PAD + n] = w[PAD + n] + h * grown_w
            if driven >= 0:
                stage_x[driven] = course.values[k, stage]
            if pushed >= 0:
                force = course.values[k, stage]
            evaluate(links, stage_x, lost.x, response)
            _fill_slopes(body, stage_x, stage_w, response, force, pushed, slopes, stage)
            if columns > 0:
                _gather(stage_dx, dx, slopes.dx, inner[stage], h)
                _gather(stage_dw, dw, slopes.dw, inner[stage], h)
                _fill_deviations(body, stage_dx, stage_dw, response, stretch, slopes, stage)
        for n in range(grains):
            grown_x = 0.0
            grown_w = 0.0
            for stage in range(stages):
                grown_x += weights[stage] * slopes.x[stage, n]
                grown_w += weights[stage] * slopes.w[stage, n]
            add_exactly(x, lost.x, PAD + n, h * grown_x)
            add_exactly(w, lost.v, PAD + n, h * grown_w)
        if columns > 0:
            _gather(dx, dx, slopes.dx, weights, h)
            _gather(dw, dw, slopes.dw, weights, h)
        states[0, k + 1] = x[PAD : PAD + grains]
        states[1, k + 1] = w[PAD : PAD + grains]
