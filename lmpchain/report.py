"""One self-contained HTML page about a run: pictures, fits, errors and provenance."""

from __future__ import annotations

import base64
import warnings
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from io import BytesIO
from os import PathLike
from typing import TYPE_CHECKING

import numpy as np

from .errors import InputError, LmpchainError
from .measure import contact, energy, front, spectrum
from .measure.fit import overview as fit
from .trajectory.trajectory import Trajectory
from .util.files import write_aside
from .util.plotting import COLOURS, figure
from .util.progress import ProgressBar
from .util.templates import render

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOMENTS = (0.25, 0.5, 1.0)  # of the duration, for the waveforms
PARTS = 7  # that take time
SHADES = ("#56B4E9", "#0072B2", "#009E73")


@dataclass(frozen=True)
class Section:
    """A part of the page: picture, verbatim text or table of (name, value), or why it is missing."""

    title: str
    text: str = ""
    picture: str = ""  # PNG, base64
    verbatim: str = ""
    rows: tuple[tuple[str, str], ...] = ()


def write(trajectory: Trajectory, path: str | PathLike[str], progress: bool = False) -> None:
    """Write the page, atomically.

    Parameters
    ----------
    trajectory : Trajectory
    path : path
        Of the HTML file.
    progress : bool
        Whether to show a progress bar.
    """
    with write_aside(path) as aside:
        aside.write_text(page(trajectory, progress), encoding="utf-8")


def page(trajectory: Trajectory, progress: bool = False) -> str:
    """Return the page as self-contained HTML; a part that does not apply to the run says why.

    Parameters
    ----------
    trajectory : Trajectory
    progress : bool
        Whether to show a progress bar.

    Returns
    -------
    str
        HTML.
    """
    scene = trajectory.scene
    title = f"{scene.chain.grains} grains, {scene.excitation.kind}, {scene.duration * 1e6:g} µs"
    with ProgressBar(PARTS, "report", " parts", shown=progress) as bar:
        sections = list(_sections(trajectory, bar))
    return render("report.html", title=title, sections=sections)


def _sections(trajectory: Trajectory, bar: ProgressBar) -> Iterator[Section]:
    yield Section("The run", rows=tuple(_facts(trajectory)))
    drawn: tuple[tuple[str, str, Callable[[Trajectory], Figure]], ...] = (
        ("The wave in space and time", "Velocity of every recorded grain.", spectrum.space_time),
        ("Waveforms", "Points: this run. Lines: linear theory, Eq. (3), exact. Below: their difference.", _waveforms),
        (
            "The front",
            "Amplitude of the first maximum of the velocity at each grain.",
            lambda run: front.track(run).plot(),
        ),
        (
            "Spectra",
            "Velocity spectrum of every grain; the line is the local cut-off frequency.",
            lambda run: spectrum.spectrum(run).plot(),
        ),
        ("Contacts", "Force of every contact; a contact without force is open or about to close.", _contacts),
        (
            "Energy",
            "Energy relative to rest. Drift: change not explained by work done on the chain.",
            lambda run: energy.ledger(run).plot(),
        ),
    )
    for title, text, draw in drawn:
        bar.describe(title)
        bar.advance()
        try:
            yield Section(title, text, _png(draw(trajectory)))
        except LmpchainError as error:
            yield Section(title, f"Not for this run: {error}")
    bar.describe("Fits")
    bar.advance()
    yield Section("Fits", "Fits of the theory to this run.", verbatim=fit.summary(trajectory).table())
    yield Section("Provenance", rows=tuple((key, str(value)) for key, value in trajectory.provenance.items()))
    yield Section("The scene", verbatim=trajectory.scene.to_text())


def _facts(trajectory: Trajectory) -> Iterator[tuple[str, str]]:
    scene, error, cost = trajectory.scene, trajectory.error_estimate, trajectory.cost
    chain = scene.chain
    yield "engine", f"{trajectory.engine}, which solves Eq. ({trajectory.equation})"
    yield "chain", f"{chain.grains} grains, top {chain.top}, bottom {chain.bottom}, exponent {chain.exponent:g}"
    yield "gravity and load", f"{chain.gravity:g} m/s², {chain.top_load:g} N"
    yield (
        "excitation",
        ", ".join(
            f"{key} {value:g}" if isinstance(value, int | float) else f"{key} of {np.size(value)} values"
            for key, value in scene.excitation.given().items()
            if value is not None
        ),
    )
    yield "strike number", f"{scene.strike_number:.3g}: linear theory needs it to be far below 1"
    yield "recorded", f"{trajectory.grains.size} grains at {trajectory.time.size} times up to {scene.duration:g} s"
    yield "largest velocity", f"{np.abs(trajectory.velocity).max():.6g} m/s"
    yield "largest displacement", f"{np.abs(trajectory.displacement).max():.6g} m"
    yield "estimated error", f"{error.total:.2g} = {error.model:.2g} (equation) + {error.solver:.2g} (solver)"
    for key, value in asdict(cost).items():
        name = f"{key.removesuffix('_s')} (s)" if key.endswith("_s") else key
        yield name.replace("_", " "), f"{value:.4g}" if isinstance(value, float) else str(value)


def _png(picture: Figure) -> str:
    buffer = BytesIO()
    picture.savefig(buffer, format="png", dpi=110)
    return base64.b64encode(buffer.getvalue()).decode("ascii")


def _waveforms(trajectory: Trajectory) -> Figure:
    """Draw velocity against grain number at some times, with linear theory where it applies."""
    picture = figure(8, 5.5)
    wave, apart = picture.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    linear = _linear(trajectory)
    largest = np.abs(trajectory.velocity).max() or 1.0
    for part, shade in zip(MOMENTS, SHADES, strict=True):
        row = round(part * (trajectory.time.size - 1))
        label = f"{trajectory.time[row] * 1e6:.4g} µs"
        wave.plot(trajectory.grains, trajectory.velocity[row], "o", mfc="none", ms=4, color=shade, label=label)
        if linear is not None:
            wave.plot(trajectory.grains, linear[row], color=shade, lw=1)
            apart.plot(trajectory.grains, (trajectory.velocity[row] - linear[row]) / largest, color=shade, lw=1)
    reached = trajectory.grains[np.abs(trajectory.velocity).max(0) >= 1e-3 * largest]
    if reached.size:
        wave.set_xlim(reached.min() - 4, reached.max() + 4)
    wave.set_ylabel("velocity downward (m/s)")
    wave.legend(frameon=False)
    apart.axhline(0, color=COLOURS["lammps"], lw=0.8)
    apart.set(xlabel="grain, from the top", ylabel="difference\n/ largest velocity")
    if linear is None:
        apart.text(0.5, 0.5, "no linear theory of this scene", transform=apart.transAxes, ha="center", va="center")
    return picture


def _linear(trajectory: Trajectory) -> np.ndarray | None:
    """Return the velocity by linear theory, (T, G) m/s, None where it does not apply."""
    from .simulation.api import simulate

    try:
        with warnings.catch_warnings(action="ignore"):  # the difference is drawn
            return simulate(trajectory.scene, "chebyshev").velocity
    except InputError:
        return None


def _contacts(trajectory: Trajectory) -> Figure:
    history = contact.contacts(trajectory)
    picture = history.plot()
    openings = sum(event.opens for event in history.events())
    picture.axes[0].set_title(f"{openings} openings", loc="left")
    return picture
