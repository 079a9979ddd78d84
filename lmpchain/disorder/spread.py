"""Spreading of energy in random chains: second moment, participation, transmission."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from .. import engines
from ..engines.base import Engine
from ..errors import InputError, shown
from ..scene.scene import Scene, check_scene
from ..util.arrays import Array, numbers
from ..util.plotting import Axes, chart, finish
from ..util.tabular import Tabular
from .averages import Average, Draw, StreamedAverages, draw_mean, take_average
from .draws import Law, Of, check, fault_of_count


@dataclass(frozen=True, eq=False, repr=False)
class Spreading(StreamedAverages, Tabular):
    """Mean spreading of energy in disordered chains of one scene, with standard errors.

    The energy of a grain is its kinetic energy, half of the energy of its contacts with other
    grains, and the energy of its contact with a wall.

    Attributes
    ----------
    scene : Scene
        The scene with the ordered chain.
    m, seed, law, of, engine, equation, realisations
        As for `Ensemble`.
    time : (T,) array
        Times, s.
    second_moment, second_moment_error : (T,) arrays
        Mean square distance of the energy from its centre at t = 0, grains squared; standard error.
    participation, participation_error : (T,) arrays
        Participation number, 1 / sum of the squared fractions of the energy, which is the number of
        grains over which the energy is spread; standard error.
    transmitted, transmitted_error : (T, N) arrays
        Fraction of the energy below each grain; standard error.
    model_error, solver_error, squeezed
        As for `Ensemble`.
    """

    _units: ClassVar[dict[str, str]] = {
        "time": "s",
        "second_moment": "",
        "second_moment_error": "",
        "participation": "",
        "participation_error": "",
        "transmitted": "",
        "transmitted_error": "",
    }
    _numbers: ClassVar[str] = "_depths"

    second_moment: Array
    second_moment_error: Array
    participation: Array
    participation_error: Array
    transmitted: Array
    transmitted_error: Array
    # Sums of the second moments of groups that contain every sixteenth chain.
    groups: Array = field(repr=False)

    @property
    def profile(self) -> Array:
        """Mean fraction of the energy in each grain, (T, N)."""
        return -np.diff(self.transmitted, axis=1, prepend=1.0)

    def growth(self, start: float = 0.0, end: float = np.inf) -> tuple[float, float]:
        """Return the exponent of the growth of the second moment in time, and its standard error.

        The exponent is the least-squares slope of the logarithms from `start` to `end`, s, with
        equal weight for all octaves of time. The error is a jackknife estimate over groups of
        chains, and NaN for a single chain.

        Raises
        ------
        InputError
            If the interval contains fewer than three samples, or if an end is not a number.
        """
        low, high = numbers(start, "start"), numbers(end, "end")
        within = (self.time >= low) & (self.time <= high) & (self.time > 0)
        if within.sum() < 3:
            message = f"must leave three samples or more up to the end (got {shown(start)})"
            raise InputError.at("start", message)
        logarithm = np.log(self.time[within])
        # Samples are evenly spaced in time, so the last octave contains most of them.
        weight = np.sqrt(np.gradient(logarithm))

        def slope(moment: Array) -> float:
            return float(np.polyfit(logarithm, np.log(moment[within]), 1, w=weight)[0])

        count = len(self.groups)
        error = np.nan
        if count > 1:
            without = [slope(self.groups.sum(0) - group) for group in self.groups]
            error = float(np.sqrt((count - 1) * np.var(without)))
        return slope(self.second_moment), error

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw second moment and participation with two standard errors, and return the axes."""

        ax = chart(ax, "time [s]", f"mean of {self.realisations} chains, m = {self.m:g}", "xy")
        for name, label in (
            ("second_moment", "second moment (grains²)"),
            ("participation", "participation (grains)"),
        ):
            # The first sample, at t = 0, is omitted on a logarithmic axis.
            error = getattr(self, f"{name}_error")[1:]
            draw_mean(ax, self.time[1:], getattr(self, name)[1:], error, label)
        return finish(ax)

    @property
    def _depths(self) -> range:
        return range(1, self.transmitted.shape[1] + 1)


