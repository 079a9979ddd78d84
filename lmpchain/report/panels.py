"""The pictures of a page, each with a caption that says what is seen in it."""

from __future__ import annotations

import base64
import warnings
from dataclasses import dataclass
from io import BytesIO
from typing import TYPE_CHECKING

import numpy as np

from ..errors import InputError
from ..measure import contact, energy, front, spectrum
from ..simulation.api import simulate
from ..theory.front import decay
from ..trajectory.trajectory import Trajectory
from ..util.arrays import Array
from ..util.plotting import COLOURS, axes_in_units, figure, legend, si
from .live import moving, moving_part

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MOMENTS = (0.25, 0.5, 1.0)  # of the duration, for the waveforms
SHADES = ("#56B4E9", "#0072B2", "#009E73")
# inches: letters are readable on a phone, and two pictures fit side by side
WIDTH = 4.7
HEIGHT = 3.5
MOST_MARKERS = 2000  # drawn one by one; of more a picture is smaller as pixels
REFLECTED = 3  # last grains, whose peak is made together with what comes back from the end
ONWARD = 0.9  # part of the grains that a front passes later than those before them


@dataclass(frozen=True)
class Panel:
    """A picture, what it shows in words, and whether it is a map, whose colours stay in the dark."""

    caption: str
    alt: str
    svg: str
    map: bool = False


def _panel(ax: Axes, caption: str, alt: str = "", map: bool = False) -> Panel:
    import matplotlib

    buffer = BytesIO()
    with matplotlib.rc_context({"svg.hashsalt": "lmpchain"}):
        metadata = {"Date": None, "Creator": None}
        ax.figure.figure.savefig(buffer, format="svg", transparent=True, metadata=metadata, dpi=200)
    return Panel(caption, alt or caption, base64.b64encode(buffer.getvalue()).decode("ascii"), map)


def _axes() -> Axes:
    return axes_in_units(figure(WIDTH, HEIGHT).subplots(), "", "")


def wave(run: Trajectory) -> Panel:
    """Draw the space-time picture, for readers without the live view."""
    run = moving_part(run)
    first, last = moving(run)
    ax = run.plot(_axes())
    ax.set_ylim(last + 0.5, first - 0.5)
    return _panel(
        ax, f"Velocity of grains {first} to {last} over time: downward red, upward blue.", map=True
    )


def waveforms(run: Trajectory) -> Panel:
    """Draw velocity against grain number at some times, with linear theory where it applies."""
    run = moving_part(run)
    picture = figure(WIDTH, 4.4)
    above, apart = (
        axes_in_units(ax, "", "")
        for ax in picture.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    )
    linear = _linear(run)
    largest = np.abs(run.velocity).max() or 1.0
    for part, shade in zip(MOMENTS, SHADES, strict=True):
        row = round(part * (run.time.size - 1))
        label = si(run.time[row], "s")
        dense = run.grains.size > MOST_MARKERS
        above.plot(
            run.grains,
            run.velocity[row],
            "o",
            mfc="none",
            ms=4,
            color=shade,
            label=label,
            rasterized=dense,
        )
        if linear is not None:
            above.plot(run.grains, linear[row], color=shade, lw=1)
            apart.plot(run.grains, (run.velocity[row] - linear[row]) / largest, color=shade, lw=1)
    first, last = moving(run)
    above.set_xlim(first - 0.5, last + 0.5)
    above.set_ylabel("velocity downward (m/s)")
    legend(above)
    apart.axhline(0, color=COLOURS["lammps"], lw=0.8)
    apart.set(xlabel="grain, from the top", ylabel="difference\n/ largest")
    peak = int(run.grains[np.abs(run.velocity[-1]).argmax()])
    said = (
        f"At the end the motion is largest at grain {peak}, "
        f"{si(np.abs(run.velocity[-1]).max(), 'm/s', 1)}. "
    )
    if linear is None:
        apart.text(
            0.5,
            0.5,
            "no linear theory of this scene",
            transform=apart.transAxes,
            ha="center",
            va="center",
        )
        return _panel(above, f"{said}There is no linear theory of this scene.")
    off = np.abs(run.velocity - linear).max() / largest
    said += (
        f"Points: this run. Lines: linear theory, Eq. (3), at most {off:.2g} of the largest "
        "velocity away (below)."
    )
    return _panel(above, said)


def _linear(run: Trajectory) -> Array | None:
    """Return the velocity by linear theory, (T, G) m/s, None where it does not apply."""
    try:
        with warnings.catch_warnings(action="ignore"):  # the difference is drawn
            return simulate(run.scene, "chebyshev").velocity
    except InputError:
        return None


