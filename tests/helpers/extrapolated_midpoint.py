"""A reference for laws by formula: the extrapolated midpoint rule in `extrapolated_midpoint.c`.

It shares only Eq. (1) with the package. A law is a sum of terms, written down a second time apart
from its formula; the overlaps at rest, the forces and the integration are independent. Steps end
where a contact crosses a kink, so that no kink costs accuracy. The error is the distance to a run
whose tolerance is a hundred times looser.
"""

from __future__ import annotations

import ctypes
import subprocess
import tempfile
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from helpers.taylor_series import Reference, Unresolved
from numpy.typing import NDArray

from lmpchain import Law, Scene

KINDS = ("power", "one-sided", "tanh", "exp", "sine", "soft", "log")
FINEST = {"long double": 1e-19, "double": 1e-16}
MOST_STEPS = 4e3


class Term(NamedTuple):
    """A term of a force, with numbers for all contacts or for each of the N-1 contacts.

    ``power`` a o^p; ``one-sided`` a max(sign (o - e), 0)^p; ``tanh`` a tanh(b o); ``exp``
    a (exp(b o) - 1); ``sine`` a sin(b o); ``soft`` a o / sqrt(1 + (b o)^2); ``log``
    a log(1 + b max(sign (o - e), 0)).
    """

    kind: str
    a: Any
    b: Any = 0.0
    e: Any = 0.0
    p: Any = 1.0
    sign: float = 1.0


@cache
def _library(kind: str) -> Any:
    folder = tempfile.TemporaryDirectory()
    built = Path(folder.name) / "extrapolated_midpoint.so"
    source = Path(__file__).with_name("extrapolated_midpoint.c")
    spacing = "LDBL_EPSILON" if kind == "long double" else "DBL_EPSILON"
    flags = ["-O2", "-shared", "-fPIC", f"-DREAL={kind}", f"-DEPS={spacing}"]
    subprocess.run(["cc", *flags, str(source), "-o", str(built), "-lm"], check=True)
    loaded = ctypes.CDLL(str(built))
    loaded.folder = folder  # The folder must exist as long as the library.
    return loaded


# The terms of every law that was drawn.
TERMS: dict[Law, list[Term]] = {}


def solve(scene: Scene, tolerance: float, kind: str = "long double") -> Reference:
    """Return the solution for an error tolerance per step, relative to the largest motion.

    The law of the chain must be one of `TERMS`.

    Raises
    ------
    Unresolved
        If there are too many steps, or a kink is not crossed.
    """
    real: Any = np.longdouble if kind == "long double" else np.float64
    chain = scene.chain
    terms = TERMS[chain.given_law]
    grains = chain.grains
    ends = np.clip(np.arange(grains + 1) - 1, 0, max(grains - 2, 0))

    def row(value: Any) -> NDArray[Any]:
        return np.broadcast_to(np.asarray(value, real), max(grains - 1, 1))[ends]

    laws = np.array(
        [
            [row(value) for value in column]
            for column in zip(*((t.a, t.b, t.e, t.p, t.sign) for t in terms), strict=True)
        ],
        real,
    )
    exists = np.ones(grains + 1)
    exists[0] = chain.top == "wall"
    exists[-1] = chain.bottom == "wall"
    mass = np.asarray(chain.masses, real)
    carried = real(chain.gravity) * np.append(real(0), np.cumsum(mass))
    carried[chain.load_grain if chain.load_grain > 1 or chain.top == "free" else 0 :] += real(
        chain.top_load
    )
    mobile = np.ones(grains)
    mobile[-1] = chain.bottom != "fixed"
    viscosity = np.broadcast_to(chain.damping.viscoelastic, max(grains - 1, 1))[ends]
    drag = np.broadcast_to(chain.damping.drag, grains)
    excitation = scene.excitation
    acts = excitation.kind in ("drive", "force")
    place, wave = 0, (0.0, 0.0, 0.0)
    if acts:
        place = excitation.grain if excitation.kind == "force" else excitation.grain - 1
        pi = 4 * np.arctan(real(1))
        half = getattr(excitation, "shape", None)
        omega = pi / excitation.duration if half else 2 * pi * real(excitation.frequency)
        end = excitation.duration if half else np.inf
        wave = (real(excitation.amplitude), omega, end)
        if place == 0:
            mobile[0] = 0
    fields = [
        laws,
        np.where(exists > 0, chain.contacts.overlap, 0.0),
        np.concatenate((carried * exists, exists, viscosity * exists, mass, mobile, drag)),
        np.array(wave, real),
        np.array(scene.initial()),
        scene.time,
    ]
    arrays = [np.array(x, dtype=real) for x in fields]
    if acts and place == 0:
        # A drive begins with the velocity of its sine.
        arrays[4][:, 0] = 0, wave[0] * wave[1]
    rate = scene.highest_frequency
    u, v = np.abs(arrays[4]).max(axis=1)
    if acts:
        size = wave[0] / mass.max() / max(rate, wave[1]) ** 2 if place > 0 else wave[0]
        u, v = max(u, abs(size)), max(v, abs(size * wave[1]))
    least = np.array([max(u, v / rate), max(v, u * min(rate, wave[1] or rate))], float) / 1e3
    kinds = np.array([KINDS.index(term.kind) for term in terms], np.int32)
    out = np.empty((scene.samples, 2, grains))
    peaks, stats = np.zeros(2), np.zeros(2)
    law, rest, column, sine, start, instants = map(_address, arrays)
    result = _library(kind).integrate(
        *(grains, len(terms), _address(kinds), law, rest, column, int(acts), place, sine, start),
        *(scene.samples, instants, ctypes.c_double(max(tolerance, FINEST[kind]))),
        ctypes.c_double(MOST_STEPS),
        *map(_address, (least, out, peaks, stats)),
    )
    if result:
        reasons = ["", "too many steps", "a kink is not crossed", "no rest"]
        raise Unresolved(reasons[result])
    return Reference(
        out[:, 0], out[:, 1], (float(peaks[0]), float(peaks[1])), int(stats[0]), int(stats[1])
    )


def _address(array: NDArray[Any]) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)


def reference(scene: Scene, tolerance: float) -> tuple[Reference, float]:
    """Return a solution with this error tolerance per step, and its error.

    The error is the distance to a run with a hundred times the tolerance, and never below the
    rounding error that both share: of the forces at rest in a weak wave.
    """
    rest = np.abs(scene.chain.contacts.overlap).max()
    coarse = solve(scene, max(tolerance, 1e-12))
    rounding = float(np.finfo(np.longdouble).eps * (10 + rest / coarse.largest[0]) * 10)
    tolerance = max(tolerance, rounding / 10)
    best = solve(scene, tolerance)
    looser = solve(scene, 100 * tolerance)
    return best, max(best.error(looser.displacement, looser.velocity), rounding)
