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

from ..util.arrays import Array
from .formula import ZERO, Formula
from .law import Law

# Points at which the largest stiffness is searched, relative to the largest displacement and
# duration.
PLACES = np.linspace(-1.0, 1.0, 17)
MOMENTS = np.linspace(0.0, 1.0, 65)


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
                f"must be one number, or {grains}, one per grain, not {len(value)}",
            )
    bends = [c for variable in ("u", "t") for c in law.formula.conditions(variable)]
    if bends:
        fault = f"bends where {bends[0].text} = 0"
        yield "ground.force", f"{fault}: use a smooth formula, without max, min, abs and step"
    elif not _rests(law):
        fault = "is not 0 at u = 0 at all times, so that grains would not rest"
        yield "ground.force", f"{fault}: write the force from the equilibrium on"
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
        The stiffness is looked for up to this displacement, m.
    duration : float
        And from t = 0 to this time, s, at 65 times.
    """
    times = MOMENTS * duration if "t" in law.formula.names else np.zeros(1)
    # Grains with individual parameters are evaluated together, one time after the other.
    alike = not any(np.ndim(value) for value in law.parameters)
    places = PLACES[:, None] * displacement
    largest: Any = 0.0
    with np.errstate(all="ignore"):
        for time in [times] if alike else times:
            size = np.abs(law.stiffness(places, time))
            size = np.where(np.isfinite(size), size, 0.0)
            largest = np.maximum(largest, size.max(axis=None if alike else 0))
    return np.asarray(largest)


@dataclass(frozen=True, eq=False)
class GroundKernel:
    """A ground formula prepared for compilation, equal for all values of its parameters.

    Attributes
    ----------
    force : Formula
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