def arrival(run: Trajectory) -> Panel:
    """Draw height and arrival of the front against depth, each with its law where there is one."""
    from matplotlib.ticker import EngFormatter, LogLocator

    found = _front(run)
    chain = run.scene.chain
    source = getattr(run.scene.excitation, "grain", 1)
    picture = figure(WIDTH, 4.8)
    height, time = (axes_in_units(ax, "", "") for ax in picture.subplots(2, 1))
    depth, values, _ = found.against_depth("amplitude")
    height.plot(depth, values, ".", ms=4, label="this run")
    power, name = _decay(run)
    if power is not None:
        law = values[-1] * (depth / depth[-1]) ** -power
        height.plot(
            depth,
            law,
            "--",
            lw=1,
            label=f"{name}: power -{power:.3g}" if power else f"{name}: constant",
        )
    height.set(xscale="log", yscale="log", xlabel="depth h = n − 1/2 (grains)", ylabel="peak (m/s)")
    for axis in (height.xaxis, height.yaxis):
        axis.set(
            major_locator=LogLocator(subs=(1, 2, 3, 5)),
            major_formatter=EngFormatter(),
            minor_formatter="",
        )
    legend(height)
    time.plot(found.grain, 1e6 * found.time, ".", ms=4, label="this run")
    if chain.compressed:
        expected = spectrum.travel_time(chain, max(1, source))[found.grain - 1]
        time.plot(found.grain, 1e6 * expected, "--", lw=1, label="long weak wave")
    time.set(xlabel="grain, from the top", ylabel="arrival (µs)")
    legend(time)
    said = (
        f"The front passes {found.grain.size} grains; its peak goes from "
        f"{si(values[0], 'm/s', 1)} at grain {found.grain[0]} to {si(values[-1], 'm/s', 1)} at "
        f"grain {found.grain[-1]}."
    )
    return _panel(
        height,
        said + (f" Dashed: {name}." if power is not None else " No law is known for this chain."),
    )


def _front(run: Trajectory) -> front.Front:
    """Return the front below the grain that is struck; raises `InputError` where there is none."""
    source = getattr(run.scene.excitation, "grain", None)
    if source is None or getattr(run.scene.excitation, "frequency", None):
        raise InputError.at(
            "excitation", "sends no single front: there is one after a strike or a push on a grain"
        )
    found = front.track(run).between(source + 1, run.scene.chain.grains - REFLECTED)
    onward = np.mean(np.diff(found.time) > 0) if found.grain.size >= front.FEWEST else 0.0
    if onward < ONWARD:
        raise InputError.at(
            "front", f"none travels downward from grain {source} past {front.FEWEST} grains or more"
        )
    return found


def _decay(run: Trajectory) -> tuple[float | None, str]:
    """Return the power with which the peak velocity of a front falls with depth, and of which wave."""
    chain = run.scene.chain
    given = run.scene.excitation
    alike = (
        chain.grains > 1
        and np.ptp(chain.masses) < 1e-9 * chain.masses[0]
        and np.ptp(chain.contact_constants) < 1e-9 * chain.contact_constants[0]
    )
    if not alike or not given.strike_velocity:
        return None, ""
    if not chain.compressed:
        return 0.0, "solitary wave of the sonic vacuum"
    if chain.gravity == 0:
        return 1 / 3, "weak wave far from the strike"
    if given.strikes_top and chain.top == "free" and chain.top_load == 0:
        return decay(chain.exponent)[0], "weak wave deep in the column"
    return None, ""


def spectra(run: Trajectory) -> Panel:
    """Draw the velocity spectra."""
    run = moving_part(run)
    found = spectrum.spectrum(run)
    ax = found.plot(_axes())
    first, last = moving(run)
    ax.set_ylim(last + 0.5, first - 0.5)
    where = np.unravel_index(found.amplitude.argmax(), found.amplitude.shape)
    said = (
        f"Velocity spectrum of every grain, strongest at {si(found.frequency[where[0]], 'Hz', 1)}."
    )
    return _panel(
        ax,
        f"{said} The line is the local cut-off frequency." if found.cut_off.any() else said,
        map=True,
    )


def forces(run: Trajectory) -> Panel:
    """Draw the contact forces above those at rest."""
    run = moving_part(run)
    history = contact.contacts(run)
    ax = history.plot(_axes(), above_rest=True)
    first, last = moving(run)
    many = len(history.contact) > contact.LINES
    if many:
        ax.set_ylim(last + 0.5, first - 0.5)
    openings = sum(event.opens for event in history.events())
    c = np.abs(history.change).max(0)
    most = f"at most {si(c.max(), 'N', 1)}, in contact {history.contact[c.argmax()]}"
    said = f"Force of every contact above that at rest, {most}."
    opened = (
        "No contact opens."
        if not openings
        else f"Contacts open {openings} time{'s' if openings > 1 else ''}."
    )
    return _panel(ax, f"{said} {opened}", map=many)


def balance(run: Trajectory) -> Panel:
    """Draw the energy ledger."""
    ledger = energy.ledger(run)
    largest = np.abs(ledger.total).max() or 1.0
    said = (
        "Energy relative to rest. Drift: change not explained by work done on the chain, at most "
        f"{np.abs(ledger.drift).max() / largest:.1e} of the largest energy, {si(largest, 'J', 1)}."
    )
    return _panel(ledger.plot(_axes()), said)
