"""Accelerations and jerks of grains at the samples of their motion, compiled."""

from __future__ import annotations

import math
from functools import partial
from typing import Any, NamedTuple

import numba
import numpy as np

from ...chain.chain import Chain
from ...integrators.batch import parameter_rows
from ...integrators.kernels.contact_forces import Form, addresses, change_in_time
from ...scene.scene import Scene
from ...util.arrays import Array
from ...util.compilation import Ingredient, compiled_once
from ...util.lazy import listed

__dir__ = listed(__name__)

# Indices for bodies at rest and for unrecorded bodies; any negative numbers are possible.
STILL = -1
UNKNOWN = -2
# Division by 0 gives infinity, as in numpy, without branches that prevent vectorisation. The
# compiled functions create no arrays, so that reference counting, half of the compilation, is
# omitted.
_OPTIONS: dict[str, Any] = {"error_model": "numpy", "_nrt": False}
INGREDIENT = _OPTIONS | {"pipeline_class": Ingredient}
compiled = numba.njit(**INGREDIENT)
# Functions with records of arrays are inlined, because copies of the records would be expensive.
joined = numba.njit(**INGREDIENT, forceinline=True)
# Numba itself inlines functions that return arrays or records, and long ones with one caller.
pasted = numba.njit(**INGREDIENT, inline="always")
compiled_measure = partial(compiled_once, "the measures", 6, nogil=True, **_OPTIONS)


class OpeningErrors(NamedTuple):
    """Error of the acceleration where a contact opens or closes within an interval h.

    Together with `hermite.Shape`, these errors bound the errors of values, slopes and curvatures
    for all exponents (see tests/trajectory/test_between.py).

    Attributes
    ----------
    kink : float
        Error in units of h times the jump of the jerk.
    collision : float
        Error in units of the jump of the velocity over h, if the bodies were closest between the
        two samples.
    """

    kink: float = 0.12
    collision: float = 2.0


OPENINGS = OpeningErrors()


class ChainForces(NamedTuple):
    """Forces within a chain of N grains.

    Attributes
    ----------
    contacts : (3, N+1) array
        Inverse length, 1/m, strength, N, and 1 if compressed at rest (else 0), of each contact; see
        `_push`.
    inverse_mass : (N,) array
        Inverse mass of each grain, 1/kg; 0 for a grain that is held.
    exponent : float
        Exponent delta of the force law; 1 if the forces are linearised.
    linear : bool
        Whether the forces are linearised.
    parameters : (P, N+1) array
        Parameters of a law that is given by a formula, see `BatchArrays.parameters`.
    formulas : int
        Memory address of the loop of such a law, see `change_in_time`; 0 for a power law.
    """

    contacts: Array
    inverse_mass: Array
    exponent: float
    linear: bool
    parameters: Array = np.zeros((0, 1))
    formulas: int = 0


class ImposedSamples(NamedTuple):
    """Motion of the top wall and acceleration of one grain by the excitation, at R samples.

    Attributes
    ----------
    wall : (4, R) array
        Displacement, m, velocity, m/s, acceleration, m/s2, and jerk, m/s3, of the wall that moves.
    acceleration : (2, R) array
        Acceleration, m/s2, and jerk, m/s3, of the grain by the excitation.
    doubt : (R,) array
        Error of the imposed acceleration in the interval after each sample, m/s2.
    grain : int
        Number of the grain; 0 if the excitation acts on no grain.
    driven : bool
        Whether the motion of the grain is imposed, so that contacts do not accelerate it.
    wall_body : int
        Number of the wall that moves: N + 1 at the bottom; 0 at the top, or if no wall moves.
    """

    wall: Array
    acceleration: Array
    doubt: Array
    grain: int
    driven: bool
    wall_body: int = 0


class SampledBlock(NamedTuple):
    """Consecutive samples of the motion of a chain of N grains.

    Attributes
    ----------
    u : (C, R) array
        Displacements of C recorded grains, m.
    v : (C, R) array
        Velocities of C recorded grains, m/s.
    column : (N+2,) array
        Row of each body in u and v; negative for a body that is not recorded or does not move. Body
        0 is the top wall, and body N+1 is the bottom wall.
    lawful : (N+2,) array of bool
        Whether the acceleration of a body is computed from the law (True) or from the samples
        (False).
    h : float
        Time between two samples, s.
    law : ChainForces
        Forces within the chain.
    imposed : ImposedSamples
        Imposed motion and acceleration at the samples.
    """

    u: Array
    v: Array
    column: np.ndarray
    lawful: np.ndarray
    h: float
    law: ChainForces
    imposed: ImposedSamples


