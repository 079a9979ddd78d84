"""Wave front at each grain, and the power laws of its change with depth."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from typing import ClassVar, Literal, NamedTuple, get_args

import numpy as np
from scipy import optimize, stats

from ..errors import InputError, shown
from ..trajectory.trajectory import UNITS_OF_FIELDS, Trajectory
from ..util.arrays import Array, whole_numbers
from ..util.lazy import listed
from ..util.notebook import Shown
from ..util.plotting import Axes, chart, finish, mark_decades
from ..util.tabular import Tabular
from .motion import motion_of
from .recorded import Field, check

__dir__ = listed(__name__)

Quantity = Literal["amplitude", "time", "width", "speed"]
DECADE = 10.0  # An axis of a smaller ratio of values has ticks at round numbers.
FEWEST = 6  # Smallest number of grains for a power law with its correction.
# Largest phase, rad, of the fastest motion between two samples for which the samples identify the
# front. In columns of 2000 grains all times were right at 2.6 rad, and one in 30 was wrong at 3.4
# rad.
RESOLVED_TURN = 2.0
# Error of a time, relative to the duration, above which the front could be anywhere.
UNRESOLVED = 0.1
UNITS_OF_FRONTS = {"time": "s", "width": "s", "speed": "m/s"}


class DepthProfile(NamedTuple):
    """A quantity over depth: depths h = n - 1/2 in grains, sizes, (K,) each, and the label."""

    depth: Array
    values: Array
    label: str


@dataclass(frozen=True, eq=False, repr=False)
class Front(Shown, Tabular):
    """The wave front as it passes P grains: arrival, height and width.

    Attributes
    ----------
    field : "velocity" or "displacement"
        Field in which the front is a maximum.
    grain : (P,) array
        Grains that the front passes, from the top downward.
    depth : (P,) array
        Depths of their centres at rest below the centre of grain 1, m.
    time : (P,) array
        Times of the maximum, s.
    amplitude : (P,) array
        Values at the maximum, m/s or m; negative for upward motion.
    width : (P,) array
        Full widths at half maximum in time, s; NaN if the motion does not pass half the amplitude
        on both sides.
    time_error, amplitude_error, width_error : (P,) arrays
        Errors of time, amplitude and width by sampling and by the error of the trajectory, if it is
        known. If errors of this size could make another maximum the front, they include the
        difference between both maxima.
    """

    _units: ClassVar[dict[str, str]] = {
        "grain": "",
        "depth": "m",
        "time": "s",
        "amplitude": "{field}",
        "width": "s",
        "time_error": "s",
        "amplitude_error": "{field}",
        "width_error": "s",
    }

    field: Field
    grain: np.ndarray
    depth: Array
    time: Array
    amplitude: Array
    width: Array
    time_error: Array
    amplitude_error: Array
    width_error: Array

    @property
    def speed(self) -> Array:
        """Local speed from neighbouring grains, (P,) m/s.

        The speed is negative for an upward front, and infinite where grains peak at the same time.
        """
        with np.errstate(divide="ignore"):
            return 1 / self._slowness(self.depth)

    @property
    def grains_per_second(self) -> Array:
        """Local speed in grains, (P,) 1/s, signed as `speed`."""
        return 1 / self._slowness(self.grain.astype(float))

    def _slowness(self, place: Array) -> Array:
        if place.size < 2:
            raise InputError.at(
                "grains", "a speed needs the front at two or more grains: record more grains"
            )
        # Two grains have no second difference.
        return np.gradient(self.time, place, edge_order=2 if place.size > 2 else 1)

    def between(self, first: int, last: int) -> Front:
        """Return the front at the grains from `first` to `last`."""
        return self.where((self.grain >= first) & (self.grain <= last))

    def where(self, chosen: np.ndarray) -> Front:
        """Return the front at the grains for which `chosen`, (P,), is true."""
        return replace(self, **{key: x[chosen] for key, x in vars(self).items() if key != "field"})

    def against_depth(self, quantity: Quantity) -> DepthProfile:
        """Return the size of a quantity over depth, where it is finite."""
        if quantity not in get_args(Quantity):
            raise InputError.at(
                "quantity",
                f"must be one of {', '.join(get_args(Quantity))} (got {shown(quantity)})",
            )
        values = np.abs(getattr(self, quantity))
        finite = np.isfinite(values)
        label = f"{quantity} of the front ({_unit_of(quantity, self.field)})"
        return DepthProfile(self.grain[finite] - 0.5, values[finite], label)

    def plot(self, ax: Axes | None = None, quantity: Quantity = "amplitude") -> Axes:
        """Draw a quantity against depth, both logarithmic; return the axes."""
        profile = self.against_depth(quantity)
        return _draw(ax, *profile, unit=_unit_of(quantity, self.field))


@dataclass(frozen=True, eq=False, repr=False)
class Exponents(Shown, Tabular):
    """Local exponents p of a quantity that varies as h^p, each fitted to neighbouring grains.

    Attributes
    ----------
    quantity : str
        Name of the quantity.
    depth : (L,) array
        Geometric means of the depths h = n - 1/2 of each fit, in grains.
    exponent : (L,) array
        Exponents p.
    error : (L,) array
        Half the 95 % confidence intervals of p.
    residual : (L,) array
        Root mean squares of the relative scatter about each fit.
    """

    _units: ClassVar[dict[str, str]] = {"depth": "", "exponent": "", "error": "", "residual": ""}

    quantity: Quantity
    depth: Array
    exponent: Array
    error: Array
    residual: Array

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the exponents with their confidence intervals against depth; return the axes."""
        label = f"local exponent of the {self.quantity}"
        return _draw(ax, self.depth, self.exponent, label, error=self.error)