def spreading(
    scene: Scene,
    m: float,
    realisations: int,
    seed: int,
    engine: str | Engine = "chebyshev",
    *,
    tolerance: float = 1e-6,
    law: Law = "dyson",
    of: Of = "stiffness",
    progress: bool = False,
) -> Spreading:
    """Return the spreading of an excitation's energy, averaged over many disordered chains.

    In a random linear chain the second moment grows as t^(3/2) after an impulse and as t^(1/2)
    after a displacement, while the participation remains finite: S. Lepri, R. Schilling and S.
    Aubry, Phys. Rev. E 82, 056602 (2010); for granular chains see A. J. Martinez, P. G. Kevrekidis
    and M. A. Porter, Phys. Rev. E 93, 022902 (2016). Memory contains only running means, for any
    number of chains.

    Parameters
    ----------
    scene : Scene
        The scene with the ordered chain, which must be so long that no energy reaches its ends. All
        grains are used, whichever grains are recorded.
    m, realisations, seed, engine, tolerance, law, of, progress
        As for `ensemble`. "chebyshev" and "modes" solve Eq. (3), with the energies of its springs.

    Returns
    -------
    Spreading

    Raises
    ------
    InputError, ToleranceNotMet, RunFailed
        As for `ensemble`, or if the excitation provides no energy at t = 0.

    Examples
    --------
    >>> from lmpchain import Chain, Impulse
    >>> chain = Chain(grains=61, diameter=1e-3, gravity=0.0, top_load=1.0, bottom="wall")
    >>> struck = Impulse(velocity=1e-9, grain=31)
    >>> scene = Scene(chain=chain, excitation=struck, duration=20 * chain.time_scale, samples=5)
    >>> spread = spreading(scene, m=5, realisations=10, seed=1)
    >>> spread.second_moment.shape, spread.transmitted.shape, f"{spread.participation[0]:.3f}"
    ((5,), (5, 61), '1.000')
    """
    check_scene(scene)
    scene.chain.refuse_ground("the spreading of energy")
    if scene.at_rest or scene.excitation.does_work:
        message = "must give the chain energy at t = 0 and must not act afterwards"
        raise InputError.at("excitation", message)
    check(fault_of_count(realisations, 1))
    scene = scene.replace(grains="all")
    # The scatter of 16 groups of chains gives the error of an exponent.
    groups = np.zeros((min(16, realisations), scene.samples))
    first = _Spread(
        *np.zeros((2, 2 + scene.chain.grains, scene.samples)),
        groups=groups,
        linear=engines.get(engine).equation != 1,
    )
    draw = Draw(scene, m, seed, law, of)
    average, options = take_average(draw, realisations, engine, tolerance, first, progress)
    errors = average.errors
    return Spreading(
        **options,
        second_moment=average.mean[0],
        second_moment_error=errors[0],
        participation=average.mean[1],
        participation_error=errors[1],
        transmitted=average.mean[2:].T,
        transmitted_error=errors[2:].T,
        groups=average.groups,
    )


@dataclass(eq=False)
class _Spread(Average):
    """Means of the second moment, participation and fractions below each grain, (2 + N, T)."""

    groups: Array = field(kw_only=True)
    linear: bool = field(kw_only=True)

    def measure(self, scene: Scene, displacement: Array, velocity: Array) -> Array:
        start = self._energy(scene, *scene.initial())
        number = np.arange(1, start.size + 1)
        energy = self._energy(scene, displacement, velocity)
        # Fractions are normalised at every sample, so that rounding errors of the total energy
        # cancel.
        share = energy / energy.sum(1)[:, None]
        # Distances are measured from the centre of the initial energy.
        moment = share @ (number - start @ number / start.sum()) ** 2
        # Summation from the bottom keeps the digits of small fractions far below.
        below = np.cumsum(share[:, :0:-1], axis=1)[:, ::-1]
        return np.concatenate(([moment, 1 / (share**2).sum(1)], below.T, np.zeros((1, len(share)))))

    def keep(self, number: int, samples: slice, value: Array) -> None:
        self.groups[number % len(self.groups), samples] += value[0]

    def _energy(self, scene: Scene, displacement: Array, velocity: Array) -> Array:
        """Return the energy of every grain, (..., N) J."""
        contacts = scene.chain.contacts
        closer = contacts.closer(displacement)
        elastic = contacts.stiffness / 2 * closer**2 if self.linear else contacts.energy(closer)
        # Two grains share their contact equally; the energy of a wall contact belongs to its grain.
        elastic[..., 1:-1] /= 2
        return scene.chain.masses / 2 * velocity**2 + elastic[..., :-1] + elastic[..., 1:]