def law_of(chain: Chain, linear: bool) -> ChainForces:
    """Return the forces within a chain.

    Parameters
    ----------
    chain : Chain
        Chain with its contact law.
    linear : bool
        Whether the forces are linearised.
    """
    law = chain.law
    contacts = chain.contacts
    inverse_mass = 1 / chain.masses
    # A fixed grain is never accelerated.
    inverse_mass[chain.movable :] = 0.0
    pressed = contacts.pressed
    length = np.where(pressed, contacts.length, 1.0)
    strength = np.where(pressed, contacts.force, contacts.constant)
    if linear:
        # Force of a spring of this length.
        strength = contacts.stiffness * length
    rows = np.array([1 / length, strength, pressed])
    exponent = 1.0 if linear else law.onset
    forces = ChainForces(rows, inverse_mass, float(exponent), bool(linear))
    if linear or law.power is not None:
        return forces
    return forces._replace(
        parameters=parameter_rows(contacts),
        formulas=addresses(Form.FORMULAS, law)[-1],
    )


def imposed_on(scene: Scene, step: float, first: int, count: int) -> ImposedSamples:
    """Return the imposed motion and acceleration at consecutive samples.

    Parameters
    ----------
    scene : Scene
        Scene with the excitation.
    step : float
        Time between two samples, s.
    first : int
        Number of the first sample.
    count : int
        Number of samples.
    """
    excitation = scene.excitation
    wall = np.zeros((4, count))
    acceleration = np.zeros((2, count))
    doubt = np.zeros(count)
    wave = excitation.waveform
    if not wave:
        return ImposedSamples(wall, acceleration, doubt, 0, False, 0)
    time: Array = step * np.arange(first, first + count, dtype=float)
    grain = 0
    driven = False
    wall_body = 0
    # The excitation imposes a displacement; its second derivative is the acceleration.
    order, share = 2, 1.0
    moves_base = excitation.from_below and scene.chain.bottom == "wall"
    if excitation.wall or moves_base:
        wall_body = scene.chain.grains + 1 if moves_base else 0
        wall[:] = [wave.at(time, n) for n in range(4)]
        jumps = wall[2:]
    else:
        grain = scene.chain.grains if excitation.from_below else excitation.acts_on
        driven = bool(excitation.driven) or excitation.from_below
        if not driven:
            # The excitation imposes a force.
            order, share = 0, 1 / scene.chain.masses[grain - 1]
        acceleration[:] = share * wave.at(time, order), share * wave.at(time, order + 1)
        jumps = acceleration
    # The waveform is smooth between kinks, where the error of Hermite interpolation is included.
    kinks = np.array(wave.kinks)
    has_kink = np.diff(np.searchsorted(kinks, time, side="right")) > 0
    jump, kink = np.abs(np.diff(jumps))
    bound = OPENINGS.kink * step * kink + (0.0 if wave.spline else jump)
    inside = kinks[(kinks > time[0]) & (kinks < time[-1])]
    if wave.spline and inside.size:
        from scipy.interpolate import CubicHermiteSpline

        # Samples do not resolve several kinks in one interval.
        between = CubicHermiteSpline(time, *jumps)
        off = np.abs(share * wave.at(inside, order) - between(inside))
        np.maximum.at(bound, np.searchsorted(time, inside) - 1, off)
    doubt[:-1] = np.where(has_kink, bound, 0.0)
    return ImposedSamples(wall, acceleration, doubt, grain, driven, wall_body)


def by_body(field: Array) -> Array:
    """Return a (T, C) field as (C, T), so that the samples of a body are contiguous."""
    # A single column is copied as well, because the kernels are compiled for writable arrays.
    return np.array(np.transpose(field), float, order="C")


@compiled
def _push_hertz(r, closing, inverse_length, strength, pressed, force, rate):
    """Fill in changes of a force of exponent 3/2 and their rates."""
    for i in range(r.size):
        s = r[i] * inverse_length
        y = pressed + s
        y = y if y > 0.0 else 0.0
        root = math.sqrt(y)
        full = y * root
        # A difference of forces would lose the digits of a weak wave.
        closed = s * (3.0 + s * (3.0 + s)) / (1.0 + full)
        change = closed if (pressed > 0.0) & (y > 0.0) else full - pressed
        force[i] = strength * change
        rate[i] = strength * 1.5 * inverse_length * root * closing[i]


