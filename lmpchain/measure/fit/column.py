"""Continuum and power laws (Eqs. 27, 35) fitted to a column struck at its top."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import ClassVar, NamedTuple

import numpy as np
from scipy import stats

from ...chain.chain import Chain
from ...errors import InputError, shown
from ...theory import front as theory
from ...theory.continuum import impulse_amplitude, peaked
from ...theory.domain import chi, exponents
from ...trajectory.trajectory import Trajectory
from ...util.arrays import Array
from ...util.plotting import SHADES, Axes, chart, finish, mark_decades
from ...util.tabular import Tabular
from ..front import FEWEST, Exponents, Front, PowerLaw, asymptotic, exponent, fit_power, track
from ..recorded import Field
from .table import Fitted, FittedNumber

# Smallest decrease behind a front, relative to the largest motion, if the error is unknown.
QUIET = 1e-6


def front_before_echo(
    trajectory: Trajectory, field: Field, first: int, last: int | None = None
) -> Front:
    """Track the front down to the grains that an echo reaches."""
    estimate = trajectory.error_estimate
    chain = trajectory.scene.chain
    if not np.isfinite(estimate.solver):
        trajectory = replace(trajectory, error_estimate=replace(estimate, solver=QUIET))
    if last is None:
        # Some widths of the front, in grains.
        last = int(chain.grains - 3 - 2.5 * np.cbrt(chain.grains))
    return track(trajectory, field).between(first, last)


def bottom(grains: int, delta: float) -> tuple[float, float]:
    """Return the arrival time of the front at the bottom and its width there, in units of tau."""
    power = 1.5 / delta - 0.5
    depth = grains - 0.5
    return float(chi(depth, delta)), float(np.cbrt(depth**power / (8 * power)))


def is_uniform(chain: Chain) -> bool:
    """Return whether the grains of a chain and its contacts are equal."""
    properties = (chain.masses, chain.contact_constants)
    return all(np.allclose(values, values[:1], rtol=1e-9, atol=0) for values in properties)


def strike_at_top(trajectory: Trajectory) -> float:
    """Return the velocity of the strike, m/s; raise `InputError` for any other scene."""
    trajectory.scene.chain.refuse_ground("the theory of struck columns")
    scene = trajectory.scene
    chain = scene.chain
    excitation = scene.excitation
    faults = []
    if not chain.gravity or chain.top_load:
        faults.append(("gravity", "must act alone, without a top load, for this fit"))
    if chain.top != "free":
        faults.append(("top", "must be free for this fit"))
    if chain.law.power_of("the front of a column") >= 3:
        faults.append(
            ("exponent", "must be below 3 for this fit: otherwise the top already disperses waves")
        )
    if chain.grains == 1:
        faults.append(("grains", "must be two or more: a single grain has no wave"))
    elif not is_uniform(chain):
        faults.append(
            ("material", "must be the same for all grains, as in the column of the paper")
        )
    if not excitation.strikes_top or not scene.strike_velocity:
        faults.append(("excitation", "must be an impulse other than 0 on grain 1"))
    if faults:
        raise InputError(faults)
    return scene.strike_velocity


class FarRegion(NamedTuple):
    """Region far behind the front, where the continuum describes the grains.

    Attributes
    ----------
    earliest, latest : float
        Bounds of the time at which the region begins, in units of tau.
    forerunner : float
        Time between the first motion of an echo and its arrival, in widths of the front.
    """

    earliest: float = 5.0
    latest: float = 50.0
    forerunner: float = 10.0


FAR = FarRegion()


@dataclass(frozen=True, eq=False, repr=False)
class FrontLaw(Fitted, Tabular):
    """Arrival times of the front, ``factor h^exponent (1 + correction / h^order)``.

    The lag of the discrete chain behind the continuum is subtracted from the times.

    Attributes
    ----------
    depth : (P,) array
        Depths h = n - 1/2, in grains.
    time : (P,) array
        Times of the largest velocity, units of tau.
    shift : (P,) array
        Lags of the discrete chain behind the continuum, units of tau; 0.908 times the width of the
        front for Hertz contacts.
    order, exponent, factor, correction : float
        Parameters of the law. The order is 1/delta + 1/3, the next order after that of the lag.
    error : (3,) array
        Errors of exponent, factor and correction: half the 95 % interval, plus twice the shift when
        the next order, higher by 1/delta - 1/3, is also fitted. This shift is most of the effect of
        higher orders.
    expected : (2,) array
        Exponent eta / 2 and factor 2 / eta of Eq. (9).
    """

    _units: ClassVar[dict[str, str]] = {"depth": "", "time": "", "shift": ""}

    depth: Array
    time: Array
    shift: Array
    order: float
    exponent: float
    factor: float
    correction: float
    error: Array
    expected: Array

    def rows(self) -> Iterator[FittedNumber]:
        """Yield the exponent and factor of the law."""
        exponent, factor = self.expected.tolist()
        errors = self.error.tolist()
        yield FittedNumber("continuum", "exponent of the front", self.exponent, errors[0], exponent)
        yield FittedNumber("continuum", "factor of the front", self.factor, errors[1], factor)

    @property
    def law(self) -> Array:
        """The law at these depths, (P,), units of tau."""
        power = self.factor * self.depth**self.exponent
        return power * (1 + self.correction * self.depth**-self.order)

    @property
    def residual(self) -> Array:
        """Relative residual of the times less the lag, (P,)."""
        return (self.time - self.shift) / self.law - 1

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the times against depth, with the law, both logarithmic; return the axes."""
        ax = chart(ax, "depth h = n − 1/2 (grains)", "arrival (units of tau)")
        ax.plot(self.depth, self.time, ".", markersize=4, label="largest velocity")
        less = self.time - self.shift
        ax.plot(self.depth, less, ".", markersize=4, label="less the lag of the grains")
        exponent, factor = self.expected
        expected = f"expected {factor:.4f} $h^{{{exponent:.4f}}}$"
        law = f"{self.factor:.4f} $h^{{{self.exponent:.4f}}}$, {expected}"
        ax.plot(self.depth, self.law, lw=1, label=law)
        ax.loglog()
        return finish(ax)


