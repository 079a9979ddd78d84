"""Limits of the step: the longest stable step, and the energy drift."""

from __future__ import annotations

import math
from contextlib import closing
from dataclasses import dataclass
from functools import cache

import numpy as np

from .. import engines
from ..errors import InputError, RunFailed, not_among
from ..integrators.methods import METHODS
from ..integrators.steps import Steps
from ..scene.scene import Scene
from ..util.arrays import Array
from ..util.lazy import listed

__dir__ = listed(__name__)

BROKEN = 1.5  # Ratio of kinetic to total energy above which an engine rejects a run.
SCAN = 1.02  # Ratio of consecutive trial steps, and upper end of the band above the limit.
BLOCKS = 50  # Number of time intervals whose means determine a trend.


def struck_frequency(scene: Scene) -> float:
    """Return an estimate of the highest frequency during the motion, rad/s.

    A contact with the overlap o has the stiffness delta K o^(delta-1), so a chain is temporarily
    stiffer after a strike than at rest. By the virial theorem the mean elastic energy is 2 E /
    (delta + 3), with the energy E of the strike. It is assumed to be shared by n neighbouring
    contacts, with the n that maximises the frequency; the highest frequency of n equal springs is
    sqrt([2 + 2 cos(pi / (n + 1))] k / m). Compared with the eigenfrequencies of the exact motion at
    every moment, for strike numbers from 0.01 to 1e4, the estimate is accurate to 3 % in loaded
    chains and columns of Hertz contacts, and to 7 % for exponent 2. The energy of a forced scene is
    not known beforehand, and that on a ground is not in contacts alone; `Scene.highest_frequency`
    is returned in these cases.

    Parameters
    ----------
    scene : Scene
        The scene to run.

    Returns
    -------
    float
        Frequency, rad/s.
    """
    cone = scene.reached
    chain = cone.chain
    contacts = chain.contacts
    if cone.excitation.does_work or chain.ground is not None:
        return cone.highest_frequency
    displaced = chain.excess_energy(cone.initial()[0], np.zeros(chain.grains))
    elastic = max(contacts.law.elastic_share * cone.energy, float(displaced))
    inertia = np.zeros(chain.grains + 2)
    inertia[1 : chain.movable + 1] = 1 / chain.masses[: chain.movable]

    def worst(energy: float) -> float:
        """Return the highest squared frequency if up to 8 neighbouring contacts share an energy."""
        highest = 0.0
        for n in range(1, 9):
            stiffness = contacts.stiffness_bound(contacts.overlap_bound(energy / n))
            coupling = np.sqrt(stiffness[:-1] * stiffness[1:]) * inertia[1:-1]
            beside = np.append(coupling, 0.0) + np.append(0.0, coupling)
            alone = stiffness * (inertia[:-1] + inertia[1:])
            highest = max(highest, float((alone + math.cos(math.pi / (n + 1)) * beside).max()))
        return highest

    return math.sqrt(chain.band_edge**2 + worst(elastic) - worst(0.0))