@compiled
def _push(r, closing, contact, law, n, force, rate):
    """Fill in changes of the force of a contact and their rates, for changes r of the overlap.

    The change is F - F_0 = S (max(p + s, 0)^delta - p) with s = r / l, and its rate is
    S delta (p + s)^(delta - 1) r' / l. In linear theory the change is S delta s. A law that is
    given by a formula has a loop of its own.

    ======  =====================================================  ========
    symbol  meaning                                                name
    ======  =====================================================  ========
    r, r'   change of the overlap since rest, and its rate         r, closing
    1 / l   inverse overlap at rest, or 1/m without compression    inverse_length
    S       force at rest, or K without compression                strength
    p       1 if compressed at rest, else 0                        pressed
    delta   exponent of the force                                  law.exponent
    ======  =====================================================  ========
    """
    inverse_length, strength, pressed = contact
    exponent = law.exponent
    if law.formulas != 0:
        change_in_time(law.formulas, r, closing, law.parameters, n, force, rate)
        return
    if exponent == 1.5 and not law.linear:
        _push_hertz(r, closing, inverse_length, strength, pressed, force, rate)
        return
    for i in range(r.size):
        s = r[i] * inverse_length
        y = max(pressed + s, 0.0)
        if law.linear:
            force[i] = strength * exponent * s
            rate[i] = strength * exponent * inverse_length * closing[i]
        elif y == 0.0:
            # The contact is open: the force at rest is lost, and 0 to a power below 1 has no rate.
            force[i] = -strength * pressed
            rate[i] = 0.0
        else:
            # This form of (1 + s)^delta - 1 preserves the digits of a weak wave.
            change = math.expm1(exponent * math.log1p(s)) if pressed > 0.0 else y**exponent
            force[i] = strength * change
            rate[i] = strength * exponent * y ** (exponent - 1.0) * inverse_length * closing[i]


@joined
def _visits(one, other, rise, climb):
    """Return whether the tangents at both ends meet beyond zero."""
    s = (other - climb - one) / (rise - climb)
    return rise != climb and 0.0 < s < 1.0 and (one + rise * s > 0.0) != (one > 0.0)


@compiled
def _nearly_opens(r, closing, contact, h):
    """Return the number of samples within one interval of an open contact."""
    inverse_length, _, pressed = contact
    count = 0
    for i in range(r.size):
        count += pressed + r[i] * inverse_length <= h * inverse_length * abs(closing[i])
    return count


@compiled
def _add_doubt(r, closing, contact, rate, mass, h, share, doubt):
    """Increase the error of an acceleration if the contact opens or closes after a sample.

    The jerk jumps where a contact opens or closes, so that the acceleration has a kink there; see
    `OpeningErrors`.
    """
    inverse_length, _, pressed = contact
    for i in range(r.size - 1):
        before = pressed + r[i] * inverse_length
        after = pressed + r[i + 1] * inverse_length
        rise = h * inverse_length * closing[i]
        climb = h * inverse_length * closing[i + 1]
        changed = (after > 0.0) != (before > 0.0)
        if not (changed or _visits(before, after, rise, climb)):
            continue
        off = OPENINGS.kink * h * abs(rate[i + 1] - rate[i])
        # In a collision shorter than an interval, the bodies were closer in between: they still
        # approach when the contact opens, or already recede when it closes.
        nearer = (after > 0.0 and climb < 0.0) or (before > 0.0 and rise > 0.0)
        if nearer if changed else after <= 0.0:
            off = max(off, OPENINGS.collision * mass * abs(closing[i + 1] - closing[i]) / h)
        doubt[i] = max(doubt[i], share * off)


@joined
def _inverse_mass(law, n):
    """Return the inverse mass of a body; 0 for a wall."""
    return law.inverse_mass[n - 1] if 0 < n <= law.inverse_mass.size else 0.0


@pasted
def _motion(block, n, rest):
    """Return the displacement and velocity of a body, (R,) each."""
    column = block.column[n]
    if n == block.imposed.wall_body:
        return block.imposed.wall[0], block.imposed.wall[1]
    if column < 0:
        return rest, rest
    return block.u[column], block.v[column]


@compiled
def _push_contact(block, n, work):
    """Fill in changes of the force of contact n and their rates; return if it nearly opens."""
    law = block.law
    contact = law.contacts[0, n], law.contacts[1, n], law.contacts[2, n]
    rest, r, closing, force, rate = work
    above, above_rate = _motion(block, n, rest)
    below, below_rate = _motion(block, n + 1, rest)
    # One loop for each result lets the compiler vectorise it.
    for i in range(r.size):
        r[i] = above[i] - below[i]
    for i in range(r.size):
        closing[i] = above_rate[i] - below_rate[i]
    _push(r, closing, contact, law, n, force, rate)
    return not law.linear and _nearly_opens(r, closing, contact, block.h) > 0


@compiled
def _accelerate(block, n, near, share, rows, work):
    """Add the acceleration of a body by contact n, `share` times its force, and its error."""
    law = block.law
    a, j, doubt = rows
    _, r, closing, force, rate = work
    for i in range(r.size):
        a[i] += share * force[i]
    for i in range(r.size):
        j[i] += share * rate[i]
    if near:
        contact = law.contacts[0, n], law.contacts[1, n], law.contacts[2, n]
        mass = 1.0 / (_inverse_mass(law, n) + _inverse_mass(law, n + 1))
        _add_doubt(r, closing, contact, rate, mass, block.h, abs(share), doubt)