@dataclass(frozen=True, eq=False, repr=False)
class ContinuumFit(Fitted, Tabular):
    """Eq. (35), ``phi = v0 C (tau^2 - chi^2)^(-xi/2eta)``, fitted far behind the front.

    Attributes
    ----------
    amplitude : float
        C, in the units of length and time of the scene, for a strike of unit velocity.
    error : float
        Error of C: half the 95 % confidence interval, plus the effect of a disturbance that falls
        as 1/tau, from the shift when only the later half of the samples is used.
    expected : float
        C of `lmpchain.theory.continuum.impulse_amplitude`, 1.155137 for Hertz contacts.
    power : float
        Exponent xi / (2 eta).
    grain : (P,) array
        Grains of the fitted samples.
    cone : (P,) array
        tau^2 - chi^2 of the fitted samples.
    values, model : (P,) arrays
        Displacements divided by the strike velocity and `Chain.time_scale`, and their fit.
    residual : float
        Root mean square of values - model relative to the root mean square of values.
    front : FrontLaw or None
        Law of the arrival times; None if it could not be fitted to 6 or more recorded grains.
    """

    _units: ClassVar[dict[str, str]] = {"grain": "", "cone": "", "values": "", "model": ""}

    amplitude: float
    error: float
    expected: float
    power: float
    grain: np.ndarray
    cone: Array
    values: Array
    model: Array
    residual: float
    front: FrontLaw | None

    def rows(self) -> Iterator[FittedNumber]:
        """Yield the amplitude, the law of the front, and the residual of the amplitude."""
        name = "amplitude C of Eq. (35)"
        yield FittedNumber("continuum", name, self.amplitude, self.error, self.expected)
        if self.front:
            yield from self.front.rows()
        yield FittedNumber("continuum", "residual", self.residual, expected=0.0)

    def notes(self) -> Iterator[str]:
        """Yield the range of fitted grains."""
        yield (
            f"C from grains {self.grain.min()} to {self.grain.max()}, each until the echo from "
            "the bottom is near"
        )

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw C over its theoretical value at each sample, and the fit; return the axes."""
        from matplotlib.ticker import LogLocator

        ax = chart(
            ax,
            r"$\tau^2 - \chi^2$ (time in units of $\sqrt{m_1/k_1}$)",
            "C over that of Eq. (35), less 1",
        )
        amplitudes = self.values * self.cone**self.power
        label = f"samples of {np.unique(self.grain).size} grains"
        ax.plot(self.cone, amplitudes / self.expected - 1, ".", markersize=3, label=label)
        label = f"C = {self.amplitude:.8g} ± {self.error:.1g}"
        ax.axhline(self.amplitude / self.expected - 1, color="k", lw=1, label=label)
        label = f"Eq. (35): {self.expected:.8g}"
        ax.axhline(0.0, color="0.5", lw=1, ls="--", label=label)
        ax.set_xscale("log")
        ax.xaxis.set(major_locator=LogLocator(subs=(1, 2, 5)), minor_formatter="")
        return finish(ax)


def fit_continuum(trajectory: Trajectory, first: int = 10, inside: float = 0.5) -> ContinuumFit:
    """Fit amplitude and front law of the continuum, Eqs. (27) and (35), to a struck column.

    The amplitude is fitted to samples with ``chi <= inside tau`` that no echo from below has
    reached, after tau = 50 or, in shorter recordings, after half of the latest such time. The law
    of the front is fitted to grains from `first` down to where the echo is near.

    Parameters
    ----------
    trajectory : Trajectory
        Run of any engine, with a strike number far below 1.
    first : int
        First grain for the law of the front.
    inside : float
        Largest chi / tau of the samples, between 0 and 1; smaller values leave fewer grains, which
        are closer to the continuum.

    Returns
    -------
    ContinuumFit

    Raises
    ------
    InputError
        If the scene is not a uniform column struck at its free top, or the recording is too short.

    Examples
    --------
    >>> import lmpchain
    >>> chain = lmpchain.Chain(grains=150, diameter=1e-3)
    >>> duration = 80 * chain.time_scale
    >>> strike = lmpchain.Impulse(velocity=5e-10)
    >>> scene = lmpchain.Scene(chain=chain, excitation=strike, duration=duration, samples=401)
    >>> fit = fit_continuum(lmpchain.simulate(scene, engine="chebyshev"))
    >>> f"{fit.amplitude:.4f}", f"{fit.front.exponent:.2f}"
    ('1.1551', '0.83')
    """
    chain = trajectory.scene.chain
    strike = strike_at_top(trajectory)
    if not 0 < inside < 1:
        raise InputError.at("inside", f"must be between 0 and 1 (got {shown(inside)})")
    delta = chain.law.power_of("the continuum")
    xi, eta, _ = exponents(delta)
    tau = trajectory.time / chain.time_scale
    travel = chi(trajectory.grains - 0.5, delta)
    end, lag = bottom(chain.grains, delta)
    quiet = tau[:, None] <= 2 * end - travel - FAR.forerunner * lag
    behind = quiet & (travel <= inside * tau[:, None])
    latest = tau[behind.any(1)].max(initial=0.0)
    since = min(FAR.latest, latest / 2)
    behind &= tau[:, None] >= since
    if since < FAR.earliest or behind.sum() < 3:
        need = 2.2 * FAR.earliest * chain.time_scale
        cure = f"record {need:.2g} s or more, grains near the top, and use more grains"
        raise InputError.at(
            "duration", f"no samples are far behind the front and before the echo: {cure}"
        )
    clock = np.broadcast_to(tau[:, None], behind.shape)[behind]
    grain = np.broadcast_to(trajectory.grains, behind.shape)[behind]
    values = trajectory.displacement[behind] / (strike * chain.time_scale)
    # The shape has unit strike and unit amplitude.
    shape = peaked(grain - 0.5, clock, 0.0, 1.0, 0.0, delta)

    def regress(chosen: np.ndarray) -> tuple[float, float]:
        x = shape[chosen]
        y = values[chosen]
        slope = float(x @ y / (x @ x))
        return slope, float(np.sqrt(((y - slope * x) ** 2).sum() / max(1, x.size - 1) / (x @ x)))

    amplitude, error = regress(np.ones(clock.size, dtype=bool))
    # Corrections fall as 1/tau, so the later half of the samples shows their size.
    late = clock >= (since + clock.max()) / 2
    later, _ = regress(late)
    whole, rest = (np.average(1 / clock[part], weights=shape[part] ** 2) for part in (..., late))
    share = (whole - rest) / whole
    correction = abs(later - amplitude) / share if share > 0 else 0.0
    error = float(stats.t.ppf(0.975, clock.size - 1)) * error + correction
    return ContinuumFit(
        amplitude=amplitude,
        error=error,
        expected=impulse_amplitude(delta),
        power=xi / (2 * eta),
        grain=grain,
        cone=clock**2 - chi(grain - 0.5, delta) ** 2,
        values=values,
        model=amplitude * shape,
        residual=float(np.sqrt(np.mean((values - amplitude * shape) ** 2) / np.mean(values**2))),
        front=_front_law(trajectory, first),
    )


def _front_law(trajectory: Trajectory, first: int) -> FrontLaw | None:
    """Fit the arrival times of the largest velocities, if there are enough."""
    chain = trajectory.scene.chain
    try:
        front = front_before_echo(trajectory, "velocity", first)
    except InputError:
        return None
    delta = chain.law.power_of("the front of a column")
    n = front.grain
    if n.size < FEWEST:
        return None
    h = n - 0.5
    time = front.time / chain.time_scale
    # The peak of a discrete chain lags behind the front of the continuum.
    shift = theory.peak_time(n, delta) - chi(h, delta)
    if not (time > shift).all():
        # The time is only noise.
        return None
    order = 1 / 3 + 1 / delta
    step = 1 / delta - 1 / 3
    try:
        fit = fit_power(h, time - shift, order, order + step)
    except InputError:
        # The law does not apply to such a strong strike.
        return None
    power, scale, correction = fit.values.tolist()
    factor = float(np.exp(scale))
    _, eta, _ = exponents(delta)
    return FrontLaw(
        depth=h,
        time=time,
        shift=shift,
        order=order,
        exponent=power,
        factor=factor,
        correction=correction,
        error=(fit.interval + 2 * fit.shift) * [1, factor, 1],
        expected=np.array([eta / 2, 2 / eta]),
    )


# Exponents of a solitary wave without gravity, which is reached at strike numbers above some 10^3.
STRONG = {"velocity": 0.0, "displacement": 0.0, "time": 1.0, "speed": 0.0, "width": 0.0}
WINDOW = 11  # Number of grains in a fit of a local exponent.
# Wave strength above which the law of weak waves cannot be extrapolated to great depth.
STILL_STRONG = 0.3


@dataclass(frozen=True, eq=False, repr=False)
class ExponentFit(Fitted):
    """Exponents of the front with depth: local exponents, and exponents of laws at great depth.

    Attributes
    ----------
    laws : mapping of str to PowerLaw
        Laws of "velocity" and "displacement" (largest values), and of "time", "speed" and "width"
        of the maximum of the velocity, each with its first correction for finite depth. Laws that
        could not be fitted are left out.
    expected : mapping of str to float
        Exponents at great depth after a weak strike.
    local : mapping of str to Exponents
        Local exponents d log / d log h of the same quantities, each fitted to 11 neighbouring
        grains, or to all grains if there are fewer.
    grain : (P,) array
        Grains whose velocity was fitted.
    strength : (P,) array
        Peak velocity at each grain divided by eps_n sqrt(k_n / m), with the overlap eps_n and the
        stiffness k_n at rest of the contact below. Far below 1 the wave is weak; far above 1
        gravity does not affect it.
    """

    laws: Mapping[str, PowerLaw]
    expected: Mapping[str, float]
    local: Mapping[str, Exponents] = field(default_factory=dict)
    grain: np.ndarray = field(default_factory=lambda: np.zeros(0, int))
    strength: Array = field(default_factory=lambda: np.zeros(0))

    def rows(self) -> Iterator[FittedNumber]:
        """Yield the local exponents at the deepest grains, and the extrapolated exponents."""
        if self.strength.size:
            yield FittedNumber(
                "exponents", f"strength at grain {self.grain[-1]}", float(self.strength[-1])
            )
        for name, power in self.expected.items():
            if name in self.local:
                local = self.local[name]
                depth = f"{name} near grain {local.depth[-1] + 0.5:.0f}"
                value = float(local.exponent[-1])
                yield FittedNumber("exponents", depth, value, float(local.error[-1]), power)
            if name in self.laws and not self._strong:
                law = self.laws[name]
                limit = f"{name} at great depth"
                yield FittedNumber(
                    "exponents", limit, float(law.exponent), float(law.error[0]), power
                )

    @property
    def _strong(self) -> bool:
        """Whether the wave is still strong at the deepest grain."""
        return bool(self.strength.size) and float(self.strength[-1]) > STILL_STRONG

    def notes(self) -> Iterator[str]:
        """Yield the laws that the local exponents approach, and the range of fitted grains."""
        verdicts: dict[str, list[str]] = {}
        for name in self.local:
            verdicts.setdefault(self.approach(name), []).append(name)
        for verdict, names in verdicts.items():
            yield f"{', '.join(names)}: {verdict}"
        if self._strong:
            yield "no law of great depth: the wave is still strong at the deepest grain"
        if self.grain.size:
            yield (
                f"grains {self.grain[0]} to {self.grain[-1]}; left out are grains next to the top, "
                "and the last 3 + 2.5 N^(1/3) grains, where an echo arrives"
            )

    def approach(self, name: str) -> str:
        """Return in words which law the local exponents of a quantity approach at depth.

        The exponents are "on" a law if they agree with it within the error at the deepest grains.
        They are "towards" a law if they are nearer to it at the deepest grains than at the first
        grains, by more than both errors.

        Parameters
        ----------
        name : str
            Name of the quantity, a key of `local`.
        """
        local = self.local[name]
        weak = self.expected[name]
        laws = {
            "the law of weak waves": weak,
            "the law of a solitary wave without load": STRONG[name],
        }
        for words, law in laws.items():
            if abs(local.exponent[-1] - law) <= local.error[-1]:
                return f"on {words}"
        for words, law in laws.items():
            nearer = abs(local.exponent[0] - law) - abs(local.exponent[-1] - law)
            if nearer > local.error[0] + local.error[-1]:
                return f"towards {words}"
        return "towards no law within these grains"

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw local minus weak-wave exponents over depth with errors; return the axes.

        Points at the right are the exponents at great depth.
        """
        shown = {} if self._strong else self.laws
        points = "; points: at great depth" if shown else ""
        depth = f"depth h = n − 1/2 (grains){points}"
        ax = chart(ax, depth, "local exponent d log / d log h\nless that of a weak wave", "x")
        ax.axhline(0, color="k", lw=1, ls="--", label="law of weak waves")
        deepest = max((local.depth[-1] for local in self.local.values()), default=1.0)
        for place, (name, power) in enumerate(self.expected.items()):
            colour = SHADES[place]
            if name in self.local:
                local = self.local[name]
                above = local.exponent - power
                ax.plot(local.depth, above, color=colour, label=name)
                band = above - local.error, above + local.error
                ax.fill_between(local.depth, *band, color=colour, alpha=0.2, lw=0)
            if name in shown:
                beyond = deepest * 1.2 * 1.06**place
                height = shown[name].exponent - power
                error = shown[name].error[0]
                ax.errorbar(beyond, height, error, fmt="o", ms=4, capsize=3, color=colour)
        mark_decades(ax)
        # The legend is below the axes, because curves may be anywhere within.
        return finish(ax, below=0.3, ncols=3, columnspacing=1.0)


