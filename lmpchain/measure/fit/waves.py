"""Linear theory fitted to a trajectory: eigenmodes (Eqs. 14-16), Bessel functions (6, 11, 13)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from scipy.optimize import least_squares
from scipy.special import jv

from ...chain.chain import Chain
from ...errors import InputError
from ...scene.excitation import Displacement, Impulse
from ...theory.modes import eigenmodes
from ...trajectory.picture import UNITS
from ...trajectory.trajectory import Trajectory
from ...util.arrays import Array
from ...util.notebook import Shown
from ...util.plotting import axes_in_units, legend, set_title
from ..bodies import motion
from ..recorded import Field

if TYPE_CHECKING:
    from matplotlib.axes import Axes

EVEN = 0.05  # relative differences of masses and stiffnesses up to which a chain counts as uniform
FORERUNNER = 7.4  # J_m(m - 7.4 m^(1/3)) is below 1e-10: no echo has arrived
FEWEST = 12  # values for three parameters and their errors
# values that are fitted: of longer chains and recordings, those of every so many grains
MOST = 2**18
ARRIVED = 1e-3  # of the strike: the recorded wave must be larger
DRAWN = 4  # grains in a picture


@dataclass(frozen=True, eq=False, repr=False)
class ModeFit(Shown):
    """A motion as a superposition of eigenmodes.

    Attributes
    ----------
    frequency : (M,) array
        rad/s, ascending.
    time : (T,) array
        s.
    amplitude, rate : (T, M) arrays
        ``a_p = sum_n m_n X_pn phi_n`` with modes orthonormal in mass, m kg^(1/2), and its rate, m
        kg^(1/2)/s.
    energy, energy_error : (M,) arrays
        (a'^2 + w^2 a^2) / 2 of each mode at t = 0, J, and its standard deviation over the samples,
        0 for a linear wave.
    residual : (T,) array
        How far the linear motion from the state at t = 0, Eqs. (15) and (16), is from the
        trajectory: max|x - x_linear| over the grains over max|x| over grains and samples, the
        larger of displacement and velocity.
    """

    frequency: Array
    time: Array
    amplitude: Array
    rate: Array
    energy: Array
    energy_error: Array
    residual: Array

    @property
    def share(self) -> Array:
        """Fraction of the energy in each mode at t = 0, (M,); they sum to 1 (0 at rest)."""
        total = self.energy.sum()
        return self.energy / total if total else self.energy

    @property
    def share_error(self) -> Array:
        """Standard deviation of the energy of each mode over time, relative to the total at t = 0, (M,)."""
        return self.energy_error / (self.energy.sum() or 1.0)

    def plot(self, ax: Axes | None = None, what: Literal["share", "residual"] = "share") -> Axes:
        """Draw the energy fractions against frequency with their variation, or the residual over time."""
        if what == "residual":
            ax = axes_in_units(ax, "s", "")
            ax.plot(self.time, self.residual)
            ax.set(xlabel="time", ylabel="linear motion from t = 0,\nrelative residual")
            return ax
        ax = axes_in_units(ax, "Hz", "")
        hertz = self.frequency / (2 * np.pi)
        ax.errorbar(
            hertz,
            100 * self.share,
            yerr=100 * self.share_error,
            fmt=".",
            markersize=4,
            elinewidth=1,
        )
        ax.set(xlabel="frequency of the mode", ylabel="share of the energy at t = 0 (%)")
        set_title(ax, f"Linear motion from t = 0: off by at most {self.residual.max():.1e}")
        return ax


def fit_modes(trajectory: Trajectory) -> ModeFit:
    """Project a motion onto the eigenmodes of the linearised chain; compare with linear evolution.

    Parameters
    ----------
    trajectory : Trajectory
        Of any engine, with all grains that move. Time and memory grow as M^2.

    Returns
    -------
    ModeFit

    Raises
    ------
    InputError
        If nothing can be linearised, grain 1 is driven, or a grain that moves was not recorded.

    Examples
    --------
    >>> import lmpchain
    >>> chain = lmpchain.Chain(grains=20, diameter=1e-3)
    >>> scene = lmpchain.Scene(chain=chain, excitation=lmpchain.Impulse(velocity=1e-10), duration=2e-5)
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
    if (chain.contacts.exists & ~chain.contacts.pressed).any() and chain.compressed:
        raise InputError.at("top", "a wall that only touches cannot be linearised: give a top_load")
    modes = eigenmodes(chain)
    u, v = motion(trajectory, np.arange(1, chain.movable + 1))
    weight = modes.mass[:, None] * modes.shape
    amplitude = u @ weight
    rate = v @ weight
    energy = (rate**2 + (modes.frequency * amplitude) ** 2) / 2
    linear = modes.response(trajectory.time, u[0], v[0])
    off = [
        np.abs(x - y).max(1) / (np.abs(x).max() or 1.0) for x, y in zip((u, v), linear, strict=True)
    ]
    return ModeFit(
        modes.frequency,
        trajectory.time,
        amplitude,
        rate,
        energy[0],
        energy.std(0),
        np.maximum(off[0], off[1]),
    )


@dataclass(frozen=True, eq=False, repr=False)
class BesselFit(Shown):
    """A motion ``amplitude [J_(2|n-p|)(2s) + J_(2(n+p-1))(2s)]`` after a strike on grain p.

    Here s = rate (t - delay). The second term is the image in a free top, Eq. (11) if p = 1; under
    a wall it is absent, Eq. (6). Standard errors assume independent residuals, as of noise; model
    errors are not independent.

    Attributes
    ----------
    field : "velocity" or "displacement"
        What was given to grain p, and is fitted.
    struck : int
        p.
    amplitude, rate, delay : float
        m/s or m; sqrt(k / m) there, 1/s, also the speed of long waves in grains a second; when the
        wave set out, s.
    kappa : float
        rate^2 over k_1 / m_1 of the scene: kappa of Eq. (3).
    error : (4,) array
        One standard error of amplitude, rate, delay and kappa.
    covariance : (3, 3) array
        Of amplitude, rate and delay.
    expected : (4,) array
        The values that scene and theory give.
    grain, time, values, model : (P,) arrays
        What was fitted: grains, s, m/s or m, and the fit there.
    residual : float
        Root mean square of values - model over that of values.
    """

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

    def front_time(self, grain: int) -> float:
        """Return when the main maximum passes a grain, ``2s = m + 0.8086 m^(1/3)``, s.

        Here ``m = 2 |n - p|``, which must be large.
        """
        m = 2 * abs(grain - self.struck)
        return self.delay + (m + 0.8086 * np.cbrt(m)) / (2 * self.rate)

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the motion of some of the grains as points and the fit as lines; returns the axes."""
        ax = axes_in_units(ax, "s", UNITS[self.field])
        present = np.unique(self.grain[np.abs(self.values) > 0.05 * np.abs(self.values).max()])
        chosen = present[np.unique(np.linspace(0, present.size - 1, DRAWN).round().astype(int))]
        for number in chosen:
            here = self.grain == number
            (points,) = ax.plot(
                self.time[here], self.values[here], ".", markersize=4, label=f"grain {number}"
            )
            ax.plot(self.time[here], self.model[here], color=points.get_color(), lw=1)
        ax.set(xlabel="time", ylabel=f"{self.field}, downward")
        set_title(
            ax,
            f"kappa {self.kappa:.5g} ± {self.error[3]:.1g}, residual {self.residual:.1e} (lines)",
        )
        legend(ax)
        return ax


def fit_bessel(
    trajectory: Trajectory, grains: tuple[int, int] | None = None, until: float | None = None
) -> BesselFit:
    """Fit the solution of the uniform chain to the motion after a strike on one grain.

    The chain is infinite or has a free top.

    Parameters
    ----------
    trajectory : Trajectory
        Of any engine.
    grains : (first, last), optional
        By default those around the struck one whose mass and contacts are like its own within 5 %.
    until : float, optional
        s. By default each grain is taken until the first echo from the end of that region, or of
        the chain, can come: until ``2 s = m - 7.4 m^(1/3)``, m = 2 (2 end - n - p), at the nominal
        rate. Of more than 262144 values, those of every so many of the grains that the wave has
        reached are fitted.

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
    >>> scene = lmpchain.Scene(chain=chain, excitation=lmpchain.Impulse(velocity=1e-7), duration=duration)
    >>> fit = fit_bessel(lmpchain.simulate(scene, engine="native", tolerance=1e-9))
    >>> f"{fit.amplitude:.4g} m/s, kappa {fit.kappa:.4f}", bool(fit.residual < 1e-4)
    ('1e-07 m/s, kappa 1.0000', True)
    """
    scene = trajectory.scene
    chain = trajectory.scene.chain
    given = scene.excitation
    if not isinstance(given, Impulse | Displacement):
        raise InputError.at(
            "excitation", "takes an impulse or displacement of one grain: strike one"
        )
    if not chain.compressed:
        raise InputError.at(
            "chain", "carries no force at rest: nothing is linear without gravity or a top load"
        )
    field: Field = "velocity" if isinstance(given, Impulse) else "displacement"
    size = given.velocity if isinstance(given, Impulse) else given.displacement
    if not size:
        raise InputError.at("excitation", "nothing moves: give a strike other than 0")
    p = given.grain
    stiffness = chain.contacts.stiffness
    near = stiffness[p] or stiffness[p - 1]
    rate = float(np.sqrt(near / chain.masses[p - 1]))
    inside = _thinned(_window(trajectory, p, rate, grains, until), trajectory, p, rate)
    n = np.broadcast_to(trajectory.grains, inside.shape)[inside]
    time = np.broadcast_to(trajectory.time[:, None], inside.shape)[inside]
    values = getattr(trajectory, field)[inside]
    # at t = 0 it is prescribed
    if n.size < FEWEST or np.abs(values[time > 0]).max(initial=0.0) < ARRIVED * abs(size):
        cure = "record more often or for longer, more grains near it, or give grains and until"
        reason = (
            f"{n.size} values lie where the solution can hold, too few, or without the wave: {cure}"
        )
        raise InputError.at("samples", reason)
    orders = [2 * np.abs(n - p)] + [2 * (n + p - 1)] * (chain.top == "free")

    def off(x: Array) -> Array:
        z = 2 * (x[1] * rate * time - x[2])
        return x[0] * sum(jv(m, z) for m in orders) - values / size

    def slope(x: Array) -> Array:
        z = 2 * (x[1] * rate * time - x[2])
        steep = x[0] * sum(jv(m - 1, z) - jv(m + 1, z) for m in orders)
        return np.stack([sum(jv(m, z) for m in orders), steep * rate * time, -steep], axis=1)

    solution = least_squares(
        off, [1.0, 1.0, 0.0], jac=slope, method="lm", xtol=1e-15, ftol=1e-15, gtol=1e-15
    )
    spread = 2 * solution.cost / (n.size - 3) * np.linalg.pinv(solution.jac.T @ solution.jac)
    # from the fitted numbers to amplitude, rate and delay = x_2 / (x_1 rate)
    share, factor, angle = solution.x
    change = np.diag([size, rate, 1 / (factor * rate)])
    change[2, 1] = -angle / (factor**2 * rate)
    covariance = change @ spread @ change.T
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
    """Return which samples of which grains the uniform solution can describe, (T, G) bool."""
    chain = trajectory.scene.chain
    n = trajectory.grains
    time = trajectory.time[:, None]
    if chain.grains == 1:
        raise InputError.at("grains", "takes a chain of several: a single one has no wave")
    first, last = _uniform(chain, p)
    if grains is not None:
        first, last = grains
        if not 1 <= first <= p <= last <= chain.grains:
            raise InputError.at(
                "grains", f"must be (first, last) with 1 <= first <= {p} <= last (got {grains})"
            )
    elif last - first < 2:
        cure = "strike a grain further down, or give grains and until"
        raise InputError.at("chain", f"is not uniform within {EVEN:.0%} around grain {p}: {cure}")
    here = (n >= first) & (n <= last)
    if until is not None:
        return here & (time <= until)
    order = 2.0 * (2 * last - n - p)
    if first > 1 or chain.top == "wall":
        order = np.minimum(order, 2.0 * (n + p - 2 * first))
    order = np.maximum(order, 0.0)
    return here & (2 * rate * time <= order - FORERUNNER * np.cbrt(order))


def _thinned(inside: np.ndarray, trajectory: Trajectory, p: int, rate: float) -> np.ndarray:
    """Of too many values, leave out grains that the wave has not reached, then all but every so many."""
    if np.count_nonzero(inside) <= MOST:
        return inside
    reach = 2 * rate * float(trajectory.time[-1])
    # beyond, J_m(z) is below 1e-17
    near = 2 * np.abs(trajectory.grains - p) <= reach + 12 * np.cbrt(reach) + 20
    columns = np.flatnonzero(near & inside.any(0))
    kept = np.zeros(inside.shape[1], dtype=bool)
    kept[columns[:: max(1, -(-np.count_nonzero(inside[:, columns]) // MOST))]] = True
    return inside & kept


def _uniform(chain: Chain, p: int) -> tuple[int, int]:
    """Return first and last grain of the uniform part around grain p."""
    k = chain.linear_stiffness
    m = chain.masses
    held = chain.bottom == "fixed"
    own = k[min(p, k.size) - 1]
    alike = np.abs(k / own - 1) <= EVEN  # contact n between grains n and n + 1
    heavy = np.abs(m / m[p - 1] - 1) <= EVEN
    heavy[-1] |= held
    first = last = p
    while first > 1 and alike[first - 2] and heavy[first - 2]:
        first -= 1
    while last < chain.grains and alike[last - 1] and heavy[last]:
        last += 1
    return first, last