@compiled
def _quintic(u, v, h, k, s):
    """Return a and j at k + s of the quintic through the samples k - 1, k and k + 1.

    The quintic is u(t) = u_k + v_k h t + c_2 t^2 + ... + c_5 t^5, with t from -1 to 1 in units of
    h. It has the recorded displacements and velocities at all three samples.

    ======  =====================================  ========
    symbol  meaning                                name
    ======  =====================================  ========
    u, v    displacement and velocity              u, v
    h       time between two samples               h
    t       time from sample k, in units of h      s
    c_n     coefficients                           c2 ... c5
    a, j    second and third derivative of u       returned
    ======  =====================================  ========
    """
    above = u[k + 1] - u[k]
    below = u[k - 1] - u[k]
    # Sums and differences of the two ends separate even and odd powers.
    even = (above + below) / 2
    odd = (above - below) / 2 - h * v[k]
    steep = h * (v[k + 1] - v[k - 1]) / 4
    bent = h * ((v[k + 1] + v[k - 1]) / 2 - v[k])
    c2 = 2 * even - steep
    c3 = (5 * odd - bent) / 2
    c4 = steep - even
    c5 = (bent - 3 * odd) / 2
    a = (2 * c2 + 6 * c3 * s + 12 * c4 * s**2 + 20 * c5 * s**3) / h**2
    return a, (6 * c3 + 24 * c4 * s + 60 * c5 * s**2) / h**3


@compiled
def _differentiate(u, v, h, rows):
    """Compute accelerations from the samples alone, by quintics through three samples."""
    a, j, doubt = rows
    last = u.size - 1
    # Fewer than four samples have no second quintic for comparison.
    if last < 3:
        for i in range(last + 1):
            doubt[i] = math.inf
        return
    for i in range(last + 1):
        k = min(max(i, 1), last - 1)
        a[i], j[i] = _quintic(u, v, h, k, float(i - k))
        earlier = max(k - 1, 1)
        later = min(k + 1, last - 1)
        # The quintics of the neighbours at the same sample give the error.
        one, _ = _quintic(u, v, h, earlier, float(i - earlier))
        other, _ = _quintic(u, v, h, later, float(i - later))
        doubt[i] = max(abs(one - a[i]), abs(other - a[i]))
    for i in range(last):
        doubt[i] = max(doubt[i], doubt[i + 1])


def derive(block: SampledBlock, grains: np.ndarray) -> Array:
    """Return accelerations, jerks and errors of the accelerations of G grains, (G, 3, R).

    Parameters
    ----------
    block : SampledBlock
        Samples of the motion.
    grains : (G,) array
        Numbers of the grains.
    """
    derived = np.zeros((grains.size, 3, block.u.shape[1]))
    lawful = block.lawful[grains]
    if not lawful.all():
        _fill_sampled(block.u, block.v, block.column[grains], lawful, block.h, derived)
    _fill_derived(
        block, grains, np.full(block.column.size, -1), derived, np.zeros((5, *derived.shape[2:]))
    )
    return derived


@compiled_measure()
def _fill_sampled(u, v, column, lawful, h, derived):
    """Compute the results of `derive` from the samples alone, as needed for damped chains."""
    for g in range(lawful.size):
        if not lawful[g]:
            _differentiate(u[column[g]], v[column[g]], h, derived[g])


@compiled_measure()
def _fill_derived(block, grains, row, derived, work):
    """Compute the results of `derive` by the law, and each body's row in them, or -1."""
    law = block.law
    imposed = block.imposed
    for g in range(grains.size):
        n = grains[g]
        if not block.lawful[n]:
            continue
        if law.inverse_mass[n - 1] > 0.0 and not (n == imposed.grain and imposed.driven):
            row[n] = g
        if n == imposed.grain:
            for i in range(derived.shape[2]):
                derived[g, 0, i] = imposed.acceleration[0, i]
                derived[g, 1, i] = imposed.acceleration[1, i]
                derived[g, 2, i] = imposed.doubt[i]
    # The loop runs over contacts, so that each force is computed once for its two bodies.
    for contact in range(row.size - 1):
        above = row[contact]
        below = row[contact + 1]
        if law.contacts[1, contact] == 0.0 or (above < 0 and below < 0):
            continue
        near = _push_contact(block, contact, work)
        if above >= 0:
            share = -law.inverse_mass[contact - 1]
            _accelerate(block, contact, near, share, derived[above], work)
        if below >= 0:
            share = law.inverse_mass[contact]
            _accelerate(block, contact, near, share, derived[below], work)
