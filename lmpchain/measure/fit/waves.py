"""Linear theory fitted to a trajectory: eigenmodes (Eqs. 14-16), Bessel functions (6, 11, 13)."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, Literal, NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.special import jv

from ...chain.chain import Chain
from ...errors import InputError
from ...scene.excitation import Displacement, Impulse
from ...theory.modes import eigenmodes
from ...trajectory.trajectory import UNITS_OF_FIELDS, Trajectory
from ...util.arrays import Array, whole_numbers
from ...util.plotting import Axes, chart, choose_few, finish
from ...util.tabular import Tabular
from ..bodies import motion
from ..recorded import Field
from .table import Fitted, FittedNumber


class BesselRegion(NamedTuple):
    """Samples to which the solution of a uniform chain is fitted.

    Attributes
    ----------
    unevenness : float
        Largest relative difference of masses and stiffnesses in a chain that counts as uniform.
    forerunner : float
        Factor f in the time 2 s = m - f m^(1/3) before which no echo has arrived: J_m(2 s) is then
        below 1e-10.
    fewest : int
        Smallest number of values for three parameters and their errors.
    most : int
        Largest number of values; if there are more, some of the grains are left out.
    arrival : float
        Smallest size of a wave that has arrived, relative to the size of the strike.
    """

    unevenness: float = 0.05
    forerunner: float = 7.4
    fewest: int = 12
    most: int = 2**18
    arrival: float = 1e-3


REGION = BesselRegion()


@dataclass(frozen=True, eq=False, repr=False)
class ModeFit(Fitted, Tabular):
    """A motion as a superposition of eigenmodes.

    Attributes
    ----------
    frequency : (M,) array
        Frequencies, rad/s, ascending.
    time : (T,) array
        Times, s.
    amplitude : (T, M) array
        Mode amplitudes ``a_p = sum_n m_n X_pn phi_n``, m kg^(1/2); the modes are orthonormal in
        mass.
    rate : (T, M) array
        Time derivatives of the amplitudes, m kg^(1/2)/s.
    energy : (M,) array
        Energy (a'^2 + w^2 a^2) / 2 of each mode at t = 0, J.
    energy_error : (M,) array
        Standard deviation of this energy over the samples, J; 0 for a linear wave.
    given : float
        Energy of the scene at t = 0 including its nonlinear part, J; NaN if unknown.
    residual : (T,) array
        Relative deviation of the trajectory from the linear motion with the same state at t = 0,
        Eqs. (15) and (16): the largest ``|x - x_linear|`` of any grain over the largest ``|x|`` of
        all grains and samples. It is the larger of the values for displacement and velocity.
    """

    _units: ClassVar[dict[str, str]] = {"frequency": "rad/s", "energy": "J", "energy_error": "J"}

    frequency: Array
    time: Array
    amplitude: Array
    rate: Array
    energy: Array
    energy_error: Array
    residual: Array
    given: float = math.nan

    def rows(self) -> Iterator[FittedNumber]:
        """Yield the energy, the strongest mode, and the residual of the linear motion."""
        mode = int(self.energy.argmax())
        total = float(self.energy.sum())
        share = f"share of mode {mode + 1}, strongest"
        frequency = float(self.frequency[mode] / (2 * np.pi))
        yield FittedNumber("modes", "energy of all modes", total, expected=self.given, unit="J")
        yield FittedNumber("modes", share, float(self.share[mode]), float(self.share_error[mode]))
        yield FittedNumber("modes", "its frequency", frequency, unit="Hz")
        residual = float(self.residual.max())
        yield FittedNumber("modes", "residual of linear motion", residual, expected=0.0)

    @property
    def share(self) -> Array:
        """Fraction of the energy in each mode at t = 0, (M,); the sum is 1, or 0 at rest."""
        total = self.energy.sum()
        return self.energy / total if total else self.energy

    @property
    def share_error(self) -> Array:
        """Standard deviation of the energy of each mode over the total at t = 0, (M,)."""
        return self.energy_error / (self.energy.sum() or 1.0)

    def plot(self, ax: Axes | None = None, what: Literal["share", "residual"] = "share") -> Axes:
        """Draw the shares of energy over frequency, or the residual over time; return the axes."""
        if what == "residual":
            ax = chart(ax, "time [s]", "linear motion from t = 0,\nrelative residual")
            ax.plot(self.time, self.residual)
            ax.ticklabel_format(axis="y", useMathText=True)
            return ax
        ax = chart(ax, "frequency of the mode [Hz]", "share of the energy at t = 0 (%)")
        hertz = self.frequency / (2 * np.pi)
        percent = 100 * self.share
        error = 100 * self.share_error
        ax.errorbar(hertz, percent, yerr=error, fmt=".", markersize=4, elinewidth=1)
        title = f"Linear motion from t = 0: off by at most {self.residual.max():.1e}"
        return finish(ax, title)


def fit_modes(trajectory: Trajectory) -> ModeFit:
    """Project a motion onto the eigenmodes of the linearised chain; compare with linear evolution.

    Parameters
    ----------
    trajectory : Trajectory
        Run of any engine, in which all M grains that move were recorded. Time and memory grow as
        M^2.

    Returns
    -------
    ModeFit

    Raises
    ------
    InputError
        If the chain cannot be linearised, is forced or driven, or a grain that moves was not
        recorded.

    Examples
    --------
    >>> import lmpchain
    >>> chain = lmpchain.Chain(grains=20, diameter=1e-3)
    >>> strike = lmpchain.Impulse(velocity=1e-10)
    >>> scene = lmpchain.Scene(chain=chain, excitation=strike, duration=2e-5)
    >>> fit = fit_modes(lmpchain.simulate(scene, engine="chebyshev"))
    >>> fit.amplitude.shape, f"{fit.share.sum():.9f}", bool(fit.residual.max() < 1e-9)
    ((101, 19), '1.000000000', True)
    """
    chain = trajectory.scene.chain
    scene = trajectory.scene
    if scene.excitation.does_work:
        raise InputError.at(
            "excitation", "a driven chain does not move freely: strike or displace a grain instead"
        )
    chain.refuse_loose("a fit of modes")
    if (chain.contacts.exists & ~chain.contacts.pressed).any() and chain.compressed:
        raise InputError.at("top", "a wall that only touches cannot be linearised: give a top_load")
    modes = eigenmodes(chain)
    u, v = motion(trajectory, np.arange(1, chain.movable + 1))
    # The modes are orthonormal in mass, so the projection is a sum over m_n X_pn phi_n.
    weight = modes.mass[:, None] * modes.shape
    amplitude = u @ weight
    rate = v @ weight
    energy = (rate**2 + (modes.frequency * amplitude) ** 2) / 2
    linear = modes.response(trajectory.time, u[0], v[0])
    residuals = [
        np.abs(x - y).max(1) / (np.abs(x).max() or 1.0) for x, y in zip((u, v), linear, strict=True)
    ]
    return ModeFit(
        frequency=modes.frequency,
        time=trajectory.time,
        amplitude=amplitude,
        rate=rate,
        energy=energy[0],
        energy_error=energy.std(0),
        residual=np.maximum(*residuals),
        # The energy of the ground is not included.
        given=math.nan if chain.ground is not None else float(scene.energy),
    )


@dataclass(frozen=True, eq=False, repr=False)
class BesselFit(Fitted, Tabular):
    """A motion ``amplitude [J_(2|n-p|)(2s) + J_(2(n+p-1))(2s)]`` after a strike on grain p.

    Here s = rate (t - delay). The second term is the reflection from a free top, Eq. (11) if p = 1;
    it is absent below a wall, Eq. (6). Standard errors assume independent residuals such as noise,
    but errors of the model are not independent.

    Attributes
    ----------
    field : "velocity" or "displacement"
        Field of the initial motion of grain p, which is fitted.
    struck : int
        Number p of the struck grain.
    amplitude : float
        Initial velocity, m/s, or displacement, m, of grain p.
    rate : float
        sqrt(k / m) around grain p, 1/s, which is also the speed of long waves in grains/s.
    delay : float
        Time at which the wave starts, s.
    kappa : float
        rate^2 divided by k_1 / m_1 of the scene: kappa of Eq. (3).
    error : (4,) array
        Standard errors of amplitude, rate, delay and kappa.
    covariance : (3, 3) array
        Covariance of amplitude, rate and delay.
    expected : (4,) array
        Amplitude, rate, delay and kappa from the scene and theory.
    grain : (P,) array
        Grains of the fitted values.
    time : (P,) array
        Times of the fitted values, s.
    values, model : (P,) arrays
        Fitted values and their fit, m/s or m.
    residual : float
        Root mean square of values - model relative to the root mean square of values.
    """

    _units: ClassVar[dict[str, str]] = {
        "grain": "",
        "time": "s",
        "values": "{field}",
        "model": "{field}",
    }

    field: Field
    struck: int
    amplitude: float
    rate: float
    delay: float
    kappa: float
    error: Array
    covariance: Array
    expected: Array
    grain: np.ndarray
    time: Array
    values: Array
    model: Array
    residual: float

    def rows(self) -> Iterator[FittedNumber]:
        """Yield the amplitude, wave speed, delay and kappa, and the relative residual."""
        unit = UNITS_OF_FIELDS[self.field]
        values = {
            "amplitude": (self.amplitude, unit),
            "wave speed": (self.rate, "grains/s"),
            "delay": (self.delay, "s"),
            "kappa": (self.kappa, ""),
        }
        for (name, (value, unit)), error, expected in zip(
            values.items(), self.error.tolist(), self.expected.tolist(), strict=True
        ):
            yield FittedNumber("bessel", name, value, error, expected, unit)
        yield FittedNumber("bessel", "residual", self.residual, expected=0.0)

    def notes(self) -> Iterator[str]:
        """Yield the range of fitted grains and times."""
        yield (
            f"grains {self.grain.min()} to {self.grain.max()}, each until the first echo from an "
            "end of the uniform piece of chain can come"
        )

    def front_time(self, grain: int) -> float:
        """Return the time when the main maximum passes a grain, ``2s = m + 0.8086 m^(1/3)``, s.

        The formula holds for large ``m = 2 |n - p|``, where n is the grain and p the struck grain.
        """
        m = 2 * abs(grain - self.struck)
        return self.delay + (m + 0.8086 * np.cbrt(m)) / (2 * self.rate)

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the motion of some grains as points and the fit as lines; return the axes."""
        ax = chart(ax, "time [s]", f"{self.field}, downward [{UNITS_OF_FIELDS[self.field]}]")
        moving = np.unique(self.grain[np.abs(self.values) > 0.05 * np.abs(self.values).max()])
        for grain in moving[choose_few(moving.size)]:
            rows = self.grain == grain
            time = self.time[rows]
            label = f"grain {grain}"
            (points,) = ax.plot(time, self.values[rows], ".", markersize=4, label=label)
            ax.plot(time, self.model[rows], color=points.get_color(), lw=1)
        kappa = f"kappa {self.kappa:.5g} ± {self.error[3]:.1g}"
        title = f"{kappa}, residual {self.residual:.1e} (lines)"
        return finish(ax, title)


def fit_bessel(
    trajectory: Trajectory, grains: tuple[int, int] | None = None, until: float | None = None
) -> BesselFit:
    """Fit the solution of the uniform chain to the motion after a strike on one grain.

    The chain is infinite or has a free top.

    Parameters
    ----------
    trajectory : Trajectory
        Run of any engine.
    grains : (first, last), optional
        First and last grain of the fit; by default the grains around the struck grain p whose
        masses and contacts differ from its own by 5 % or less.
    until : float, optional
        Last time of the fit, s. By default grain n is fitted until the first echo from an end of
        this range, or of the chain, can arrive. For an end at grain e, this is the time at which
        ``2 s = m - 7.4 m^(1/3)``, ``m = 2 |2 e - n - p|``, for the nominal rate. If there are more
        than 262144 values, only every k-th grain that the wave has reached is fitted.

    Returns
    -------
    BesselFit

    Raises
    ------
    InputError
        If no single grain was struck or displaced, the chain is nowhere uniform, or too little was
        recorded.

    Examples
    --------
    >>> import lmpchain
    >>> chain = lmpchain.Chain(grains=40, diameter=1e-3, gravity=0.0, top_load=0.1)
    >>> duration = 20 * chain.time_scale
    >>> strike = lmpchain.Impulse(velocity=1e-7)
    >>> scene = lmpchain.Scene(chain=chain, excitation=strike, duration=duration)
    >>> fit = fit_bessel(lmpchain.simulate(scene, engine="native", tolerance=1e-9))
    >>> f"{fit.amplitude:.4g} m/s, kappa {fit.kappa:.4f}", bool(fit.residual < 1e-4)
    ('1e-07 m/s, kappa 1.0000', True)
    """
    trajectory.scene.chain.refuse_ground("a sum of Bessel functions")
    chain = trajectory.scene.chain
    strike = trajectory.scene.excitation
    field: Field = "velocity"
    if isinstance(strike, Impulse):
        size = strike.velocity
    elif isinstance(strike, Displacement):
        field = "displacement"
        size = strike.displacement
    else:
        raise InputError.at("excitation", "must be an impulse or a displacement of one grain")
    if not chain.compressed:
        raise InputError.at(
            "chain", "carries no force at rest: linear waves need gravity or a top load"
        )
    chain.refuse_loose("a fit of weak waves")
    if not size:
        raise InputError.at("excitation", "nothing moves: give a strike other than 0")
    p = strike.grain
    stiffness = chain.contacts.stiffness
    rate = float(np.sqrt((stiffness[p] or stiffness[p - 1]) / chain.masses[p - 1]))
    inside = _thin(_window(trajectory, p, rate, grains, until), trajectory, p, rate)
    n = np.broadcast_to(trajectory.grains, inside.shape)[inside]
    time = np.broadcast_to(trajectory.time[:, None], inside.shape)[inside]
    values = getattr(trajectory, field)[inside]
    # The value at t = 0 is prescribed.
    largest = np.abs(values[time > 0]).max(initial=0.0)
    if n.size < REGION.fewest or largest < REGION.arrival * abs(size):
        fault = f"the fit has {n.size} values, which are too few or do not show the wave"
        cure = f"record longer, more often, or more grains near grain {p}; or set grains and until"
        raise InputError.at("samples", f"{fault}: {cure}")
    orders = [2 * np.abs(n - p)] + [2 * (n + p - 1)] * (chain.top == "free")

    def residuals(x: Array) -> Array:
        z = 2 * (x[1] * rate * time - x[2])
        return x[0] * sum(jv(m, z) for m in orders) - values / size

    def slope(x: Array) -> Array:
        z = 2 * (x[1] * rate * time - x[2])
        change = x[0] * sum(jv(m - 1, z) - jv(m + 1, z) for m in orders)
        return np.stack([sum(jv(m, z) for m in orders), change * rate * time, -change], axis=1)

    solution = least_squares(
        residuals, [1.0, 1.0, 0.0], jac=slope, method="lm", xtol=1e-15, ftol=1e-15, gtol=1e-15
    )
    scatter = 2 * solution.cost / (n.size - 3) * np.linalg.pinv(solution.jac.T @ solution.jac)
    # Transform the fitted numbers to amplitude, rate and delay = x_2 / (x_1 rate).
    share, factor, angle = solution.x
    change = np.diag([size, rate, 1 / (factor * rate)])
    change[2, 1] = -angle / (factor**2 * rate)
    covariance = change @ scatter @ change.T
    error = np.sqrt(np.diag(covariance))
    unit = chain.time_scale
    kappa = (factor * rate * unit) ** 2
    return BesselFit(
        field=field,
        struck=p,
        amplitude=float(size * share),
        rate=float(factor * rate),
        delay=float(angle / (factor * rate)),
        kappa=float(kappa),
        error=np.append(error, 2 * kappa * error[1] / (factor * rate)),
        covariance=covariance,
        expected=np.array([size, rate, 0.0, (rate * unit) ** 2]),
        grain=n,
        time=time,
        values=values,
        model=values + size * solution.fun,
        residual=float(np.sqrt(np.mean(solution.fun**2) / np.mean((values / size) ** 2))),
    )


def _window(
    trajectory: Trajectory, p: int, rate: float, grains: tuple[int, int] | None, until: float | None
) -> np.ndarray:
    """Return the samples at which the solution of the uniform chain may apply, (T, G) bool."""
    chain = trajectory.scene.chain
    n = trajectory.grains
    time = trajectory.time[:, None]
    if chain.grains == 1:
        raise InputError.at("grains", "must be two or more: a single grain has no wave")
    first, last = _uniform_part(chain, p)
    if grains is not None:
        ends = whole_numbers(grains, "grains").reshape(-1)
        first, last = ends.tolist() if ends.size == 2 else (0, 0)
        if not 1 <= first <= p <= last <= chain.grains:
            raise InputError.at(
                "grains", f"must be (first, last) with 1 <= first <= {p} <= last (got {grains})"
            )
    elif last - first < 2:
        fault = f"is not uniform within {REGION.unevenness:.0%} around grain {p}"
        cure = "strike a grain further down, or set grains and until"
        raise InputError.at("chain", f"{fault}: {cure}")
    inside = (n >= first) & (n <= last)
    if until is not None:
        return inside & (time <= until)
    # Orders of the Bessel functions of the echoes from both ends.
    order = 2.0 * (2 * last - n - p)
    if first > 1 or chain.top == "wall":
        order = np.minimum(order, 2.0 * (n + p - 2 * first))
    order = np.maximum(order, 0.0)
    return inside & (2 * rate * time <= order - REGION.forerunner * np.cbrt(order))


def _thin(inside: np.ndarray, trajectory: Trajectory, p: int, rate: float) -> np.ndarray:
    """Remove grains at rest if there are too many values, and then a part of the others."""
    if np.count_nonzero(inside) <= REGION.most:
        return inside
    reach = 2 * rate * float(trajectory.time[-1])
    # At larger distances J_m(z) is below 1e-17.
    near = 2 * np.abs(trajectory.grains - p) <= reach + 12 * np.cbrt(reach) + 20
    columns = np.flatnonzero(near & inside.any(0))
    stride = max(1, -(-np.count_nonzero(inside[:, columns]) // REGION.most))
    chosen = np.zeros(inside.shape[1], dtype=bool)
    chosen[columns[::stride]] = True
    return inside & chosen


def _uniform_part(chain: Chain, p: int) -> tuple[int, int]:
    """Return the first and last grain of the uniform part around grain p."""
    k = chain.linear_stiffness
    m = chain.masses
    # Contact n lies between grains n and n + 1.
    equal_contact = np.abs(k / k[min(p, k.size) - 1] - 1) <= REGION.unevenness
    equal_mass = np.abs(m / m[p - 1] - 1) <= REGION.unevenness
    equal_mass[-1] |= chain.bottom == "fixed"
    first = last = p
    while first > 1 and equal_contact[first - 2] and equal_mass[first - 2]:
        first -= 1
    while last < chain.grains and equal_contact[last - 1] and equal_mass[last]:
        last += 1
    return first, last