def fit_exponents(trajectory: Trajectory, first: int = 20, last: int | None = None) -> ExponentFit:
    """Fit the exponents of the front of a strike on the top as functions of depth.

    Local exponents are fitted by `lmpchain.measure.front.exponent`, with confidence intervals.
    Exponents at great depth are fitted by `lmpchain.measure.front.asymptotic`, with the correction
    for finite depth. The latter are valid for weak waves; after a strong strike, the local
    exponents show how far the wave is from them. By default the fit leaves out the last
    3 + 2.5 N^(1/3) grains, because the echo from the bottom arrives there before the front has
    passed.

    Parameters
    ----------
    trajectory : Trajectory
        Run of any engine.
    first, last : int
        First and last grain of the fit.

    Returns
    -------
    ExponentFit

    Raises
    ------
    InputError
        If the scene is not a uniform column struck at its free top, or the front passes fewer than
        6 grains.
    """
    strike_at_top(trajectory)
    delta = trajectory.scene.chain.law.power_of("the front of a column")
    xi, eta, _ = exponents(delta)
    p, q = theory.decay(delta)
    velocity = front_before_echo(trajectory, "velocity", first, last)
    size = velocity.grain.size
    if size < FEWEST:
        need = f"a fit needs {FEWEST} or more grains from grain {first} on"
        raise InputError.at("front", f"{need} (got {size}): record longer")
    fronts = {"velocity": ("amplitude", velocity)}
    with suppress(InputError):
        # Behind a strong wave the displacement has no maximum.
        fronts["displacement"] = (
            "amplitude",
            front_before_echo(trajectory, "displacement", first, last),
        )
    fronts |= {key: (key, velocity) for key in ("time", "speed", "width")}
    laws = {}
    faults = []
    for name, (quantity, front) in fronts.items():
        try:
            laws[name] = asymptotic(front, quantity, delta)  # type: ignore[arg-type]
        except InputError as error:
            faults = error.faults
    if not laws:
        raise InputError(faults)
    expected = {
        "velocity": -p,
        "displacement": -q,
        "time": eta / 2,
        "speed": xi / 2,
        "width": 1 / 3 - xi / 2,
    }
    local = {}
    for name, (quantity, front) in fronts.items():
        size = front.against_depth(quantity).depth.size  # type: ignore[arg-type]
        with suppress(InputError):
            local[name] = exponent(front, quantity, min(WINDOW, size))  # type: ignore[arg-type]
    contacts = trajectory.scene.chain.contacts
    rate = np.sqrt(contacts.stiffness[velocity.grain] / trajectory.scene.chain.masses[0])
    holds = contacts.overlap[velocity.grain] * rate
    return ExponentFit(
        laws=laws,
        expected={name: power for name, power in expected.items() if name in laws or name in local},
        local=local,
        grain=velocity.grain,
        strength=np.abs(velocity.amplitude) / holds,
    )
