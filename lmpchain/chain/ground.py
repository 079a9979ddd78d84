"""Forces from the ground: a spring on every grain, whose stiffness may depend on time.

The force ``F(u, t)`` pulls a grain back, ``m phi'' = ... - F(phi, t)``. It is 0 at ``u = 0``, so
that grains rest where they would without a ground.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from ..errors import InputError
from ..util.arrays import Array
from .formula import ZERO, Formula
from .law import SMOOTH, Law, bend_powers

# Times, s, at which the powers of kinks are determined.
KINK_TIMES = (0.0, 1 / 3, 1.0)
# Displacements (relative to the largest) and times (relative to the duration) at which the largest
# stiffness is sought.
CHECKED_DISPLACEMENTS = np.linspace(-1.0, 1.0, 17)
MOMENTS = np.linspace(0.0, 1.0, 65)
# The work against the ground is integrated over pieces of a displacement, each exact up to degree
# 15. Their number is doubled until the work changes by less than this part, or is as large as this.
GAUSS = np.array(np.polynomial.legendre.leggauss(8)).T * 0.5 + [0.5, 0.0]
SETTLED = 1e-14
MOST_PIECES = 256


def misfits(law: Any, grains: int) -> Iterator[tuple[str, str]]:
    """Yield the reasons why a law cannot describe the ground under this number of grains."""
    if not isinstance(law, Law) or not law.of_ground:
        fault = "depends on the overlap o, but the ground acts by the displacement u"
        yield "ground.force", f"{fault} and the time t"
        return
    for key, value in law.given.items():
        if isinstance(value, tuple) and len(value) != grains:
            yield (
                f"ground.{key}",
                f"must be one number, or {grains} (one per grain), not {len(value)}",
            )
    bends = law.formula.conditions("t")
    if bends:
        fault = f"bends where {bends[0].text} = 0"
        yield "ground.force", f"{fault}: use max, min, abs and step of the displacement u alone"
        return
    try:
        law.formula.kinks("u")
    except InputError as error:
        yield from ((f"ground.{key}", message) for key, message in error.faults)
        return
    if not _rests(law):
        fault = "is not 0 at u = 0 at all times, so that grains would not rest"
        yield "ground.force", f"{fault}: subtract the force at u = 0"
    else:
        with np.errstate(all="ignore"):
            stiffness = law.stiffness(0.0, 0.0)
        if not np.isfinite(stiffness).all():
            yield "ground.force", "has no finite stiffness at rest: use a formula smooth at u = 0"


def _rests(law: Law) -> bool:
    """Return whether the force is 0 at u = 0 at all times."""
    if law.formula.substitute({"u": 0.0}) is ZERO:
        return True
    kinds = {len(value) for value in law.given.values() if isinstance(value, tuple)} or {1}
    return all(
        law.formula.substitute({**law._numbers(n), "u": 0.0}) is ZERO for n in range(max(kinds))
    )


def onset(law: Law) -> float:
    """Return the lowest power of the distance to a kink with which the force bends there."""
    sizes = [len(value) for value in law.given.values() if isinstance(value, tuple)]
    kinks = law.formula.kinks("u")
    powers = [SMOOTH]
    # The size of a jump may be 0 at one time.
    for time in KINK_TIMES:
        for values in map(law._numbers, {0, max(sizes, default=1) - 1}):
            formula = law.formula.substitute({**values, "t": time})
            powers += bend_powers(formula, kinks, values, "u")
    return min(powers)


def is_spring(law: Law) -> bool:
    """Return whether the ground force on every grain is linear in its displacement, at any time."""
    slope = law.formula.derivative("u")
    return not {"u", "t"} & {*slope.names} and bool(np.all(law.stiffness(0.0, 0.0) >= 0))


def largest_stiffness(law: Law, displacement: float, duration: float) -> Array:
    """Return the largest absolute stiffness of every grain, (N,) or () N/m.

    Parameters
    ----------
    law : Law
    displacement : float
        Largest displacement, m, at which the stiffness is evaluated.
    duration : float
        Latest time, s; the stiffness is evaluated at 65 times from t = 0.
    """
    times = MOMENTS * duration if "t" in law.formula.names else np.zeros(1)
    # Grains with individual parameters are evaluated together, one time after the other.
    alike = not any(np.ndim(value) for value in law.parameters)
    places = CHECKED_DISPLACEMENTS[:, None] * displacement
    largest: Any = 0.0
    with np.errstate(all="ignore"):
        for time in [times] if alike else times:
            size = np.abs(law.stiffness(places, time))
            size = np.where(np.isfinite(size), size, 0.0)
            largest = np.maximum(largest, size.max(axis=None if alike else 0))
    return np.asarray(largest)


def energy(law: Law, displacement: Array) -> Array:
    """Return the energy of the ground under every grain at these displacements, (..., N) J.

    It is the integral of the force at t = 0 over the displacement from rest. Its relative accuracy
    does not depend on the amplitude of the wave.
    """
    pieces = 1
    coarse = _work(law, displacement, pieces)
    while pieces < MOST_PIECES:
        pieces *= 2
        fine = _work(law, displacement, pieces)
        if (np.abs(fine - coarse) <= SETTLED * np.abs(fine)).all():
            return fine
        coarse = fine
    return coarse


def _work(law: Law, displacement: Array, pieces: int) -> Array:
    """Return the energy at each displacement by Gauss quadrature over equal pieces."""
    width = displacement / pieces
    total = np.zeros(displacement.shape)
    for piece in range(pieces):
        for node, weight in GAUSS:
            total += weight * law.force((piece + node) * width, 0.0)
    return total * width


def join_contacts(force: Array, pull: Array) -> Array:
    """Return forces of contacts, (T, N+1) N, whose differences include the pulls, (T, N) N.

    In the result, the force above a grain minus the force below it is the sum of the forces of both
    contacts and of the ground on the grain.
    """
    joined = force.copy()
    joined[:, 1:] += np.cumsum(pull, axis=1)
    return joined


@dataclass(frozen=True, eq=False)
class GroundKernel:
    """A ground formula prepared for compilation, equal for all values of its parameters.

    Attributes
    ----------
    force : Formula
        Force that pulls a grain back, a function of u and t.
    codes : dict
        Index expression of each parameter in an array with a column for each body.
    """

    force: Formula
    codes: dict[str, str]


def kernel_of(law: Law) -> GroundKernel:
    """Return the ground formula in the form that the native engine compiles."""
    return _kernel(law.formula, tuple(law.names))


@cache
def _kernel(formula: Formula, names: tuple[str, ...]) -> GroundKernel:
    return GroundKernel(formula, {key: f"given[{n}, n]" for n, key in enumerate(names)})


def parameter_rows(law: Law, grains: int) -> Array:
    """Return the parameters of every grain, (P, N)."""
    rows = [np.broadcast_to(value, grains) for value in law.parameters]
    return np.array(rows).reshape(len(rows), grains)
