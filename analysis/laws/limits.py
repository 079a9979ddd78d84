"""Limiting cases: no gravity, springs, few grains, deep overlaps, buckling, large orders."""

from __future__ import annotations

import math
import tempfile
import warnings
from contextlib import closing
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import quad
from scipy.optimize import brentq
from scipy.special import gamma

from lmpchain.benchmark.comparison import error
from lmpchain.benchmark.reference import Reference
from lmpchain.chain.chain import Chain
from lmpchain.engines.lammps import deck
from lmpchain.engines.lammps.column import LammpsColumn
from lmpchain.engines.lammps.library import open_lammps
from lmpchain.integrators.methods import SPLITTINGS
from lmpchain.scene.excitation import Impulse, Profile
from lmpchain.scene.scene import Scene
from lmpchain.simulation.api import simulate
from lmpchain.theory import bessel
from lmpchain.theory.modes import Eigenmodes, between
from lmpchain.trajectory.trajectory import Trajectory
from lmpchain.util.arrays import EPSILON, Array

# Smallest m for which m^m in Eq. (23) as printed exceeds the largest double, 1.8e308.
MOST_PRINTED = 143
# Value of omega h of velocity Verlet at which the error of a straight column is negligible.
STEADY = 0.05
BEAD, TAU = 1e-3, 14.5  # The paper's beads, m, and its time of 100 us at g in units of tau.


def vacuum_power(exponent: float, loaded: bool) -> float:
    """Return p of g^p, by which the solution after a strike converges to that without gravity.

    Overlaps at rest shift every contact: without a load they are ``(m g n / K)^(1/delta)``; under a
    load F gravity changes them by ``n m g / F`` of themselves.
    """
    return 1.0 if loaded else 1 / exponent


def springs_error(grains: int, excess: ArrayLike) -> Array:
    """Return the deviation of v / v0 from linear springs at tau = 14.5, relative to its peak.

    The exponent of the column is 1 + excess.
    To first order in the excess: Eq. (19) with ``kappa_n = n^excess``.
    """
    n = np.arange(1, grains)
    small = 1e-6
    springs, near = (bessel.finite(n**power, n, 1, TAU) for power in (0.0, small))
    return np.asarray(excess) * np.abs(near - springs).max() / np.abs(springs).max() / small


def period(scene: Scene) -> float:
    """Return the period, s, of a chain with one degree of freedom.

    It has one moving grain, or grains 1 and 3 in antiphase. It has one degree of freedom, so
    ``T = 2 int dx / v(x)`` with v from the conserved energy, whatever the amplitude: one grain
    bounces on the one below, or flies, at large ones. Stretches end where a contact opens, and
    ``x = turn (1 - s^2)`` takes the root away at the turning points; right to some 1e-12.
    """
    chain = scene.chain
    velocity = scene.initial()[1]
    pattern = velocity / velocity.max()
    mass = float(chain.masses @ pattern**2)
    energy = scene.energy

    def left(x: float) -> float:
        return energy - float(chain.excess_energy(x * pattern, 0 * pattern))

    contacts = chain.contacts
    total = 0.0
    closer = contacts.closer(pattern)
    opens = (-contacts.overlap[closer != 0] / closer[closer != 0]).tolist()
    for side in (1.0, -1.0):
        far = side * chain.length_scale or side * BEAD * EPSILON
        while left(far) > 0:
            far *= 2
        turn = brentq(left, 0.0, far, xtol=1e-300, rtol=4 * EPSILON)
        ends = sorted(math.sqrt(1 - x / turn) for x in (0.0, turn, *opens) if 0 <= x / turn <= 1)

        def slowness(s: float, turn: float = turn) -> float:
            return 2 * abs(turn) * s / math.sqrt(max(2 * left(turn * (1 - s * s)) / mass, 1e-300))

        total += sum(quad(slowness, a, b, epsabs=0, epsrel=1e-12)[0] for a, b in pairwise(ends))
    return 2 * total