def limit(scene: Scene, integrator: str) -> float:
    """Return the longest step, s, with which a scene is expected to conserve energy to its end.

    The limit is the stability limit of the method for an oscillator (`Method.stability_limit`),
    divided by the highest frequency after the strike. If a method amplifies oscillations at every
    step, as Gear's methods do, the step is also limited such that small oscillations gain at most
    half of their energy within the duration. In the sonic vacuum the same law gives
    h ~ E^(-(delta-1)/(2 delta+2)).

    On loaded chains, runs over a hundred periods with strike numbers up to 1e4 broke down at the
    following multiples of this limit: 0.93 to 1 verlet, 0.88 to 1 kahan-li6, 0.68 to 1.02
    dop853 (one step spans a whole collision), 1.3 to 1.6 rkn4, 2.5 to 3.1 rkn6 and 1 to 1.5
    kahan-li8 (see `suspect`), 1.2 to 2.4 gear4 (analysis/calibration/stability_limits.py).

    Parameters
    ----------
    scene : Scene
        The scene to run.
    integrator : str
        Name of the integrator.

    Returns
    -------
    float
        Time step, s.

    Raises
    ------
    InputError
        If the integrator is unknown.

    Examples
    --------
    >>> from lmpchain import Chain, Impulse
    >>> chain = Chain(grains=120, diameter=1e-3)
    >>> scene = Scene(chain=chain, excitation=Impulse(velocity=1e-6), duration=1e-3)
    >>> round(limit(scene, "verlet") * 1e6, 2)  # microseconds
    3.14
    """
    from scipy.optimize import brentq

    if integrator not in METHODS:
        raise InputError.at("integrator", not_among(integrator, tuple(METHODS)))
    method = METHODS[integrator]
    edge = scene.reached.chain.band_edge
    highest = struck_frequency(scene)
    # Without a frequency no contact is compressed and nothing moves.
    longest = method.stability_limit / highest if highest else math.inf

    def gain(reach: float) -> float:
        return 2 * math.log(method.growth(reach)) * edge * scene.duration / reach - math.log(BROKEN)

    reaches, growths = _growths(integrator)
    lasting = 2 * np.log(growths) * edge * scene.duration / reaches <= math.log(BROKEN)
    if lasting.all():
        return longest
    first = int(lasting.argmin())
    return min(longest, float(brentq(gain, reaches[first - 1], reaches[first])) / edge)


@cache
def _growths(integrator: str) -> tuple[Array, Array]:
    """Return steps omega h below the stability limit, and the growth of an oscillator per step."""
    method = METHODS[integrator]
    reaches = method.stability_limit * np.geomspace(1e-3, 0.999, 100)
    return reaches, np.array([method.growth(reach) for reach in reaches])


@cache
def suspect(integrator: str) -> float:
    """Return the omega h slightly above the stability limit with the fastest growth.

    The search covers 2 % above the limit.

    Above the limits of rkn4, rkn6 and kahan-li8 there is a band of unstable steps that is only
    0.16, 0.03 and 1.4 % wide, where a step is about half a period of the fastest grain. Above this
    band, steps are stable again up to 5.0, 6.3 and 5.6.

    Parameters
    ----------
    integrator : str
        Name of the integrator.

    Returns
    -------
    float
        The product omega h.
    """
    method = METHODS[integrator]
    reaches = method.stability_limit * np.linspace(1, SCAN, 1001)
    return float(max(reaches, key=method.growth))


def blow_up(scene: Scene, integrator: str, engine: str = "native") -> float:
    """Measure the longest step with which a scene does not break down, s.

    The result is infinite if no step fails.

    Runs with equal steps are repeated with steps that are longer by 2 %, including the step of
    `suspect`, until a run breaks down: the kinetic energy of a grain exceeds 1.5 times the total
    energy. The longest step is then found by bisection. Steps are passed to `Engine.start` as a
    proposal, which bypasses the check that rejects steps that are unstable at rest.

    Parameters
    ----------
    scene : Scene
        The scene to run.
    integrator : str
        Name of the integrator.
    engine : "native" or "lammps"
        Name of the engine.

    Returns
    -------
    float
        Time step, s.

    Raises
    ------
    InputError
        If the engine cannot solve the scene.
    """
    scene = scene.ungathered
    expected = limit(scene, integrator)
    solver = engines.get(engine, integrator=integrator, step=expected / 4)
    proposed = solver.propose(solver.part(scene), 0.5)
    edge = scene.reached.chain.band_edge
    suspected = suspect(integrator) / edge if edge else math.inf

    def survives(step: float) -> bool:
        # The number of samples is limited to 2000.
        steps = math.ceil(scene.duration / step / 2000)
        samples = max(1, int(scene.duration / step / steps))
        trial = scene.replace(duration=samples * steps * step, samples=samples + 1)
        proposal = proposed._replace(steps=Steps(steps, 1, step))
        try:
            with closing(solver.start([trial], proposal)) as run:
                for _ in run.blocks():
                    pass
        except RunFailed:
            return False
        return True

    low = expected / 2
    while not survives(low):
        low /= 2
    while survives(high := suspected if low < suspected < SCAN * low else SCAN * low):
        low = high
        if low > scene.duration / 2:
            return math.inf
    # Bisection reduces the uncertainty from 2 % to 2 % / 2^7.
    for _ in range(7):
        middle = math.sqrt(low * high)
        if survives(middle):
            low = middle
        else:
            high = middle
    return low


