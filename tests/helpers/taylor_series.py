"""A reference integrator: Taylor series in time, in extended precision, in `taylor_series.c`.

It shares only Eq. (1) with the package: equilibrium, force and time integration are independent.
Steps follow the radius of convergence, so that contacts that open and close cost no accuracy, and
the motion is known at any time. Its error is the distance to a second run of another order and with
tolerances a hundred times looser.
"""

from __future__ import annotations

import ctypes
import subprocess
import tempfile
from functools import cache
from math import ceil, log
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from helpers.forcing import Curve, below_load
from numpy.typing import NDArray

if TYPE_CHECKING:
    from lmpchain import Scene

Array = NDArray[np.float64]
FINEST = {"long double": 1e-20, "double": 1e-17}  # Tolerances of a step.
MOST_WORK = 5e8  # Contacts times steps times squared order; some 4 s in extended precision.


class Unresolved(ArithmeticError):
    """Raised if the reference integrator fails or needs too many steps."""


class Reference(NamedTuple):
    """Displacement and velocity (T, N) in SI, their maxima at any time, and steps and events."""

    displacement: Array
    velocity: Array
    largest: tuple[float, float]
    steps: int
    events: int

    def until(self, samples: int) -> Reference:
        """Return the first samples with the largest motion of the whole run."""
        return self._replace(
            displacement=self.displacement[:samples], velocity=self.velocity[:samples]
        )

    def error(self, displacement: Array, velocity: Array) -> float:
        """Return the error of a run relative to the largest motion."""
        pairs = zip(
            (displacement, velocity), (self.displacement, self.velocity), self.largest, strict=True
        )
        return max(
            float(np.abs(x - true).max()) / largest if largest else 0.0
            for x, true, largest in pairs
        )


@cache
def _library(kind: str) -> Any:
    folder = tempfile.TemporaryDirectory()
    built = Path(folder.name) / "taylor_series.so"
    source = Path(__file__).with_name("taylor_series.c")
    flags = ["-O3", "-march=native", "-ffp-contract=off", "-shared", "-fPIC", f"-DREAL={kind}"]
    subprocess.run(["cc", *flags, str(source), "-o", str(built), "-lm"], check=True)
    loaded = ctypes.CDLL(str(built))
    loaded.folder = folder  # The folder must exist as long as the library.
    return loaded


def solve(scene: Scene, tolerance: float, kind: str = "long double", more: int = 0) -> Reference:
    """Return the solution for an error tolerance per step, at the optimal order plus `more`.

    Raises
    ------
    Unresolved
        If steps become too short, or too many, or a series has no numbers.
    """
    real: Any = np.longdouble if kind == "long double" else np.float64
    chain = scene.chain
    excitation = scene.excitation
    wide = np.longdouble
    mass = np.asarray(chain.masses, dtype=wide)
    above, below = chain.wall_constants
    constant = np.concatenate(([above], chain.contact_constants, [below])).astype(wide)
    delta = wide(chain.exponent)
    force = wide(chain.gravity) * np.append(wide(0), np.cumsum(mass))
    force = force + wide(chain.top_load) * below_load(chain)
    force = np.where(constant > 0, force, 0)
    overlap = (force / np.where(constant > 0, constant, 1)) ** (1 / delta)
    mobile = np.ones(chain.grains, dtype=wide)
    if chain.bottom == "fixed":
        mobile[-1] = 0
    u, v = (np.asarray(x, dtype=wide) for x in scene.initial())
    farthest = np.abs(u).max()
    fastest = np.abs(v).max()
    drive, place, sines, end, knots, pieces = _acting(excitation)
    if drive and place <= 0:
        mobile[0] = 0 if place == 0 else 1
        farthest, fastest = _largest(sines, knots, pieces)
    typical = overlap.max()
    if typical == 0 and place > 0:
        typical = (_largest(sines, knots, pieces)[0] / constant.max()) ** (1 / delta)
    elif typical == 0:
        typical = max(farthest, (mass.min() * fastest**2 / constant.max()) ** (1 / (delta + 1)))
    time = 1 / np.sqrt(delta * constant.max() * typical ** (delta - 1) / mass.min())
    if place > 0:
        strongest, rise = _largest(sines, knots, pieces)
        farthest = min(strongest, rise * time) * time**2 / mass[place - 1]
    length = max(farthest, fastest * time)
    unit = mass.min() * length / time**2  # Unit of force.
    value = unit if place > 0 else length  # Unit of the forcing.
    fields = [
        constant * length**delta / unit,
        force / unit,
        overlap / length,
        mobile * (mass.min() / mass),
        *_damping(chain, time),
        np.concatenate((sines[:, 0] / value, sines[:, 1] * time, [end / time])),
        knots / time,
        pieces.reshape(-1, 4) * (time ** np.arange(4) / value),
        np.array([u / length, v * (time / length)]),
        np.asarray(scene.time, dtype=wide) / time,
    ]
    k, f, eps, mobility, viscosity, drag, sine, knots, pieces, start, instants = (
        np.ascontiguousarray(x, dtype=real) for x in fields
    )
    out = np.empty((scene.samples, 2, chain.grains))
    peak = np.empty(2)
    stats = np.empty(3)
    tolerance = max(tolerance, FINEST[kind])
    at = [np.ascontiguousarray(delta, dtype=real), k, f, eps, mobility, viscosity, drag]
    result = _library(kind).integrate(
        chain.grains,
        *map(_address, at),
        drive,
        place,
        len(sines),
        _address(sine),
        knots.size,
        _address(knots),
        _address(pieces),
        _address(start),
        scene.samples,
        _address(instants),
        ctypes.c_double(tolerance),
        min(ceil(-log(tolerance) / 2) + 3 + more, 36),
        ctypes.c_double(MOST_WORK),
        *map(_address, (out, peak, stats)),
    )
    if result:
        raise Unresolved(
            f"{['', 'too many steps', 'too short a step', 'not a number'][result]} "
            f"({stats[0]:g} steps, {stats[1]:g} events)"
        )
    scale = (float(length), float(length / time))
    return Reference(
        out[:, 0] * scale[0],
        out[:, 1] * scale[1],
        (peak[0] * scale[0], peak[1] * scale[1]),
        int(stats[0]),
        int(stats[1]),
    )


