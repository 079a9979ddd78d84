"""Time averages of motions that cannot be predicted: `lmpchain.averages`."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass
from itertools import islice
from typing import Any, NamedTuple

import numpy as np

from ..chain.ground import is_spring
from ..engines.cost_model import announce, seconds
from ..engines.native import Native
from ..engines.stepping.rounding import perturb
from ..engines.stepping.step_choice import FIRST_STEP
from ..errors import InputError, ToleranceNotMet, check_tolerance, shown
from ..integrators.batch import ChainBatch
from ..integrators.methods import SPLITTINGS, Splitting
from ..integrators.stepper import NativeStepper
from ..integrators.steps import Steps
from ..scene.scene import Scene, check_scene
from ..util.arrays import Array, check_flags
from ..util.notebook import Shown
from ..util.plotting import Axes, chart, finish, prefixed
from ..util.progress import RATE, ProgressBar
from ..util.remarks import warn
from ..util.tables import align, number
from ..util.tabular import NamedColumn, Tabular
from ..util.validation import check_positive, make_unchecked
from .batch_means import BATCHING, Estimate, estimate
from .observables import Observable, observable

BLOCK_NUMBERS = 2**17  # Number of samples x grains x copies in memory at a time.
A_TIME = "a time above 0 s"
NO_INTERVAL = "unknown"  # Text for the half-width of an interval if the time is too short.
STEPS_AT_ONCE = 2**23  # Number of grains times steps between two opportunities to stop.


@dataclass(frozen=True)
class Averaging:
    """Parameters of time averages (see analysis/calibration/batch_means.py).

    Attributes
    ----------
    warm_up : float
        Fraction of the time that is left out at the beginning.
    turn : float
        Largest phase of the fastest motion between two samples, rad.
    fewest : int
        Smallest number of samples in a stretch.
    energies : int
        Number of samples from one evaluation of the energy to the next.
    judged : int
        Number of evaluations of the energy that are required before a step is rejected.
    attempts : int
        Largest number of step sizes that are tried.
    change : float
        Relative difference of the initial values of two copies of a chain.
    apart : float
        Distance of two copies, relative to the largest motion, from which on they are independent.
    """

    warm_up: float = 0.2
    turn: float = 2.0
    fewest: int = 8
    energies: int = 8
    judged: int = 64
    attempts: int = 8
    change: float = 1e-9
    apart: float = 0.1


@dataclass(frozen=True)
class EnergyErrors:
    """Relative energy errors of splittings (see analysis/calibration/batch_means.py).

    Attributes
    ----------
    wobble : float
        Root mean square of the error of velocity Verlet at omega h = 1. It is proportional to h^2.
    walk : float
        Step of the random walk that opening contacts cause in each radian of the fastest motion,
        at omega h = 1. It is proportional to h^2.
    smooth : float
        Root mean square of the error of rkn6 at omega h = 1 if no contact opens. It is proportional
        to h^6.
    longest : float
        Largest omega h that is used, as a fraction of the stability limit.
    """

    wobble: float = 0.03
    walk: float = 1.1e-4
    smooth: float = 1e-7
    longest: float = 0.25


AVERAGING = Averaging()
LEAST_TOLERANCE = 1e-10  # Rounding alone changes the energy of long motions by about this fraction.
ENERGY_ERRORS = EnergyErrors()


@dataclass(frozen=True, eq=False, repr=False)
class Averages(Shown, Tabular):
    """Averages of quantities over time, by name, with 95 % confidence intervals.

    Attributes
    ----------
    scene : Scene
        The scene of the averaged motion.
    time : float
        Time of the motion of each copy, warm-up included, s.
    warm_up : float
        Time that is left out at the beginning, s.
    copies : int
        Number of copies of the chain.
    unit : dict of str
        Unit of each quantity; empty for a ratio.
    mean : dict of float
        Mean of each quantity over time.
    variance : dict of float
        Variance of each quantity over time.
    interval : dict of (float, float)
        95 % confidence interval of each mean, including the effect of the energy error; infinite if
        the time was too short.
    variance_interval : dict of (float, float)
        95 % confidence interval of each variance, as for the mean.
    correlation_time : dict of float
        Correlation time of each quantity, the integral of its correlation over positive lags, s;
        NaN if the time was too short.
    batches : dict of int
        Number of independent batches of the interval of the mean; 0 if there is no interval.
    energy_error : float
        Error of the integration: root mean square of the relative change of the energy above rest
        since t = 0.
    integrator : str
        Name of the integrator.
    step : float
        Time step, s.
    middle : (S,) array
        Middle of each of the S = 256 stretches of time after the warm-up, s.
    stretch_mean : dict of (R, S) arrays
        Mean of each quantity in each stretch of time, for each of R copies.
    """

    scene: Scene
    time: float
    warm_up: float
    copies: int
    unit: Mapping[str, str]
    mean: Mapping[str, float]
    variance: Mapping[str, float]
    interval: Mapping[str, tuple[float, float]]
    variance_interval: Mapping[str, tuple[float, float]]
    correlation_time: Mapping[str, float]
    batches: Mapping[str, int]
    energy_error: float
    integrator: str
    step: float
    middle: Array
    stretch_mean: Mapping[str, Array]

    def __repr__(self) -> str:
        """Return the first means with half their intervals, and the number of the other means."""
        said = []
        for name, mean in islice(self.mean.items(), 2):
            half_width = self.interval[name][1] - mean
            error = f"{half_width:.1g}" if math.isfinite(half_width) else NO_INTERVAL
            said.append(f"{name} = {mean:.4g} ± {error} {self.unit[name]}".rstrip())
        others = len(self.mean) - len(said)
        said += [f"{others} more"] * (others > 0)
        return f"Averages({', '.join(said)}; over {self.time - self.warm_up:.4g} s)"

    def _columns(self) -> Iterator[NamedColumn]:
        names = list(self.mean)
        yield NamedColumn("quantity", "", names)
        yield NamedColumn("unit", "", [self.unit[name] for name in names])
        for title, values in (("mean", self.mean), ("variance", self.variance)):
            ends = self.interval if title == "mean" else self.variance_interval
            yield NamedColumn(title, "", [values[name] for name in names])
            yield NamedColumn(f"{title}_from", "", [ends[name][0] for name in names])
            yield NamedColumn(f"{title}_to", "", [ends[name][1] for name in names])
        times = [self.correlation_time[name] for name in names]
        yield NamedColumn("correlation_time", "s", times)
        yield NamedColumn("batches", "", [self.batches[name] for name in names])

    def table(self) -> str:
        """Return means, variances and their intervals as text."""
        rows = [("quantity", "mean, 95 %", "variance, 95 %", "corr. time", "batches")]
        for name, mean in self.mean.items():
            unit = self.unit[name]
            squared = f"({unit})2" if "/" in unit else f"{unit}2" if unit else ""
            half_width = self.interval[name][1] - mean
            low, high = self.variance_interval[name]
            of_mean = f"± {half_width:.1e}" if math.isfinite(half_width) else f"± {NO_INTERVAL}"
            of_variance = (
                f"({low:.4g} to {high:.4g})" if math.isfinite(high) else f"({NO_INTERVAL})"
            )
            rows.append(
                (
                    name,
                    f"{mean:.6g} {of_mean} {unit}".rstrip(),
                    f"{self.variance[name]:.4g} {of_variance} {squared}".rstrip(),
                    number(self.correlation_time[name], ".2g", "s", missing="too long"),
                    str(self.batches[name]),
                )
            )
        copies = f" of {self.copies} copies" if self.copies > 1 else ""
        lines = [
            f"averages over {self.time - self.warm_up:.6g} s{copies}, after a warm-up of "
            f"{self.warm_up:.4g} s that is left out",
            *align(rows),
            f"{self.integrator}, step {self.step:.3g} s: intervals include the energy error of "
            f"{self.energy_error:.1e}",
        ]
        return "\n".join(lines)

    def to_json(self) -> dict[str, Any]:
        """Return all numbers for a JSON file, with null in place of infinity."""

        def ends(interval: tuple[float, float]) -> list[float | None]:
            return [end if math.isfinite(end) else None for end in interval]

        quantities = {
            name: {
                "unit": self.unit[name],
                "mean": mean,
                "interval": ends(self.interval[name]),
                "variance": self.variance[name],
                "variance_interval": ends(self.variance_interval[name]),
                "correlation_time_s": ends((self.correlation_time[name], 0.0))[0],
                "batches": self.batches[name],
            }
            for name, mean in self.mean.items()
        }
        return {
            "time_s": self.time,
            "warm_up_s": self.warm_up,
            "copies": self.copies,
            "integrator": self.integrator,
            "step_s": self.step,
            "energy_error": self.energy_error,
            "quantities": quantities,
        }

    def plot(self, ax: Axes | None = None, of: str | None = None) -> Axes:
        """Draw the means of batches of a quantity over time, and return the axes.

        The chart also shows the average up to each time, and the final interval as a band.

        Parameters
        ----------
        ax : Axes, optional
            Axes to draw on; by default new ones.
        of : str, optional
            Name of the quantity; by default the first one.
        """
        name = next(iter(self.mean)) if of is None else of
        if name not in self.mean:
            raise InputError.at("of", f"must be one of {', '.join(self.mean)} (got {shown(of)})")
        words = name.replace("_", " ")
        unit = self.unit[name]
        ax = chart(ax, "time [s]", f"{words} [{unit}]")
        means = self.stretch_mean[name]
        grouped = self.middle.reshape(-1, BATCHING.finer).mean(1)
        for row, copy in enumerate(means):
            batches = copy.reshape(-1, BATCHING.finer).mean(1)
            label = "means of batches" if row == 0 else None
            ax.plot(grouped, batches, "o", ms=3, color="0.6", label=label)
        so_far = np.cumsum(means.mean(0)) / np.arange(1, self.middle.size + 1)
        ax.plot(self.middle, so_far, lw=1.2, label="average up to here")
        low, high = self.interval[name]
        if math.isfinite(high - low):
            label = "95 % interval of the average"
            ax.axhspan(low, high, color="C1", alpha=0.25, lw=0, label=label)
        if self.warm_up:
            ax.axvspan(0.0, self.warm_up, color="0.92", lw=0, label="warm-up, left out")
        ax.set_xlim(0.0, self.time)
        mean = prefixed(self.mean[name], unit, 5) if unit else f"{self.mean[name]:.5g}"
        return finish(ax, f"{words}: {mean}")


class _Course(NamedTuple):
    """The samples of an averaged motion.

    Attributes
    ----------
    scene : Scene
        The scene for the whole time, with these samples.
    warm_up : int
        Number of samples that are left out.
    stretch : int
        Number of samples in each stretch after the warm-up.
    """

    scene: Scene
    warm_up: int
    stretch: int

    def pieces(self, most: int) -> Iterator[tuple[int, int, int]]:
        """Yield time interval (-1: warm-up), first and last sample of pieces of `most` samples."""
        first = 1
        lengths = [self.warm_up, *[self.stretch] * BATCHING.stretches]
        for stretch, length in enumerate(lengths, -1):
            end = first + length
            for begin in range(first, end, most):
                yield stretch, begin, min(begin + most, end) - 1
            first = end


class _Sums(NamedTuple):
    """Sums of Q quantities of R copies over the samples of each stretch.

    Attributes
    ----------
    reference : (Q, 1) array
        Values near the means. They are subtracted to avoid cancellation in the sums of squares.
    first : (Q, R, S) array
        Sums of the differences from `reference`.
    square : (Q, R, S) array
        Sums of the squares of these differences.
    energy : (R, S) array
        Mean relative error of the energy in each stretch.
    energy_error : float
        Root mean square of the energy error over all times.
    lost_after : float or None
        Fraction of the motion after which the run ended because the energy error was too large;
        None if it was completed.
    """

    reference: Array
    first: Array
    square: Array
    energy: Array
    energy_error: float
    lost_after: float | None


def averages(
    scene: Scene,
    quantities: Sequence[str],
    *,
    time: float | None = None,
    tolerance: float = 1e-4,
    warm_up: float | None = None,
    copies: int = 1,
    progress: bool = False,
) -> Averages:
    """Average quantities of a chain over time, with 95 % confidence intervals.

    Beyond the predictability horizon of a chaotic chain, no run predicts the positions of grains.
    Averages over time remain well defined, because a perturbed motion has the same averages. A
    symplectic method integrates the chain with equal steps, which are so short that the energy is
    conserved within the tolerance. No samples are recorded.

    Parameters
    ----------
    scene : Scene
        Scene of a chain that conserves energy and whose grains cannot fly away, without a force or
        drive. Its samples are ignored, and its duration if `time` is given.
    quantities : list of str
        "kinetic_energy", "potential_energy" (above rest), "temperature" (twice the mean kinetic
        energy of the grains that move, kB T in J), "equipartition" (see Notes), "force:10" of
        contact 10, "kinetic_energy:10", "velocity:10" and "displacement:10" of grain 10.
    time : float, optional
        Time of the motion, warm-up included, s; by default the duration of the scene.
    tolerance : float
        Largest root mean square of the energy error, relative to the energy above rest. It
        determines the step and the effect of the integration on averages. The statistical part of
        the intervals depends on the time and the copies.
    warm_up : float, optional
        Time that is left out at the beginning for equilibration, s; by default a fifth of the time.
    copies : int
        Number of chains, with initial values that differ by a relative 1e-9, which are averaged
        together on all cores. Chaos must separate them within the warm-up.
    progress : bool
        Whether to show a progress bar.

    Returns
    -------
    Averages
        Means, variances and their confidence intervals.

    Raises
    ------
    InputError
        If an option is wrong, if energy is not conserved, if grains can fly away, or if copies are
        still close to each other after the warm-up.
    ToleranceNotMet
        If the energy error exceeds the tolerance with every step that is tried.

    Warns
    -----
    UserWarning
        If the correlation time of a quantity is so long that its interval is infinite, or based on
        the fewest batches.

    Notes
    -----
    Intervals are computed from the means of 256 batches of each copy
    (`lmpchain.simulation.batch_means`). Student's t distribution is applied to the amplitudes of
    16, 8 or 4 slow cosines; longer correlation times require fewer cosines.

    The intervals include the effect of the energy error e. Averages grow at most with the first
    power of the energy, and variances with the second. An average may therefore shift by e times
    the larger of its distance from the value at rest and the standard deviation, and a variance by
    the fraction 2 e. The interval of an average includes twice this shift, because the truncation
    error of the steps also shifts it directly, by about the same amount for beads between walls.

    The equipartition is ``(M + 2)/3 sum K_n^2 / (sum K_n)^2`` of the kinetic energies K_n of the M
    grains that move. Its mean is 1 if all velocities of the same kinetic energy are equally likely,
    as in equilibrium, and (M + 2)/3 if one grain has all of the energy.

    For a sonic vacuum between walls the microcanonical ensemble is known: the fraction of the
    kinetic energy has a beta distribution with the parameters M/2 and M/(delta + 1), whose mean is
    (delta + 1) / (delta + 3); M. Przedborski, S. Sen and T. A. Harroun, Phys. Rev. E 95, 032903
    (2017), arXiv:1605.08970.

    Examples
    --------
    >>> from lmpchain import Chain, Impulse
    >>> walls = {"gravity": 0, "top": "wall", "bottom": "wall"}
    >>> chain = Chain(grains=10, material="steel", diameter=6e-3, **walls)
    >>> scene = Scene(chain=chain, excitation=Impulse(velocity=1.0), duration=0.1)
    >>> average = averages(scene, ["kinetic_energy"], tolerance=1e-3)
    >>> low, high = average.interval["kinetic_energy"]
    >>> low < 5 / 9 * scene.energy < high
    True
    """
    check_tolerance(tolerance)
    check_flags(progress=progress)
    if tolerance < LEAST_TOLERANCE:
        cure = "the statistical error is far larger"
        fault = f"must be at least {LEAST_TOLERANCE:g} (got {tolerance:g}): {cure}"
        raise InputError.at("tolerance", fault)
    names = _check(scene, quantities, copies)
    observables = [observable(scene.chain, name) for name in names]
    course = _course(scene, time, warm_up)
    if copies > 1 and not course.warm_up:
        _refuse_copies(course)
    longer = course.scene
    scenes = _copies(scene, longer, copies)
    method, reach = _first_reach(longer, tolerance)
    samples = longer.intervals
    error = math.inf
    with ProgressBar(samples, "averages", " samples", layout=RATE, shown=progress) as bar:
        for _ in range(AVERAGING.attempts):
            steps = math.ceil(longer.sampling_phase / reach)
            # Only the first attempt is announced.
            if error == math.inf:
                work = Native.seconds_per_grain_step * method.evaluations * steps * samples
                cost_s = seconds(Native.name, 0.0, work * copies * scene.chain.grains)
                announce(
                    cost_s,
                    f"the average over {copies * steps * samples} steps of {method.name}",
                    "a shorter time, fewer copies or a larger tolerance takes less",
                )
            schedule = Steps.spread(longer.sampling_interval, steps)
            sums = _follow(course, scenes, observables, method, schedule, tolerance, bar)
            if sums.lost_after is None:
                named = dict(zip(names, observables, strict=True))
                return _conclude(scene, course, named, sums, schedule, method.name)
            error = sums.energy_error
            # The energy error is extrapolated to the end like a random walk.
            ratio = (tolerance / (error / math.sqrt(sums.lost_after))) ** (1 / method.order)
            reach *= min(max(0.9 * ratio, 0.25), 0.8) if math.isfinite(ratio) else 0.25
            bar.reach(0)
    reason = f"the energy error is {error:.2g} after {AVERAGING.attempts} attempts at shorter steps"
    cure = "ask lmpchain.averages for a larger tolerance or a shorter time"
    raise ToleranceNotMet(f"{reason}, above the tolerance of {tolerance:.2g}: {cure}")


def _check(scene: Scene, quantities: Sequence[str], copies: int) -> list[str]:
    """Return the names of the quantities; raise `InputError` if one cannot be averaged."""
    check_scene(scene)
    names = [quantities] if isinstance(quantities, str) else []
    with suppress(TypeError):
        names = names or list(quantities)
    faults = []
    if not names or len(set(map(str, names))) < len(names):
        given = f'such as ["kinetic_energy", "force:10"] (got {shown(quantities)})'
        faults.append(("quantities", f"must be names, each once, {given}"))
    if isinstance(copies, bool) or not isinstance(copies, int) or copies < 1:
        faults.append(("copies", f"must be a whole number from 1 (got {shown(copies)})"))
    if faults := [*faults, *_unsteady(scene)]:
        raise InputError(faults)
    return names


def _unsteady(scene: Scene) -> Iterator[tuple[str, str]]:
    """Yield the reasons why the motion does not last forever at constant energy."""
    chain = scene.chain
    if chain.damped:
        cure = "leave damping out, as chain.replace(damping=None) does"
        yield "chain.damping", f"averages require a motion that never ends: {cure}"
    if chain.ground is not None and not is_spring(chain.ground):
        cure = "leave it out, as chain.replace(ground=None) does"
        yield "chain.ground", f"averages support only springs to the ground: {cure}"
    if scene.excitation.does_work:
        cure = "use an impulse, a displacement or a profile"
        yield "excitation", f"must do no work after t = 0: {cure}"
    elif scene.at_rest:
        yield "excitation", "moves nothing: there is nothing to average"
    # Neither weight nor load brings back grains that fly away.
    held = chain.compressed or chain.top == "wall"
    if not held or chain.bottom == "free" or (chain.loose_grains and chain.top == "free"):
        cure = 'use top = "wall" and bottom = "wall", gravity or a load on grain 1'
        yield "chain.top", f"grains would fly away: {cure}"


def _course(scene: Scene, time: float | None, warm_up: float | None) -> _Course:
    """Return the samples of a motion of this time and warm-up, s."""
    total = scene.duration if time is None else check_positive("time", time, A_TIME)
    left_out = AVERAGING.warm_up * total
    if warm_up is not None:
        left_out = check_positive("warm_up", warm_up, A_TIME) if warm_up else 0.0
        if left_out >= total:
            fault = f"must be shorter than the time of {total:g} s (got {warm_up:g})"
            raise InputError.at("warm_up", fault)
    lasting = (total - left_out) / BATCHING.stretches
    stretch = max(AVERAGING.fewest, math.ceil(lasting * scene.highest_frequency / AVERAGING.turn))
    interval = lasting / stretch
    before = round(left_out / interval)
    samples = before + stretch * BATCHING.stretches
    # A valid scene stays valid for another time.
    longer = make_unchecked(
        Scene,
        chain=scene.chain,
        excitation=scene.excitation,
        duration=samples * interval,
        samples=samples + 1,
    )
    return _Course(longer, before, stretch)


def _copies(scene: Scene, longer: Scene, copies: int) -> list[Scene]:
    """Return the scene for a longer time, and copies with slightly different initial values."""
    changes = AVERAGING.change * np.arange(1, copies)
    others = [
        make_unchecked(
            Scene,
            chain=scene.chain,
            excitation=perturb(scene, change).excitation,
            duration=longer.duration,
            samples=longer.samples,
        )
        for change in changes.tolist()
    ]
    return [longer, *others]


def _first_reach(scene: Scene, tolerance: float) -> tuple[Splitting, float]:
    """Return the method for a motion, and omega h of its first step.

    A method of high order is best for smooth forces. If contacts open, the energy error of an
    opening does not depend on the order, and velocity Verlet has the cheapest steps.
    """
    if scene.largest_strain <= FIRST_STEP.safe_strain:
        method = SPLITTINGS["rkn6"]
        reach = (tolerance / ENERGY_ERRORS.smooth) ** (1 / method.order)
    else:
        method = SPLITTINGS["verlet"]
        radians = scene.total_phase
        error = ENERGY_ERRORS.wobble + ENERGY_ERRORS.walk * math.sqrt(radians)
        reach = math.sqrt(tolerance / error)
    return method, min(reach, ENERGY_ERRORS.longest * min(method.stability_limit, math.pi))


def _follow(
    course: _Course,
    scenes: Sequence[Scene],
    observables: Sequence[Observable],
    method: Splitting,
    schedule: Steps,
    tolerance: float,
    bar: ProgressBar,
) -> _Sums:
    """Return sums over a motion, which ends early if its energy error is too large."""
    chain = course.scene.chain
    batch = ChainBatch(scenes)
    copies = len(scenes)
    block = max(1, BLOCK_NUMBERS // (copies * chain.grains))
    u, v = np.zeros((2, copies, block, chain.grains))
    energies = np.array([scene.energy for scene in scenes])[:, None]
    shape = (len(observables), copies, BATCHING.stretches)
    first, square = np.zeros((2, *shape))
    reference = np.zeros((len(observables), 1))
    drift = np.zeros(shape[1:])
    squares = error = 0.0
    looked = 0
    lost_after = None
    threads = min(copies, len(os.sched_getaffinity(0)))
    with closing(NativeStepper(batch, method, schedule, {}, threads)) as stepper:
        for stretch, begin, end in course.pieces(block):
            while stepper.sample < end:
                stepper.fill(u, v, begin, end, max(1, STEPS_AT_ONCE // chain.grains))
                bar.reach(stepper.sample)
            shown_u = u[:, : end + 1 - begin]
            shown_v = v[:, : end + 1 - begin]
            some = slice(None, None, AVERAGING.energies)
            energy = chain.excess_energy(shown_u[:, some], shown_v[:, some])
            energy = energy / energies - 1
            if begin == course.warm_up + 1:
                # Energy errors during the warm-up do not affect the averages.
                squares = 0.0
                looked = 0
            squares += float((energy**2).sum())
            looked += energy.size
            error = math.sqrt(squares / looked)
            # The wave is steepest at the beginning.
            allowed = 4 * tolerance if stretch < 0 else tolerance
            if looked >= AVERAGING.judged and not error <= allowed:
                lost_after = end / course.scene.samples
                break
            if stretch < 0:
                if end == course.warm_up:
                    _check_apart(shown_u[:, -1], course)
                continue
            drift[:, stretch] += energy.mean(-1) * (end + 1 - begin) / course.stretch
            for row, quantity in enumerate(observables):
                values = quantity.measure(shown_u, shown_v)
                if begin == course.warm_up + 1:
                    reference[row] = values.mean()
                values = values - reference[row]
                first[row, :, stretch] += values.sum(-1)
                square[row, :, stretch] += (values**2).sum(-1)
    return _Sums(reference, first, square, drift, error, lost_after)


def _check_apart(u: Array, course: _Course) -> None:
    """Raise `InputError` unless copies, (R, N) m, have become as distant as independent motions."""
    distances = np.abs(u[1:] - u[0]).max(-1)
    if (distances < AVERAGING.apart * np.abs(u).max()).any():
        _refuse_copies(course)


def _refuse_copies(course: _Course) -> None:
    """Raise `InputError`, because copies are not independent after the warm-up."""
    warm_up = course.warm_up * course.scene.sampling_interval
    cure = "use one copy, or a longer warm_up"
    fault = f"are still close to each other after {warm_up:.3g} s of warm-up"
    raise InputError.at("copies", f"{fault}: {cure}")


def _conclude(
    scene: Scene,
    course: _Course,
    observables: Mapping[str, Observable],
    sums: _Sums,
    schedule: Steps,
    integrator: str,
) -> Averages:
    """Return the averages from the sums over stretches."""
    copies = sums.first.shape[1]
    lasting = course.stretch * BATCHING.stretches * course.scene.sampling_interval
    warm_up = course.warm_up * course.scene.sampling_interval
    ends = np.linspace(warm_up, warm_up + lasting, BATCHING.stretches + 1)
    fields = ("mean", "variance", "interval", "variance_interval", "correlation_time", "batches")
    results: dict[str, dict[str, Any]] = {field: {} for field in fields}
    stretch_mean = {}
    for row, (name, quantity) in enumerate(observables.items()):
        from_reference = sums.first[row] / course.stretch
        stretch_mean[name] = from_reference + sums.reference[row]
        mean = estimate(stretch_mean[name], sums.energy)
        centre = mean.mean - float(sums.reference[row, 0])
        deviation = sums.square[row] / course.stretch - 2 * centre * from_reference + centre**2
        spread = estimate(deviation, sums.energy)
        # The values are closer to their own mean than to the true mean.
        known = mean.error if mean.batches else 0.0
        variance = max(spread.mean, 0.0) + known**2
        results["mean"][name] = mean.mean
        results["variance"][name] = variance
        size = max(abs(mean.mean - quantity.at_rest), math.sqrt(variance))
        # The truncation error of the steps also shifts an average directly, by about the same
        # amount. Without this term only 80 of 100 intervals cover the kinetic energy of 38 beads.
        half_width = mean.half_width + 2 * sums.energy_error * size
        results["interval"][name] = (mean.mean - half_width, mean.mean + half_width)
        results["variance_interval"][name] = _of_variance(variance, mean, spread, sums.energy_error)
        results["batches"][name] = mean.batches
        results["correlation_time"][name] = math.nan
        if mean.batches and variance:
            results["correlation_time"][name] = copies * lasting * known**2 / (2 * variance)
    time = course.scene.duration
    if unknown := [name for name, batches in results["batches"].items() if not batches]:
        short = f"a time of {time:.3g} s is too short for an interval of {', '.join(unknown)}"
        cure = f"try time={4 * time:.2g}, or copies"
        warn(f"{short}, because of a long correlation time: {cure}", stacklevel=3)
    fewest = copies * BATCHING.cosines[-1]
    if few := [name for name, batches in results["batches"].items() if batches == fewest]:
        says = f"in a time of {time:.3g} s the interval of {', '.join(few)} has only {fewest}"
        cure = f"it is less reliable than others: try time={4 * time:.2g}, or copies"
        warn(f"{says} independent batches; {cure}", stacklevel=3)
    return Averages(
        scene=scene,
        time=time,
        warm_up=warm_up,
        copies=copies,
        unit={name: quantity.unit for name, quantity in observables.items()},
        energy_error=sums.energy_error,
        integrator=integrator,
        step=schedule.step,
        middle=(ends[1:] + ends[:-1]) / 2,
        stretch_mean=stretch_mean,
        **results,
    )


def _of_variance(
    variance: float, mean: Estimate, spread: Estimate, energy_error: float
) -> tuple[float, float]:
    """Return the interval of a variance, symmetric in its logarithm, as for chi^2."""
    if not variance:
        return 0.0, 0.0
    if not (mean.batches and spread.batches):
        return 0.0, math.inf
    half_width = spread.half_width / variance + 2 * energy_error
    return variance * math.exp(-half_width), variance * math.exp(half_width)