def buckling(chain: Chain, gauge: float = 0.0) -> Eigenmodes:
    """Return the buckling modes of a column of frictionless spheres.

    These are `.frequency`, rates of growth in 1/s, and `.shape`. A contact pushes along the line of
    centres, so sideways by ``F_n (x_n - x_(n+1)) / d_n`` away from the axis, and nothing pulls
    back: ``m x'' = +(F/d) Laplacian``. Alike grains under a load grow by up to
    ``2 sqrt(F / (m d))``. The gauge diameter, or else the physical one, less the overlap is d.
    """
    contacts = chain.contacts
    last = chain.movable
    apart = (gauge or chain.contact_lengths) - contacts.overlap
    push = contacts.force / apart
    push[[0, -1]] = 0.0  # Load and walls push along the axis.
    return between(push[: last + 1], chain.masses[:last])


def dyson_rounding(kappa: ArrayLike, m: ArrayLike) -> Array:
    """Return the relative rounding error of Eq. (23): ``m |kappa - 1|`` times the error of kappa.

    No less than that of the gamma function, some 32 roundings below m = 20.
    """
    return EPSILON * np.maximum(32.0, np.asarray(m) * np.abs(np.asarray(kappa) - 1))


def front_of_springs(n: ArrayLike) -> Array:
    """Return Eq. (11) at T = n - 1/2, ``2 J_nu(nu)`` with nu = 2n - 1, by its asymptotic series.

    Abramowitz and Stegun, 9.3.31; right to 1e-15 from n = 500 on.
    """
    nu = 2 * np.asarray(n, dtype=float) - 1
    a = 2 ** (1 / 3) / (3 ** (2 / 3) * gamma(2 / 3))
    b = 2 ** (2 / 3) / (3 ** (1 / 3) * gamma(1 / 3))
    return 2 * (
        a * nu ** (-1 / 3) * (1 - 1 / 225 / nu**2)
        - b * nu ** (-5 / 3) * (1 / 70 - 1213 / 1023750 / nu**2)
    )


def bessel_rounding(n: ArrayLike) -> Array:
    """Return the relative rounding error of Bessel functions of order 2n at the front.

    That of T is amplified by J' / J, to n^(2/3).
    """
    return EPSILON * (2 * np.asarray(n, dtype=float)) ** (2 / 3)


def from_vacuum(gravity: ArrayLike, exponent: float, load: float) -> Array:
    """Return the distances of solutions under gravity from that without; 1 cm/s, load in N."""

    def struck(g: float) -> Trajectory:
        chain = Chain(grains=20, diameter=BEAD, gravity=g, top_load=load, exponent=exponent)
        scene = Scene(chain=chain, excitation=Impulse(velocity=1e-2), duration=6e-5, samples=11)
        return simulate(scene, "native", 1e-11)

    without = struck(0.0)
    return np.array([_apart(struck(float(g)), without) for g in np.atleast_1d(gravity)])


def weak(
    exponent: float, gravity: float = 9.81, velocity: float | None = None, number: float = 0.3
) -> Scene:
    """Return a column of 30 beads until tau = 14.5, with a strike velocity or strike number."""
    chain = Chain(grains=30, diameter=BEAD, gravity=gravity, exponent=exponent)
    speed = number * chain.length_scale / chain.time_scale if velocity is None else velocity
    return Scene(
        chain=chain, excitation=Impulse(velocity=speed), duration=TAU * chain.time_scale, samples=30
    )


def from_linear(scene: Scene) -> float:
    """Return the error of linear theory against Eq. (1)."""
    with warnings.catch_warnings(action="ignore"):  # The error is the measured quantity.
        return _apart(simulate(scene, "modes", 0.9), simulate(scene, "native", 1e-11))


def from_springs(scene: Scene) -> float:
    """Return the distance of v / v0 from linear springs.

    (19) for springs at the last sample, over the largest.
    """
    n = np.arange(1, scene.chain.grains)
    springs = bessel.finite(np.ones(n.size), n, 1, TAU)
    velocity = simulate(scene, "native", 1e-11).velocity[-1, :-1] / scene.initial()[1][0]
    return float(np.abs(velocity - springs).max() / np.abs(springs).max())