@dataclass(frozen=True, eq=False, repr=False)
class PowerLaw(Shown, Tabular):
    """A power law with a finite-depth correction: factor h^exponent (1 + correction / h^order).

    Attributes
    ----------
    label : str
        Name of the quantity with its unit.
    depth : (P,) array
        Depths h = n - 1/2 in grains.
    values : (P,) array
        Values that were fitted.
    unit : str
        Unit of the values.
    order, exponent, factor, correction : float
        Parameters of the law in the first line.
    error : (3,) array
        Errors of exponent, factor and correction: half the 95 % confidence interval plus the larger
        of two changes, which dominate on smooth data. One is the shift when the term of the next
        order q is fitted as well. The other is the change when only the deeper half of the grains
        is fitted, extrapolated to infinite depth: over 1 - r^-q, with the ratio r of the mean
        depths. The error is an estimate, not a bound. For the width, and for displacements at
        exponents near 2, it may be too small by a factor of 5.
    """

    _units: ClassVar[dict[str, str]] = {"depth": "", "values": ""}

    label: str
    depth: Array
    values: Array
    unit: str
    order: float
    error: Array
    exponent: float
    factor: float
    correction: float

    def __call__(self, depth: Array) -> Array:
        """Return the value of the law at these depths."""
        return self.factor * depth**self.exponent * (1 + self.correction * depth**-self.order)

    @property
    def residual(self) -> Array:
        """Relative residual of the values, (P,)."""
        return self.values / self(self.depth) - 1

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw values and law against depth, both logarithmic; return the axes."""
        law = f"exponent {self.exponent:.4f} ± {self.error[0]:.4f}, corrected for finite depth"
        ax = _draw(ax, self.depth, self.values, self.label, unit=self.unit)
        ax.plot(self.depth, self(self.depth), label=law)
        return finish(ax)


def _unit_of(quantity: Quantity, field: Field) -> str:
    """Return the unit of a quantity of the front of a field."""
    return UNITS_OF_FRONTS.get(quantity, UNITS_OF_FIELDS[field])


def track(trajectory: Trajectory, field: Field = "velocity", fraction: float = 0.5) -> Front:
    """Track the wave front from grain to grain, also between the samples.

    At each grain the front is the first local maximum of the absolute value that reaches `fraction`
    of the largest absolute value at this grain. After it, the motion must fall by more than the
    error of the trajectory. Grains that start above this threshold, such as a struck grain, are
    left out, as are grains whose maximum is not within the recording. Behind the front the
    displacement falls slowly in a column and not at all in a sonic vacuum, so track the velocity
    there.

    Parameters
    ----------
    trajectory : Trajectory
    field : "velocity" or "displacement"
    fraction : float
        Smallest height of a front relative to the largest value at its grain, above 0, at most 1.

    Returns
    -------
    Front

    Raises
    ------
    InputError
        If the fraction is not valid, no front passes a grain, there are fewer than 16 samples, or
        the samples are too far apart to show which maximum is the front at most grains.

    Examples
    --------
    >>> import lmpchain
    >>> chain = lmpchain.Chain(grains=40, diameter=1e-3)
    >>> strike = lmpchain.Impulse(velocity=1e-5)
    >>> scene = lmpchain.Scene(chain=chain, excitation=strike, duration=1e-4, samples=401)
    >>> front = track(lmpchain.simulate(scene, engine="native"))
    >>> front.grain[:3].tolist(), [f"{c:.0f} m/s" for c in front.speed[[5, 10, 15]]]
    ([2, 3, 4], ['190 m/s', '212 m/s', '227 m/s'])
    """
    check(trajectory, field)
    if not 0 < fraction <= 1:
        raise InputError.at("fraction", f"must be above 0 and at most 1 (got {fraction})")
    error = trajectory.error_estimate.solver
    motion = motion_of(trajectory)
    order = np.argsort(trajectory.grains)
    # A model error shifts the whole wave, but does not create maxima.
    fall = (error if np.isfinite(error) else 0.0) * motion.sampled[field == "velocity"]
    grains = trajectory.grains[order]
    rows = motion.fronts(field, fraction, fall)[order]
    passed = np.isfinite(rows[:, 0])
    if not passed.any():
        raise InputError.at(
            "duration",
            f"no front of the {field} passes a recorded grain: record for longer, and end the "
            "push if it still grows",
        )
    _check_times(trajectory, rows[passed, 3])
    return Front(
        field,
        grains[passed],
        trajectory.scene.chain.depths[grains[passed] - 1],
        *rows[passed].T.copy(),
    )


def _check_times(trajectory: Trajectory, error: Array) -> None:
    """Raise `InputError` if the errors of times, (P,) s, show that the sampling is too coarse."""
    scene = trajectory.scene
    unresolved = int((error > UNRESOLVED * scene.duration).sum())
    needed = 1 + int(np.ceil(scene.total_phase / RESOLVED_TURN))
    if 2 * unresolved > error.size and needed > scene.samples:
        raise InputError.at(
            "samples",
            f"{scene.samples} samples do not show which maximum is the front at {unresolved} of "
            f"{error.size} grains (error of the time up to {error.max():.2g} s): record "
            f"{needed} samples",
        )


def exponent(front: Front, quantity: Quantity = "amplitude", window: int | None = 11) -> Exponents:
    """Fit power laws in h = n - 1/2 to windows of neighbouring grains, or to all of them.

    Parameters
    ----------
    front : Front
    quantity : "amplitude", "width", "time" or "speed"
    window : int, optional
        Number of grains in each fit; None for a single fit to all grains.

    Returns
    -------
    Exponents

    Raises
    ------
    InputError
        If the window is smaller than 3, or larger than the number of grains that the front passes.
    """
    depth, values, _ = front.against_depth(quantity)
    size = depth.size if window is None else int(whole_numbers(window, "window"))
    if not 3 <= size <= depth.size:
        raise InputError.at(
            "window", f"must be 3 to {depth.size}, the number of grains passed (got {size})"
        )
    x, y = (np.lib.stride_tricks.sliding_window_view(np.log(z), size) for z in (depth, values))
    slope, error, correlation = np.array(
        [(fit.slope, fit.stderr, fit.rvalue) for fit in map(stats.linregress, x, y)]
    ).T
    return Exponents(
        quantity=quantity,
        depth=np.exp(x.mean(1)),
        exponent=slope,
        error=stats.t.ppf(0.975, size - 2) * error,
        residual=np.sqrt(1 - correlation**2) * y.std(1),
    )


class CorrectedPower(NamedTuple):
    """A power law fitted with its correction: exponent, logarithm of the factor, correction.

    Attributes
    ----------
    values : (3,) array
        Exponent, logarithm of the factor, and correction.
    interval : (3,) array
        Half the 95 % confidence intervals; 0 for a given exponent.
    shift : (3,) array
        Change of the values when the next term is fitted as well.
    remote : (3,) array
        Change of the values when only the deeper half is fitted, as far as it exceeds the noise,
        extrapolated to infinite depth.
    """

    values: Array
    interval: Array
    shift: Array
    remote: Array


def fit_power(
    depth: Array, values: Array, order: float, following: float, exponent: float | None = None
) -> CorrectedPower:
    """Fit values of the form factor h^exponent (1 + correction / h^order).

    Parameters
    ----------
    depth, values : (P,) arrays
        Depths and values, all above 0.
    order, following : float
        Orders of the correction and of the next term, which shows the effect of further terms.
    exponent : float, optional
        Known exponent, which is then not fitted.

    Returns
    -------
    CorrectedPower

    Raises
    ------
    InputError
        If the fit does not converge.
    """
    # Fit logarithms, so that relative errors have equal weight at all depths.
    x = np.log(depth)
    y = np.log(values)
    fixed: list[float] = [] if exponent is None else [exponent]

    def law(x: Array, *terms: float) -> Array:
        power, scale, first, second = (*fixed, *terms, 0.0)[:4]
        corrected = 1 + first * np.exp(-order * x) + second * np.exp(-following * x)
        return scale + power * x + np.log(np.abs(corrected))

    try:
        # A plain power law is fitted first; corrections are then added one after the other.
        start = [*np.polyfit(x, y, 1), 0.0][len(fixed) :]
        parameters, covariance = optimize.curve_fit(law, x, y, start)
        further, _ = optimize.curve_fit(law, x, y, [*parameters, 0.0])
    except RuntimeError:
        raise InputError.at(
            "front", "does not follow a power law: choose other grains with Front.between"
        ) from None
    interval = stats.t.ppf(0.975, x.size - parameters.size) * np.sqrt(np.diag(covariance))
    exact = np.zeros(len(fixed))
    deeper = slice(-max(FEWEST - 2, x.size // 2), None)
    remote = np.zeros(parameters.size)
    with suppress(RuntimeError):
        below, scatter = optimize.curve_fit(law, x[deeper], y[deeper], parameters)
        # Noise changes the fit to fewer grains as well, by up to half of its own interval.
        noise = stats.t.ppf(0.975, x[deeper].size - below.size) * np.sqrt(np.diag(scatter))
        # The neglected terms decrease with this power of the depth.
        decrease = np.exp(following * (x.mean() - x[deeper].mean()))
        remote = np.maximum(np.abs(below - parameters) - noise, 0.0) / (1 - decrease)
    return CorrectedPower(
        values=np.append(fixed, parameters),
        interval=np.append(exact, interval),
        shift=np.append(exact, np.abs(further[:-1] - parameters)),
        remote=np.append(exact, remote),
    )


def asymptotic(
    front: Front, quantity: Quantity, delta: float, exponent: float | None = None
) -> PowerLaw:
    """Fit the asymptotic power law of a quantity and its finite-depth correction.

    The law describes the wave of a weak strike on the top of a column. With xi = 1 - 1/delta,
    dispersion spreads the front (tau^2 - chi^2)^(-a), a = xi / (4 - 2 xi), over times that grow as
    h^w, w = 1/3 - xi/2. The exponent of the displacement tends to -xi/4 - a w, and the exponent of
    the velocity to -xi/4 - (1 + a) w: -1/10 and -4/15 for Hertz contacts. The exponents -1/12 and
    -1/4 of Hong, Ji and Kim, Phys. Rev. Lett. 82, 3058 (1999), are local values at finite depth.

    The order is 1/delta - 1/3 for amplitude and width, and 2/3 for time and speed; above delta = 2
    the correction cannot be separated from the power. Use `Front.between` to leave out the first
    grains and reflections.

    Parameters
    ----------
    front : Front
    quantity : "amplitude", "width", "time" or "speed"
    delta : float
        Exponent of the contact force, 1 to 2.
    exponent : float, optional
        Known exponent, which is then not fitted.

    Returns
    -------
    PowerLaw

    Raises
    ------
    InputError
        If delta is not between 1 and 2, or the front passes fewer than 6 grains.
    """
    depth, values, label = front.against_depth(quantity)
    if not 1 <= delta <= 2:
        raise InputError.at("front", f"the power law requires 1 <= delta <= 2 (got {delta})")
    if depth.size < FEWEST:
        raise InputError.at(
            "front", f"a fit needs {FEWEST} or more grains (got {depth.size}): record longer"
        )
    # A passing front lags behind the continuum. The next term is that of the continuum.
    passing = quantity in ("time", "speed")
    order = 2 / 3 if passing else 1 / delta - 1 / 3
    fit = fit_power(depth, values, order, 1 / delta + 1 / 3 if passing else 2 * order, exponent)
    power, scale, correction = fit.values
    factor = np.exp(scale)
    return PowerLaw(
        label=label,
        depth=depth,
        values=values,
        unit=_unit_of(quantity, front.field),
        order=order,
        error=(fit.interval + np.maximum(fit.shift, fit.remote)) * [1, factor, 1],
        exponent=power,
        factor=factor,
        correction=correction,
    )


def _draw(
    ax: Axes | None, h: Array, y: Array, label: str, unit: str = "", error: Array | None = None
) -> Axes:
    """Draw values against depth, logarithmic unless they have errors."""
    from matplotlib.ticker import LogLocator, MaxNLocator

    ax = chart(
        ax, "depth h = n − 1/2 (grains)", f"{label} [{unit}]", "xy" if error is None else "x"
    )
    ax.errorbar(h, y, yerr=error, fmt=".", markersize=4, elinewidth=1)
    mark_decades(ax)
    if error is None:
        decades = y.size > 0 and y.max() > DECADE * y.min()
        ax.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)) if decades else MaxNLocator(6))
    return ax