@dataclass(frozen=True, eq=False)
class EnergyError:
    """The energy error of a run over time.

    Attributes
    ----------
    time : (T,) array
        Times, s.
    error : (T,) array
        Relative change of the energy above rest since t = 0.
    step : float
        Step of the run, s.
    """

    time: Array
    error: Array
    step: float

    def trend(self) -> tuple[float, float]:
        """Return the drift rate, 1/s, and the half-width of its 99 % confidence interval.

        The drift is the slope of a straight line through the means of fifty time intervals. Energy
        moves slowly between modes, so that consecutive means are correlated. If their correlation
        is r, n means count as n (1 - r) / (1 + r) independent ones; B. D. Santer et al., J.
        Geophys. Res. 105, 7337 (2000).

        Raises
        ------
        InputError
            If there are fewer samples than time intervals.
        """
        from scipy import stats

        if self.time.size < BLOCKS:
            message = f"must be {BLOCKS} or more to show a trend (got {self.time.size})"
            raise InputError.at("samples", message)

        used = self.time.size // BLOCKS * BLOCKS
        time, error = (x[-used:].reshape(BLOCKS, -1).mean(1) for x in (self.time, self.error))
        line = stats.linregress(time, error)
        # A parabola is subtracted, because a drift that slows down is not a correlation.
        residual = error - np.polynomial.Polynomial.fit(time, error, 2)(time)
        correlation = max(0.0, float(residual[1:] @ residual[:-1] / (residual @ residual)))
        count = max(3.0, BLOCKS * (1 - correlation) / (1 + correlation))
        deviation = line.stderr * math.sqrt((BLOCKS - 2) / (count - 2))
        return float(line.slope), float(deviation * stats.t.ppf(0.995, count - 2))


def energy_error(
    scene: Scene, integrator: str, step: float, periods: float, samples: int = 2001
) -> EnergyError:
    """Return the energy error of a native run over many periods of the band edge.

    Energies are computed from displacements as differences from rest (`Chain.excess_energy`), which
    avoids cancellation for weak waves.

    Parameters
    ----------
    scene : Scene
        A scene without a force or drive.
    integrator : str
        Name of the integrator.
    step : float
        Time step, s.
    periods : float
        Duration, in periods of the band edge.
    samples : int
        Number of times at which the energy is computed.

    Returns
    -------
    EnergyError
        The error over time, relative to the energy at t = 0.

    Raises
    ------
    InputError
        If nothing compresses the chain at rest, the step is not stable there, or the scene has no
        energy.
    RunFailed
        If the run breaks down.
    """
    if not scene.chain.compressed:
        raise InputError.at("gravity", "a chain without gravity and load has no band edge")
    if scene.at_rest:
        raise InputError.at("excitation", "gives the chain no energy: strike or displace a grain")
    # This import is local, because the simulation room imports warnings of this room.
    from ..simulation.api import simulate

    duration = periods * 2 * math.pi / scene.chain.band_edge
    longer = scene.replace(duration=duration, samples=samples, grains="all", quantities=None)
    run = simulate(longer, engines.Native(integrator=integrator, step=step))
    energy = scene.chain.excess_energy(run.displacement, run.velocity)
    return EnergyError(run.time, energy / energy[0] - 1, run.cost.step_s)