def swinging(grains: int, number: float) -> Scene:
    """Return a scene with one degree of freedom for one period.

    It has 2 beads under gravity, or 3 between walls with the middle one at rest.
    """
    chain = (
        Chain(grains=2, diameter=BEAD)
        if grains == 2
        else Chain(grains=3, diameter=BEAD, gravity=0.0, top_load=1e-3, top="wall", bottom="wall")
    )
    speed = number * chain.length_scale / chain.time_scale * np.array([1.0, 0.0, -1.0])[:grains]
    scene = Scene(chain=chain, excitation=Profile(velocity=speed), duration=1.0, samples=9)
    return Scene(**scene.given() | {"duration": period(scene)})


def measured_period(scene: Scene) -> float:
    """Return the period of `swinging` in the native engine, s, from the phase of grain 1."""
    end = simulate(scene, "native", 1e-9)
    return float(scene.duration - end.displacement[-1, 0] / end.velocity[-1, 0])


def squeezing(strain: float) -> Scene:
    """Return 10 beads under gravity, struck for an overlap of `strain` diameters of two beads."""
    chain = Chain(grains=10, diameter=BEAD)
    power = chain.exponent + 1
    overlap = strain * BEAD
    speed = math.sqrt(
        4 / power * float(chain.contact_constants[0] / chain.masses[0]) * overlap**power
    )
    return Scene(
        chain=chain, excitation=Impulse(velocity=speed), duration=60 * overlap / speed, samples=101
    )


def squeezed(scene: Scene) -> tuple[float, float]:
    """Return the largest overlap over the diameter, and the difference of LAMMPS and native."""
    native = simulate(scene, "native", 1e-11)
    contacts = scene.chain.contacts
    overlap = (
        contacts.overlap + contacts.closer(native.displacement)
    ) / scene.chain.contact_lengths
    lammps = simulate(scene, "lammps", 1e-6)
    return float(overlap[:, contacts.exists].max()), _apart(lammps, native)


def bent(chain: Chain, gauge: float, offset: Array, duration: float, samples: int = 40) -> Array:
    """Return the largest distance from the axis of a bent column in LAMMPS, (samples + 1,) m.

    Parameters
    ----------
    gauge : float
        Diameter to draw grains with, m; 0 for the physical one.
    offset : (N,) array
        m.
    """
    still = Scene(
        chain=chain, excitation=Impulse(velocity=0.0), duration=duration, samples=samples + 1
    )
    column = LammpsColumn(still, gauge)
    steps = math.ceil(duration / samples * chain.band_edge / STEADY)
    with tempfile.TemporaryDirectory() as folder, closing(open_lammps()) as lammps:
        deck.write_data(column, data := Path(folder) / "column.data")
        lammps.commands_string(
            deck.setup(column, str(data), duration / samples / steps, SPLITTINGS["verlet"])
        )
        lammps.numpy.extract_atom("x")[: chain.grains, 0] = offset
        lammps.command("run 0 post no")
        distance = [np.abs(offset).max()]
        for _ in range(samples):
            lammps.command(f"run {steps} pre no post no")
            distance.append(np.abs(lammps.numpy.extract_atom("x")[: chain.grains, 0]).max())
    return np.array(distance)


def growth(chain: Chain, gauge: float, offset: float = 1e-15) -> float:
    """Return the growth rate, 1/s, of the fastest buckling mode in LAMMPS, from `offset` m on."""
    modes = buckling(chain, gauge)
    shape = np.append(modes.shape[:, -1], np.zeros(chain.grains - chain.movable))
    duration = 8 / float(modes.frequency[-1])
    distance = bent(chain, gauge, offset * shape / np.abs(shape).max(), duration)
    return float(np.arccosh(distance[-1] / distance[0]) / duration)  # The column starts from rest.


def _apart(trajectory: Trajectory, other: Trajectory) -> float:
    return error(
        trajectory, Reference(other.time, other.displacement, other.velocity, 0.0, other.engine)
    )
