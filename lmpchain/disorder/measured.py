"""Measured quantities of many random chains, or of a chain with tolerances.

A measure is a function of a trajectory that returns a number, an array, or several of them by name.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from itertools import islice
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import binom
from scipy.stats import t as student

from ..chain.chain import Chain
from ..engines.base import Engine
from ..errors import InputError, not_among, shown
from ..scene.scene import Scene, check_scene
from ..simulation.batch_means import LEVEL
from ..simulation.many import simulate_many
from ..trajectory.trajectory import Trajectory
from ..util.arrays import Array, numbers
from ..util.notebook import Shown
from ..util.plotting import COLOURS, Axes, chart, finish
from ..util.progress import ProgressBar
from ..util.remarks import warnings_aside
from ..util.tabular import NamedColumn, Tabular
from .draws import (
    Law,
    Of,
    change_chain,
    check,
    fault_of_count,
    fault_of_whole,
    materials_of,
    realisation,
)

Measure = Callable[[Trajectory], Any]
Distribution = Literal["normal", "uniform"]
BATCH = 16  # Number of chains in memory at a time.
BAND = (0.05, 0.95)  # Quantiles between which a picture is shaded.
OF_GRAINS: dict[str, Of] = {
    "diameter": "diameter",
    "youngs_modulus": "youngs_modulus",
    "mass": "mass",
}
OF_CHAIN = ("top_load", "gravity")


@dataclass(frozen=True, eq=False, repr=False)
class MeasuredEnsemble(Shown, Tabular):
    """A measured quantity of R chains: mean, scatter and quantiles with intervals.

    Attributes
    ----------
    values : (R, ...) array
        Values of each chain.
    x : array or None
        Coordinate of a curve; None for a number.
    model_error, solver_error : float
        Largest relative model error of any run; largest relative solver error of any run. Both are
        defined as for a trajectory.
    """

    values: Array
    x: Array | None
    model_error: float
    solver_error: float

    @property
    def realisations(self) -> int:
        """Number of chains R."""
        return len(self.values)

    @property
    def mean(self) -> Array:
        """Mean over the chains, (...)."""
        return np.asarray(self.values.mean(0))

    @property
    def deviation(self) -> Array:
        """Standard deviation over the chains, (...)."""
        return np.asarray(self.values.std(0, ddof=1))

    @property
    def error(self) -> Array:
        """Standard error of the mean, (...)."""
        return self.deviation / np.sqrt(self.realisations)

    @property
    def interval(self) -> tuple[Array, Array]:
        """Ends of the 95 % confidence interval of the mean, corrected for skewness.

        The ends follow from Hall's transformation of Student's t, which uses the skewness of the
        values (P. Hall, J. R. Statist. Soc. B 54, 221, 1992). For normal, uniform, gamma and
        exponential distributions, 94.5 to 96.5 % of the intervals contain the true mean if there
        are 30 chains or more, and 93.5 to 97 % if there are 10 chains.
        """
        quantile = float(student.ppf((1 + LEVEL) / 2, self.realisations - 1))
        ends = (_invert_hall(t, self._skewness) for t in (quantile, -quantile))
        low, high = (self.mean - t * self.error for t in ends)
        return low, high

    @property
    def _skewness(self) -> Array:
        """Skewness of the values over the root of their number, (...); 0 if all are equal."""
        away = self.values - self.mean
        spread = np.asarray((away**2).mean(0)) ** 1.5
        third = (away**3).mean(0)
        skewness = np.divide(third, spread, out=np.zeros_like(spread), where=spread > 0)
        return np.asarray(skewness / np.sqrt(self.realisations))

    def quantile(self, share: float) -> Array:
        """Return the value below which this fraction of the chains is, (...)."""
        _check_share(share)
        return np.asarray(np.quantile(self.values, share, axis=0))

    def quantile_interval(self, share: float) -> tuple[Array, Array]:
        """Return the ends of a 95 % confidence interval of a quantile, (...) each.

        The ends are order statistics, so that the interval is valid for every continuous
        distribution. An end is infinite if there are too few chains, and NaN if a value is NaN.
        """
        _check_share(share)
        low, high = binom.ppf([(1 - LEVEL) / 2, (1 + LEVEL) / 2], self.realisations, share)
        ends = np.full((1, *self.values.shape[1:]), np.inf)
        ordered = np.concatenate((-ends, np.sort(self.values, axis=0), ends))
        unknown = np.isnan(self.values).any(0)
        first, last = (np.where(unknown, np.nan, ordered[int(n)]) for n in (low, high + 1))
        return first, last

    def _columns(self) -> Iterator[NamedColumn]:
        if self.x is not None:
            yield NamedColumn("x", "", self.x)
        low, high = (np.atleast_1d(end) for end in self.interval)
        columns = {"mean": self.mean, "error": self.error, "deviation": self.deviation}
        columns |= {"interval_low": low, "interval_high": high}
        columns |= {f"quantile_{share:g}": self.quantile(share) for share in (0.05, 0.5, 0.95)}
        for name, values in columns.items():
            yield NamedColumn(name, "", np.atleast_1d(values).ravel())

    def plot(
        self, ax: Axes | None = None, label: str = "measured quantity", x_label: str = "x"
    ) -> Axes:
        """Draw a number as a histogram, or a curve with its scatter and the error of its mean.

        Parameters
        ----------
        ax : axes, optional
            Axes to draw on; by default the axes of a new figure.
        label, x_label : str
            Name of the quantity with its unit; name of its coordinate with its unit.

        Raises
        ------
        InputError
            If the quantity is neither a number nor a curve.
        """
        title = f"{self.realisations} chains"
        if self.values.ndim == 1:
            ax = chart(ax, label, "number of chains")
            ax.hist(self.values, bins="auto", color="0.75")
            low, high = self.interval
            ax.axvline(float(self.mean), color=COLOURS["blue"], label="mean")
            ax.axvspan(
                float(low), float(high), color=COLOURS["blue"], alpha=0.3, lw=0, label="95 %"
            )
            for share in BAND:
                quantile = float(self.quantile(share))
                ax.axvline(
                    quantile, color=COLOURS["vermilion"], ls="--", label=f"{100 * share:g} % below"
                )
            return finish(ax, title)
        if self.values.ndim > 2:
            shape = self.values.shape[1:]
            raise InputError.at("measure", f"returns an array of shape {shape}: select a curve")
        ax = chart(ax, x_label, label)
        x = np.arange(self.values.shape[1]) if self.x is None else self.x
        lowest, highest = (self.quantile(share) for share in BAND)
        span = f"{100 * BAND[0]:g} to {100 * BAND[1]:g} % of the chains"
        ax.fill_between(x, lowest, highest, color="0.8", lw=0, label=span)
        low, high = self.interval
        ax.fill_between(x, low, high, color=COLOURS["blue"], alpha=0.4, lw=0, label="mean, 95 %")
        ax.plot(x, self.mean, color=COLOURS["blue"], lw=1)
        return finish(ax, title)


def _invert_hall(value: float, skewness: Array) -> Array:
    """Return t for which ``t + a t^2 / 3 + a^2 t^3 / 27 + a / 6`` is a value, for each a."""
    root = np.cbrt(1 + skewness * (value - skewness / 6))
    # This is 3 (root - 1) / a without its cancellation.
    return np.asarray(3 * (value - skewness / 6) / (root**2 + root + 1))


def statistics(
    values: Any, over: str | None = None, x: ArrayLike | None = None
) -> MeasuredEnsemble:
    """Return statistics of values that were computed elsewhere, for example by a sweep.

    Parameters
    ----------
    values : (R, ...) array_like, or xarray.DataArray
        One row for each of two chains or more, or a variable of `load_sweep`.
    over : str, optional
        Dimension of the chains in a DataArray, such as "realisation" or "draw".
    x : array_like, optional
        Coordinate of a curve, for pictures.

    Returns
    -------
    MeasuredEnsemble
        Statistics of the values; the model error and the solver error are NaN.

    Raises
    ------
    InputError
        If there is no such dimension, or if values are missing because a scene failed.

    Examples
    --------
    >>> found = statistics([1.0, 2.0, 3.0, 4.0, 5.0])
    >>> float(found.mean), [round(float(end), 3) for end in found.interval]
    (3.0, [1.037, 4.963])
    """
    if over is not None:
        dimensions = list(getattr(values, "dims", ()))
        if over not in dimensions:
            raise InputError.at("over", not_among(over, dimensions))
        values = values.transpose(over, ...)
    rows = _real(values, "values", "must be numbers, in rows of equal length")
    if rows.ndim < 1 or len(rows) < 2:
        raise InputError.at("values", "must have rows of two chains or more")
    missing = np.flatnonzero(np.isnan(rows).reshape(len(rows), -1).any(1))
    if missing.size:
        message = f"are missing for {missing.size} of {len(rows)} chains, first for {missing[0]}"
        raise InputError.at("values", f"{message}: leave them out if this causes no bias")
    return MeasuredEnsemble(rows, _coordinate(x, rows), np.nan, np.nan)


def _real(values: Any, key: str, message: str) -> Array:
    """Return real numbers as an array of float64; raise `InputError` for other values."""
    rows = values if isinstance(values, list | tuple) else [values]
    # NumPy would use masked entries, and drop imaginary parts.
    if any(np.ma.is_masked(row) for row in rows):
        raise InputError.at(key, f"{message}, but entries are masked: leave them out")
    try:
        array = np.asarray(values)
        if array.dtype.kind in "biufO":
            return array.astype(float)
    except (TypeError, ValueError):
        pass
    raise InputError.at(key, f"{message} (got {shown(rows[0] if len(rows) == 1 else values)})")


def _coordinate(x: ArrayLike | None, rows: Array) -> Array | None:
    """Return the coordinate of curves, (R, P); None for numbers and for other arrays."""
    if x is None or rows.ndim != 2:
        return None
    coordinate = numbers(x, "x")
    if coordinate.shape != rows.shape[1:]:
        message = f"must be of shape {rows.shape[1:]}, as the values, not {coordinate.shape}"
        raise InputError.at("x", message)
    return coordinate


def measured_over(
    scene: Scene,
    measure: Measure,
    m: float,
    realisations: int,
    seed: int,
    engine: str | Engine = "native",
    *,
    tolerance: float = 1e-6,
    law: Law = "dyson",
    of: Of = "stiffness",
    x: ArrayLike | None = None,
    progress: bool = False,
) -> Any:
    """Measure a quantity of the trajectories of many random chains.

    Parameters
    ----------
    scene : Scene
        The scene with the ordered chain.
    measure : function
        Function of a trajectory that returns a number, an array, or several of them by name. The
        arrays of all chains must have the same shape.
    m, realisations, seed, engine, tolerance, law, of
        As for `ensemble`, but with two chains or more.
    x : array_like, optional
        Coordinate of a curve, for pictures.
    progress : bool
        Whether to show a progress bar.

    Returns
    -------
    MeasuredEnsemble, or dict of MeasuredEnsemble by name

    Raises
    ------
    InputError
        As for `ensemble`, or if `measure` raises it. The message names the number of the chain.
    ToleranceNotMet, RunFailed
        As for `ensemble`.

    Examples
    --------
    >>> from lmpchain import Chain, Impulse
    >>> from lmpchain.measure import wavenumbers
    >>> chain = Chain(grains=60, diameter=1e-3, gravity=0.0, top_load=1.0)
    >>> strike = Impulse(velocity=1e-4)
    >>> scene = Scene(chain=chain, excitation=strike, duration=3e-5, samples=2)
    >>> def share(t):
    ...     energy = wavenumbers.bands(t).energy[-1].sum(0)
    ...     return energy / energy.sum()
    >>> measured_over(scene, share, m=5, realisations=20, seed=1).mean.round(2).tolist()
    [0.48, 0.3, 0.13, 0.09]
    """
    check(fault_of_count(realisations, 2), fault_of_whole("seed", seed, 0))
    check_scene(scene)
    scenes = (realisation(scene, m, seed, index, law, of) for index in range(realisations))
    return _gather(scenes, measure, realisations, engine, tolerance, x, progress)


def within(
    scene: Scene,
    tolerances: Mapping[str, float],
    measure: Measure,
    realisations: int,
    seed: int,
    engine: str | Engine = "native",
    *,
    tolerance: float = 1e-6,
    distribution: Distribution = "normal",
    common: tuple[str, ...] = ("youngs_modulus",),
    x: ArrayLike | None = None,
    progress: bool = False,
) -> Any:
    """Propagate the tolerances of a chain and its excitation to a measured quantity.

    Parameters
    ----------
    scene : Scene
        Scene with the nominal values.
    tolerances : dict of float
        Standard deviations, or half widths of a uniform distribution, in SI units, by name:
        "diameter", "youngs_modulus" or "mass" of the grains, "top_load", "gravity", or a number of
        the excitation, such as "excitation.velocity". A changed diameter also changes the mass and
        the contacts of a grain.
    measure, realisations, seed, engine, tolerance
        As for `measured_over`.
    distribution : "normal" or "uniform"
    common : tuple of str
        Properties of grains that are drawn once for all grains, such as the modulus of one batch of
        beads. The other properties are drawn for each grain.
    x, progress
        As for `measured_over`.

    Returns
    -------
    MeasuredEnsemble, or dict of MeasuredEnsemble by name

    Raises
    ------
    InputError
        If the name of a tolerance is unknown, or if a tolerance is negative or so wide that a value
        leaves its range.
    ToleranceNotMet, RunFailed
        As for `measured_over`.

    Examples
    --------
    >>> from lmpchain import Chain, Impulse
    >>> from lmpchain.measure import flight
    >>> chain = Chain(grains=20, diameter=5e-3, material="steel", gravity=0.0, top_load=10.0)
    >>> strike = Impulse(velocity=1e-3)
    >>> scene = Scene(chain=chain, excitation=strike, duration=2e-4, samples=201)
    >>> speed = within(scene, {"top_load": 0.3, "youngs_modulus": 4e9},
    ...                lambda t: flight.time_of_flight(t, 3, 15).speed, 20, seed=1)
    >>> f"{speed.mean:.1f} ± {speed.deviation:.1f} m/s"
    '356.6 ± 2.9 m/s'
    """
    check(fault_of_count(realisations, 2), fault_of_whole("seed", seed, 0))
    check_scene(scene)
    if distribution not in ("normal", "uniform"):
        raise InputError.at("distribution", not_among(distribution, ["normal", "uniform"]))
    if not isinstance(tolerances, Mapping) or not tolerances:
        raise InputError.at("tolerances", f"must be a dict of numbers (got {shown(tolerances)})")
    common = _common_names(common)
    widths = {}
    for key, value in tolerances.items():
        field = str(key).removeprefix("excitation.")
        allowed = [*OF_GRAINS, *OF_CHAIN]
        given = scene.excitation.given()
        strengths = [
            name for name in scene.excitation.strength if np.ndim(given.get(name, [])) == 0
        ]
        if key not in allowed and (key == field or field not in strengths):
            names = [*allowed, *(f"excitation.{name}" for name in strengths)]
            raise InputError.at("tolerances", not_among(key, names))
        width = numbers(value, f"tolerances.{key}")
        if width.ndim or not width >= 0:
            message = f"must be one number, 0 or more (got {shown(value)})"
            raise InputError.at(f"tolerances.{key}", message)
        widths[key] = float(width)

    def scenes() -> Iterator[Scene]:
        for index in range(realisations):
            rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(index,)))
            yield _drawn(scene, widths, distribution, common, rng)

    return _gather(scenes(), measure, realisations, engine, tolerance, x, progress)


def _common_names(common: object) -> tuple[str, ...]:
    """Return names of properties of grains as a tuple; raise `InputError` for other values."""
    names = (common,) if isinstance(common, str) else common
    if not isinstance(names, Collection):
        raise InputError.at("common", f"must be names of properties (got {shown(common)})")
    for key in names:
        if key not in OF_GRAINS:
            raise InputError.at("common", not_among(key, tuple(OF_GRAINS)))
    return tuple(names)


def _drawn(
    scene: Scene,
    widths: Mapping[str, float],
    distribution: Distribution,
    common: tuple[str, ...],
    rng: np.random.Generator,
) -> Scene:
    """Return a scene whose properties differ by random amounts of these widths."""
    chain = scene.chain
    excitation = scene.excitation

    def draw(key: str, size: int) -> Array:
        numbers = (
            rng.standard_normal(size) if distribution == "normal" else rng.uniform(-1, 1, size)
        )
        return widths[key] * numbers

    for key in widths:
        if key in OF_GRAINS:
            change = draw(key, 1 if key in common else chain.grains)
            factor = 1 + np.broadcast_to(change, chain.grains) / _nominal(chain, key)
            if not (factor > 0).all():
                message = f"{widths[key]:g} is so wide that a value is negative: use a smaller one"
                raise InputError.at(f"tolerances.{key}", message)
            chain = change_chain(chain, factor, OF_GRAINS[key])
        elif key in OF_CHAIN:
            chain = chain.replace(**{key: getattr(chain, key) + float(draw(key, 1)[0])})
        else:
            field = key.removeprefix("excitation.")
            value = getattr(excitation, field) + draw(key, 1)[0]
            excitation = excitation.replace(**{field: value})
    return scene.replace(chain=chain, excitation=excitation)


def _nominal(chain: Chain, key: str) -> Array:
    """Return the nominal values of the grains, (N,)."""
    if key == "diameter":
        return chain.diameters
    if key == "mass":
        return chain.masses
    return np.array([material.youngs_modulus for material in materials_of(chain)])


def _gather(
    scenes: Iterator[Scene],
    measure: Measure,
    realisations: int,
    engine: str | Engine,
    tolerance: float,
    x: ArrayLike | None,
    progress: bool,
) -> Any:
    """Return the statistics of a quantity of all scenes, which are run in batches."""
    if not callable(measure):
        raise InputError.at("measure", f"must be a function of a trajectory (got {shown(measure)})")
    rows: list[Any] = []
    model = solver = 0.0
    with ProgressBar(realisations, "measured", " chains", shown=progress) as bar:
        while batch := list(islice(scenes, BATCH)):
            # The errors of the runs are fields of the result.
            with warnings_aside():
                answers = simulate_many(batch, tolerance, engine)
            for answer in answers:
                try:
                    rows.append(measure(answer))
                except InputError as error:
                    raise InputError(error.under(f"realisations.{len(rows)}")) from None
                model = max(model, answer.error_estimate.model)
                solver = max(solver, answer.error_estimate.solver)
            bar.reach(len(rows))

    def statistics(values: list[Any], name: str) -> MeasuredEnsemble:
        message = f"must return numbers, or arrays of one shape{name}"
        # NumPy would convert None, the result of a function without a return, to NaN.
        if any(value is None for value in values):
            raise InputError.at("measure", f"{message} (got None)")
        stacked = _real(values, "measure", message)
        return MeasuredEnsemble(stacked, _coordinate(x, stacked), model, solver)

    if isinstance(rows[0], Mapping):
        if not all(isinstance(row, Mapping) and row.keys() == rows[0].keys() for row in rows):
            raise InputError.at("measure", "must return the same names for all chains")
        return {key: statistics([row[key] for row in rows], f" as {key}") for key in rows[0]}
    return statistics(rows, "")


def _check_share(share: float) -> None:
    """Raise `InputError` unless the fraction of a quantile is between 0 and 1."""
    if np.ndim(share) or not 0 < numbers(share, "share") < 1:
        raise InputError.at("share", f"must be between 0 and 1 (got {shown(share)})")
