"""Pictures of a page, each with a caption."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from io import BytesIO
from typing import NamedTuple

import numpy as np

from ..measure import contact, energy, spectrum
from ..measure.fit.column import is_uniform
from ..theory.front import decay
from ..trajectory.trajectory import Trajectory
from ..util.plotting import COLOURS, Axes, axes_in_units, figure, legend, letter_panels, si
from .live import crop, extent
from .verdicts import departure, front_below, linear_theory

# Fractions of the duration at which waveforms are drawn, and their colours.
MOMENTS = {0.25: "#E69F00", 0.5: "#0072B2", 1.0: "#009E73"}
WIDTH = 4.7  # Inches; letters are readable on a phone, and two pictures fit side by side.


class PictureLimits(NamedTuple):
    """Limits of the pictures.

    Attributes
    ----------
    markers : int
        Largest number of grains drawn as vector graphics; with more grains, a picture of pixels is
        a smaller file.
    """

    markers: int = 2000


PANEL_LIMITS = PictureLimits()


@dataclass(frozen=True)
class Panel:
    """A picture, its text, and whether it is a map, which keeps its colours in dark mode."""

    caption: str
    alt: str
    svg: str
    map: bool = False


def _panel(ax: Axes, caption: str, alt: str = "", map: bool = False) -> Panel:
    import matplotlib

    buffer = BytesIO()
    # A fixed salt makes equal runs give equal pages, byte by byte.
    with matplotlib.rc_context({"svg.hashsalt": "lmpchain"}):
        metadata = {"Date": None, "Creator": None}
        ax.figure.figure.savefig(buffer, format="svg", transparent=True, metadata=metadata, dpi=200)
    return Panel(caption, alt or caption, base64.b64encode(buffer.getvalue()).decode("ascii"), map)


def _axes() -> Axes:
    return axes_in_units(figure(WIDTH, 3.5).subplots(), "", "")


def wave(run: Trajectory) -> Panel:
    """Draw the space-time picture, for readers without the live view."""
    run = crop(run)
    first, last = extent(run)
    ax = run.plot(_axes())
    ax.set_ylim(last + 0.5, first - 0.5)
    return _panel(
        ax, f"Velocity of grains {first} to {last} over time: downward red, upward blue.", map=True
    )


def waveforms(run: Trajectory) -> Panel:
    """Draw velocity over grain number at several times, with linear theory if it applies."""
    from ..util.ticks import UnitFormatter

    run = crop(run)
    picture = figure(WIDTH, 4.4)
    rows = picture.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    # The upper axes show the motion, the lower axes its difference from linear theory.
    above, below = (axes_in_units(ax, "", "") for ax in rows)
    linear = linear_theory(run)
    largest = np.abs(run.velocity).max() or 1.0
    for moment, shade in MOMENTS.items():
        row = round(moment * (run.time.size - 1))
        label = si(run.time[row], "s")
        dense = run.grains.size > PANEL_LIMITS.markers
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
            expected = linear.velocity[row]
            above.plot(run.grains, expected, color=shade, lw=1)
            below.plot(run.grains, (run.velocity[row] - expected) / largest, color=shade, lw=1)
    first, last = extent(run)
    above.set_xlim(first - 0.5, last + 0.5)
    above.set_ylabel("velocity downward")
    above.yaxis.set_major_formatter(UnitFormatter("m/s"))
    legend(above)
    below.axhline(0, color=COLOURS["vermilion"], lw=0.8)
    below.set(xlabel="grain, from the top", ylabel="difference\n/ largest")
    end = np.abs(run.velocity[-1])
    peak = f"grain {run.grains[end.argmax()]}, {si(end.max(), 'm/s', 1)}"
    caption = f"At the end the motion is largest at {peak}. "
    if linear is None:
        # Axes without a curve are removed.
        below.remove()
        above.tick_params(labelbottom=True)
        above.set_xlabel("grain, from the top")
        return _panel(above, f"{caption}There is no linear theory of this scene.")
    error = departure(run, linear)
    letter_panels([above, below])
    return _panel(
        above,
        f"{caption}Points: this run. Lines: linear theory, Eq. (3), at most {error:.2g} of the "
        "largest velocity away (b).",
    )


def arrival(run: Trajectory) -> Panel:
    """Draw peak velocity and arrival time of the front against depth, with their power laws."""
    from matplotlib.ticker import LogLocator, StrMethodFormatter

    from ..util.ticks import UnitFormatter

    track = front_below(run)
    chain = run.scene.chain
    source = getattr(run.scene.excitation, "grain", 1)
    picture = figure(WIDTH, 4.8)
    height, time = (axes_in_units(ax, "", "") for ax in picture.subplots(2, 1))
    depth, values, _ = track.against_depth("amplitude")
    height.plot(depth, values, ".", ms=4, label="this run")
    power, name = _decay(run)
    if power is not None:
        # The curve passes through the deepest point, because the law holds far from the strike.
        law = values[-1] * (depth / depth[-1]) ** -power
        label = f"{name}: power -{power:.3g}" if power else f"{name}: constant"
        height.plot(depth, law, "--", lw=1, label=label)
    height.set(xscale="log", yscale="log")
    height.set(xlabel="depth h = n − 1/2 (grains)", ylabel="peak velocity")
    # Depths are numbers of grains, and are labelled "0.5" and not "500 m".
    for axis, form in (
        (height.xaxis, StrMethodFormatter("{x:g}")),
        (height.yaxis, UnitFormatter("m/s")),
    ):
        axis.set(
            major_locator=LogLocator(subs=(1, 2, 3, 5)), major_formatter=form, minor_formatter=""
        )
    # The legend needs room below the curve, which falls.
    height.set_ylim(bottom=0.7 * height.get_ylim()[0])
    legend(height, loc="lower left")
    time.plot(track.grain, 1e6 * track.time, ".", ms=4, label="this run")
    if chain.linearisable and chain.ground is None:
        expected = spectrum.travel_time(chain, max(1, source))[track.grain - 1]
        time.plot(track.grain, 1e6 * expected, "--", lw=1, label="long weak wave")
    time.set(xlabel="grain, from the top", ylabel="arrival (µs)")
    legend(time)
    letter_panels([height, time])
    first, last = (f"{si(values[k], 'm/s', 1)} at grain {track.grain[k]}" for k in (0, -1))
    law = "No law is known for this chain." if power is None else f"Dashed: {name}."
    return _panel(
        height,
        f"The front passes {track.grain.size} grains; its peak goes from {first} to {last}. {law}",
    )


def _decay(run: Trajectory) -> tuple[float | None, str]:
    """Return the exponent with which the peak velocity decreases with depth, and the wave type."""
    chain = run.scene.chain
    excitation = run.scene.excitation
    single = chain.grains == 1 or not is_uniform(chain)
    if single or not run.scene.strike_velocity or chain.law.power is None:
        return None, ""
    # A strike on an uncompressed chain splits into solitary waves of constant height.
    if not chain.compressed:
        return 0.0, "solitary wave of the sonic vacuum"
    if chain.loose_grains:
        return None, ""
    if chain.gravity == 0:
        return 1 / 3, "weak wave far from the strike"
    if excitation.strikes_top and chain.top == "free" and chain.top_load == 0:
        return decay(chain.law.power)[0], "weak wave deep in the column"
    return None, ""


def spectra(run: Trajectory) -> Panel:
    """Draw the velocity spectra."""
    run = crop(run)
    result = spectrum.spectrum(run)
    ax = result.plot(_axes())
    ax.locator_params(axis="x", nbins=4)
    first, last = extent(run)
    ax.set_ylim(last + 0.5, first - 0.5)
    # A lasting displacement appears at 0 Hz, which is ignored because it is not an oscillation.
    heard = np.where(result.frequency[:, None] > 0, result.amplitude, 0.0)
    row = np.unravel_index(heard.argmax(), heard.shape)[0]
    strongest = si(result.frequency[row], "Hz", 1)
    caption = f"Velocity spectrum of every grain, strongest at {strongest}."
    if result.cut_off.any():
        caption += " The line is the local cut-off frequency."
    return _panel(ax, caption, map=True)


def dispersion(run: Trajectory) -> Panel:
    """Draw the spectrum over wavenumber and frequency of the grains that move."""
    first, last = extent(crop(run))
    result = spectrum.dispersion(run, first, last)
    caption = f"Spectrum of grains {first} to {last} over wavenumber; waves downward on the right."
    if result.relation.any():
        caption += " Lines: dispersion relation of weak waves at the first, middle and last grain."
    return _panel(result.plot(_axes()), caption, map=True)


def forces(run: Trajectory) -> Panel:
    """Draw the contact forces above those at rest."""
    run = crop(run)
    history = contact.contacts(run)
    ax = history.plot(_axes(), above_rest=True)
    first, last = extent(run)
    # Many contacts are drawn as a map over depth, few as lines.
    many = len(history.contact) > contact.LINES
    if many:
        ax.set_ylim(last + 0.5, first - 0.5)
    openings = sum(event.opens for event in history.events())
    change = np.abs(history.change).max(0)
    largest = f"{si(change.max(), 'N', 1)}, in {_name(run, int(history.contact[change.argmax()]))}"
    times = f"{openings} time{'s' if openings > 1 else ''}"
    opened = f"Contacts open {times}." if openings else "No contact opens."
    return _panel(
        ax, f"Force of every contact above that at rest, at most {largest}. {opened}", map=many
    )


def _name(run: Trajectory, contact: int) -> str:
    """Return the name of a contact; the first and last one may touch a wall."""
    if contact == 0:
        return "the contact with the top wall"
    return f"contact {contact}" if contact < run.scene.chain.grains else "the bottom wall"


def balance(run: Trajectory) -> Panel:
    """Draw the energy ledger."""
    ledger = energy.ledger(run)
    largest = np.abs(ledger.total).max() or 1.0
    drift = np.abs(ledger.drift).max() / largest
    return _panel(
        ledger.plot(_axes()),
        "Energy relative to rest. Drift: change not explained by work done on the chain, at most "
        f"{drift:.1e} of the largest energy, {si(largest, 'J', 1)}.",
    )
