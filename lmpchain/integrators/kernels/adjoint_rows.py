"""One row, a kick and a drift, of a run and of its adjoint: the inner loops of `adjoint`, compiled.

`adjoint` defines the force of a contact and its derivatives.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from enum import IntEnum
from typing import Any, NamedTuple

from numba import types

from ...util.arrays import Array
from .compiling import apart, by_form, exponential, llvm, logarithm, select
from .sample_loop import loop


class Way(IntEnum):
    """Methods of the reverse pass through a row.

    If all contacts are compressed at rest and never open, rows are undone. UNDONE_PLAIN and
    UNDONE_EXACT are for delta = 3/2, in strong waves and in waves of any strength. UNDONE_SERIES
    and UNDONE_SHORT are for any delta, in weak and in very weak waves.

    Otherwise p is stored. For delta = 3/2, VACUUM is for chains without compression, PLAIN for
    strong waves and HERTZ for waves of any strength. OTHER is for all other chains, and stores f,
    too.
    """

    UNDONE_PLAIN = 0
    UNDONE_EXACT = 1
    UNDONE_SERIES = 2
    UNDONE_SHORT = 3
    VACUUM = 4
    PLAIN = 5
    HERTZ = 6
    OTHER = 7


class AdjointForce(NamedTuple):
    """Parameters of the contact force in the reverse pass.

    Attributes
    ----------
    way : int
        Method of the reverse pass, a member of `Way`.
    pressed : float
        The number c of `adjoint`: 1 if contacts are compressed at rest, else 0.
    touching : float
        Constant K of a top wall that touches grain 1 without a force at rest, N/m^delta, else 0.
    less : float
        Exponent delta - 1.
    terms : (4,) or (6,) array
        Coefficients of a polynomial in s for p / s.
    """

    way: int
    pressed: float
    touching: float
    less: float
    terms: Array


class Bodies(NamedTuple):
    """Displacements, m, velocities, m/s (or momenta if rows are undone), and 1 / mass."""

    x: Any
    v: Any
    inverse_mass: Any


class Above(NamedTuple):
    """Properties of the contact above each body: 1 / length, strength, delta strength / length."""

    inverse_length: Any
    strength: Any
    stiffness: Any


class Adjoint(NamedTuple):
    """Derivatives of an objective, body by body and contact by contact.

    Attributes
    ----------
    x : array
        Derivative with respect to the displacement of each body.
    pull : array
        Derivative with respect to the velocity of each body, over the mass.
    power : array
        Sum over all rows of y p h delta F / length for each contact, where y is the derivative with
        respect to the impulse of the contact, and h is the length of the kick. The sum is not
        computed in a sonic vacuum.
    force : array
        Sum over all rows of y f h for each contact.
    mass : array
        Derivative with respect to the mass of each body, summed over all kicks, times minus the
        mass.
    """

    x: Any
    pull: Any
    power: Any
    force: Any
    mass: Any


class KeptRows(NamedTuple):
    """Stored p and f of all contacts in rows of `width`, from the place `begin` on."""

    powers: Any
    forces: Any
    begin: int
    width: int


class BackRows(NamedTuple):
    """Kicks, preceding drifts, impulses and their derivatives at a tile border, by row."""

    kicks: Any
    drifts: Any
    impulses: Any
    slopes: Any


class AdjointSpan(NamedTuple):
    """Rows and contacts in one call of the reverse pass.

    Attributes
    ----------
    last : int
        Number of the last row.
    rows : int
        Number of rows.
    first : int
        First contact of the last row.
    stop : int
        Contact after the last contact of the last row.
    sooner : int
        Number of places by which each preceding row begins earlier.
    shorter : int
        Number of places by which each preceding row ends earlier.
    top : bool
        Whether all bodies above the span are at rest.
    """

    last: int
    rows: int
    first: int
    stop: int
    sooner: int
    shorter: int
    top: bool


@llvm
def at(typing: Any, array: Any, n: Any) -> Any:
    """Return a pointer to element n of an array; a pointer is cheaper to pass than a slice."""

    def place(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.gep(
            context.make_array(signature.args[0])(context, builder, args[0]).data, [args[1]]
        )

    return types.CPointer(array.dtype)(array, types.intp), place


# The following loops contain no branch, because the compiler vectorises conditional values.


@loop
def hertz_power(s, c):
    """Return p for delta = 3/2 without the rounding error of 1 + s."""
    # One step of Newton's method restores the digits that the root of a weak strain has lost. At
    # the strains of touching grains, which have no bound, its rounding errors would be larger.
    p = math.sqrt(c + s) - c
    return p + select(s < 1.0, 0.5 * c, 0.0) * ((s - 2.0 * p) - p * p)


@loop
def power(s, c, less):
    """Return p for any delta; `less` is delta - 1."""
    # The logarithm of 0 must be avoided.
    shut = c + s > 1e-90
    inside = s if shut else 1.0 - c
    y = c + inside
    p = exponential(less * logarithm(y, inside - (y - c)), c)
    return p if shut else -c


@loop
def touch(r, constant, less):
    """Return p and f of a first contact that only touches."""
    p = 0.0
    if r > 0.0:
        p = math.sqrt(r) if less == 0.5 else r**less
    return p, constant * r * p


# The next functions return p and f of a contact from s = r / length (at least -c), or from r in the
# sonic vacuum.


@loop
def _plain(s, strength, law):
    c = law.pressed
    p = math.sqrt(c + s) - c
    return p, strength * p * (3.0 * c + p * (3.0 * c + p))


@loop
def _hertz(s, strength, law):
    c = law.pressed
    p = hertz_power(s, c)
    return p, strength * p * (3.0 * c + p * (3.0 * c + p))


@loop
def _vacuum(r, strength, law):
    p = math.sqrt(r)
    return p, strength * r * p


@loop
def _other(s, strength, law):
    c = law.pressed
    p = power(s, c, law.less)
    return p, strength * (c * (s + p) + s * p)


def _keep(evaluate: Callable[..., Any], scaled: bool = True, force: bool = False) -> Any:
    """Make the loop of kick and drift that stores p, and f if it does not follow from p."""

    @loop
    def keep(count, bodies, above, kick, drift, impulse, law, kept):
        """Kick and drift `count` bodies x (C+1,) and v (C,); `impulse` is the force from above."""
        apart()
        x, v, inverse_mass = bodies
        before = impulse
        for n in range(count):
            s = x[n] - x[n + 1]
            if scaled:
                s *= above.inverse_length[n]
                s = s if s > -law.pressed else -law.pressed
            else:
                s = s if s > 0.0 else 0.0
            p, below = evaluate(s, above.strength[n], law)
            kept.powers[kept.begin + n] = p
            if force:
                kept.forces[kept.begin + n] = below
            faster = v[n] + kick * inverse_mass[n] * (before - below)
            v[n] = faster
            x[n] += drift * faster
            before = below
        return before

    return keep


keep_row = by_form(
    {
        Way.VACUUM: _keep(_vacuum, scaled=False),
        Way.PLAIN: _keep(_plain),
        Way.HERTZ: _keep(_hertz),
        Way.OTHER: _keep(_other, force=True),
    }
)


# The next functions return p, kick f, and y d(kick f)/dr, of a contact that is undone.
# `impulse` is kick F, and `at_rest` is y kick times the stiffness at rest.


@loop
def _undo_plain(s, impulse, at_rest, terms):
    s = s if s > -1.0 else -1.0
    root = math.sqrt(1.0 + s)
    return root - 1.0, (impulse + impulse * s) * root - impulse, at_rest * root


@loop
def _undo_exact(s, impulse, at_rest, terms):
    s = s if s > -1.0 else -1.0
    p = hertz_power(s, 1.0)
    linear = impulse * s
    return p, linear + (impulse + linear) * p, at_rest + at_rest * p


@loop
def _undo_series(s, impulse, at_rest, terms):
    square = s * s
    higher = (terms[2] + s * terms[3]) + square * (terms[4] + s * terms[5])
    p = s * ((terms[0] + s * terms[1]) + square * higher)
    linear = impulse * s
    return p, linear + (impulse + linear) * p, at_rest + at_rest * p


@loop
def _undo_short(s, impulse, at_rest, terms):
    p = s * (terms[0] + s * (terms[1] + s * (terms[2] + s * terms[3])))
    linear = impulse * s
    return p, linear + (impulse + linear) * p, at_rest + at_rest * p


# The next functions return kick f and y d(kick f)/dr of a contact with stored p; `closer` is y.


@loop
def _recall_vacuum(p, f, kick, impulse, at_rest, closer, c):
    weight = impulse * p
    return weight * (p * p), (1.5 * closer) * weight


@loop
def _recall_hertz(p, f, kick, impulse, at_rest, closer, c):
    return impulse * p * (3.0 * c + p * (3.0 * c + p)), c * at_rest + at_rest * p


@loop
def _recall_other(p, f, kick, impulse, at_rest, closer, c):
    return kick * f, c * at_rest + at_rest * p


def _back(undo: Any = None, recall: Any = None, force: bool = False, vacuum: bool = False) -> Any:
    """Make the loop of the reverse pass.

    If the function `undo` is given, the loop undoes rows. Otherwise the loop reads p, and also f if
    `force` is true because f does not follow from p.
    """
    # These values are constant at compile time, so that the compiler removes unused branches.
    undone = undo is not None

    @loop
    def back(span, rows, bodies, above, adjoint, law, kept):
        """Propagate adjoints back through rows, each a kick and the drift before it.

        The rows are undone if `undo` is given. In arrays of bodies, a contact has the place of the
        body above it. Every row of a span may begin and end some places earlier than the following
        row, so that the two rows do not depend on each other.
        """
        apart()
        x, momentum, inverse_mass = bodies
        first = span.first
        stop = span.stop
        begin = kept.begin
        for row in range(span.last, span.last - span.rows, -1):
            kick = rows.kicks[row]
            drift = rows.drifts[row]
            f_before = rows.impulses[row]
            g_before = rows.slopes[row]
            # Bodies above the window do not move.
            if span.top:
                adjoint.pull[first] = 0.0
                f_before = 0.0
                g_before = 0.0
            for n in range(first, stop):
                closer = adjoint.pull[n + 1] - adjoint.pull[n]
                impulse = kick * above.strength[n]
                at_rest = above.stiffness[n] * (kick * closer)
                if undone:
                    s = (x[n] - x[n + 1]) * above.inverse_length[n]
                    p, f, g = undo(s, impulse, at_rest, law.terms)
                    push = f_before - f
                    slower = momentum[n] - push
                    momentum[n] = slower
                    x[n] -= drift * inverse_mass[n] * slower
                else:
                    p = kept.powers[begin + n]
                    f = kept.forces[begin + n] if force else 0.0
                    f, g = recall(p, f, kick, impulse, at_rest, closer, law.pressed)
                    push = f_before - f
                # In the sonic vacuum the sum over p is not needed, because no force at rest depends
                # on it.
                if not vacuum:
                    adjoint.power[n] += at_rest * p
                adjoint.force[n] += closer * f
                adjoint.mass[n] += adjoint.pull[n] * push
                by_x = (adjoint.x[n] + g) - g_before
                adjoint.x[n] = by_x
                adjoint.pull[n] += drift * inverse_mass[n] * by_x
                f_before = f
                g_before = g
            # Store the values at the border, from which the tile below continues this row.
            rows.impulses[row] = f_before
            rows.slopes[row] = g_before
            first -= span.sooner
            stop -= span.shorter
            begin -= kept.width

    return back


_back_hertz = _back(recall=_recall_hertz)
back_rows = by_form(
    {
        Way.UNDONE_PLAIN: _back(_undo_plain),
        Way.UNDONE_EXACT: _back(_undo_exact),
        Way.UNDONE_SERIES: _back(_undo_series),
        Way.UNDONE_SHORT: _back(_undo_short),
        Way.VACUUM: _back(recall=_recall_vacuum, vacuum=True),
        Way.PLAIN: _back_hertz,
        Way.HERTZ: _back_hertz,
        Way.OTHER: _back(recall=_recall_other, force=True),
    }
)