def _damping(chain: Any, time: Any) -> tuple[Array, Array]:
    """Return viscosities of contacts (N+1,) and drags on grains (N,) in units of this time."""
    size = chain.grains
    viscosity = np.zeros(size + 1, np.longdouble)
    drag = np.zeros(size, np.longdouble)
    if damping := getattr(chain, "damping", None):
        viscosity[1:-1] = damping.viscoelastic
        # A wall contact has the viscosity of the contact next to it.
        first, last = np.broadcast_to(damping.viscoelastic, max(size - 1, 1))[[0, -1]]
        viscosity[0] = first
        viscosity[-1] = last
        drag[:] = damping.drag
    return viscosity / time, drag * time


def _acting(excitation: Any) -> tuple[int, int, Array, float, Array, Array]:
    """Return kind, place, sines (S, 2) with their end, knots and pieces of the forcing.

    See `Drive` in the C file.
    """
    wide = np.longdouble
    none = 0, 0, np.zeros((1, 2), wide), wide(np.inf), np.zeros(1, wide), np.zeros(4, wide)
    if excitation.kind not in ("drive", "force"):
        return none
    place = excitation.grain if excitation.kind == "force" else excitation.grain - 1
    if excitation.times is not None:
        values = excitation.force if excitation.kind == "force" else excitation.displacement
        curve = Curve(excitation, values, wide)
        return 2, place, none[2], none[3], curve.knots, curve.pieces.T.copy()
    size = wide(excitation.amplitude)
    pi = 4 * np.arctan(wide(1))
    if getattr(excitation, "shape", None):  # A half-sine.
        return (
            1,
            place,
            np.array([[size, pi / wide(excitation.duration)]]),
            wide(excitation.duration),
            *none[4:],
        )
    omega = 2 * pi * wide(excitation.frequency)
    if excitation.cycles is None:
        return 1, place, np.array([[size, omega]]), *none[3:]
    # The identity is sin(w t) sin(w t / 2 c)^2 = sin(w t) / 2 - (sin(w + w/c) t + sin(w - w/c) t) /
    # 4.
    cycles = wide(excitation.cycles)
    sines = [
        [size / 2, omega],
        [-size / 4, omega * (1 + 1 / cycles)],
        [-size / 4, omega * (1 - 1 / cycles)],
    ]
    return 1, place, np.array(sines), cycles / wide(excitation.frequency), *none[4:]


def _largest(sines: Array, knots: Array, pieces: Array) -> tuple[Any, Any]:
    """Estimate the largest value and rate of the forcing."""
    if knots.size > 1:
        return np.abs(pieces[:, 0]).max(), np.abs(pieces[:, 1]).max()
    return np.abs(sines[:, 0]).sum(), np.abs(sines[:, 0] * sines[:, 1]).sum()


def _address(array: NDArray[Any]) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)


def reference(scene: Scene, tolerance: float) -> tuple[Reference, float]:
    """Return a solution with this error tolerance per step, and its error from a looser one.

    It is never below what all openings, and the ends of the wave, may leave out, for two solutions
    may leave out the same, nor below the digits that a burst loses as it begins: it is a sum of
    three sines.
    """
    best = solve(scene, tolerance)
    looser = solve(scene, 100 * tolerance, more=2)
    left_out = (best.events + 2) * max(tolerance, FINEST["long double"])
    if cycles := getattr(scene.excitation, "cycles", None):
        left_out += (
            np.finfo(np.longdouble).eps
            / min(1.0, scene.excitation.frequency / cycles * scene.duration) ** 2
        )
    return best, max(best.error(looser.displacement, looser.velocity), float(left_out))
