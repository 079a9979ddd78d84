"""Energies: solitary waves after a strike, collisions, power, and bands of wavenumber.

After Deng et al., arXiv:2002.08499 (the share depends on the exponent alone), Shen et al., Phys.
Rev. E 90, 022905 (2014) (collisions beside integrable chains), and Taghizadeh et al., Materials 14,
1815 (2021) (energy by wavenumber in chains of random masses).
"""

from typing import TYPE_CHECKING

import numpy as np
from figures import SHADES, arguments, finish, say

import lmpchain
from lmpchain import patterns
from lmpchain.measure import collision, power, solitary, wavenumbers
from lmpchain.theory import soliton
from lmpchain.util.plotting import figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LEVEL = {"diameter": 1e-3, "gravity": 0.0, "top_load": 1.0}
# Phase shifts of colliding waves do not depend on the load. With this load the fastest waves press
# a contact by less than a hundredth of the diameter, where Hertz's law is valid.
LIGHT = LEVEL | {"top_load": 0.1}
# Number of grains in which the waves separate, by exponent.
LENGTHS = {
    1.1: 900,
    1.15: 500,
    1.2: 300,
    1.3: 200,
    1.5: 120,
    1.75: 120,
    2.0: 120,
    2.5: 120,
    3.0: 120,
}


def strike(delta: float, velocity: float) -> solitary.Train:
    """Return the solitary waves after a strike of one bead, m/s, on equal beads."""
    grains = LENGTHS[delta]
    mass = 1e-6
    # Overlaps are some micrometres for every exponent.
    constant = mass * 0.01 / 1e-6 ** (delta + 1)
    row = lmpchain.Chain(
        grains=grains,
        diameter=1e-3,
        gravity=0.0,
        bottom="free",
        exponent=delta,
        masses=[mass] * grains,
        contact_constants=[constant] * (grains - 1),
    )
    unit = (mass / constant) ** (1 / (1 + delta))
    duration = 0.93 * grains * unit / float(soliton.nesterenko_speed(0.68 * velocity, delta))
    impulse = lmpchain.Impulse(velocity=velocity)
    scene = lmpchain.Scene(chain=row, excitation=impulse, duration=duration, samples=10 * grains)
    return solitary.find(lmpchain.simulate(scene, "native", 1e-6))


def draw_shares(ax: "Axes", quick: bool) -> None:
    """Draw the share of the energy outside the first wave against the exponent."""
    exponents = [delta for delta in LENGTHS if delta >= (1.3 if quick else 1)]
    for velocity, marker, size in ((0.1, "o", 8), (0.01, "x", 5)):
        trains = [strike(delta, velocity) for delta in exponents]
        share = np.array([train.share[0] for train in trains])
        error = np.array([train.share_error[0] for train in trains])
        label = f"struck at {velocity:g} m/s"
        style = {"ls": "none", "marker": marker, "ms": size, "mfc": "none"} | {
            "color": SHADES[velocity < 0.1]
        }
        ax.errorbar(exponents, 1 - share, error, label=label, **style)
        for delta, value in zip(exponents, share, strict=True):
            say(f"share at {delta:g}, {velocity:g} m/s", float(value))
    ax.axhline(1 - 0.99366104, color="k", lw=0.8, ls="--", label="independent runs, 1.5 and 2")
    ax.axhline(1 - 0.99845214, color="k", lw=0.8, ls="--")
    ax.set(yscale="log", xlabel="exponent of the contact force", ylabel="1 − share of the energy")
    ax.set_title("Not in the solitary wave of a strike")
    ax.legend()


def head_on(speed: float, grains: int) -> collision.Collision:
    """Simulate a collision of two equal waves under a load."""
    chain = lmpchain.Chain(grains=grains, **LIGHT)
    wave = soliton.solve(speed=speed)
    pair = wave.on(chain, grains // 4) + wave.on(chain, 3 * grains // 4, downward=False)
    return _meet(chain, pair, grains / 2 / speed)


def overtake(fast: float, slow: float, grains: int, gap: int) -> collision.Collision:
    """Simulate a wave that overtakes another one under a load."""
    chain = lmpchain.Chain(grains=grains, **LIGHT)
    pair = soliton.solve(speed=fast).on(chain, 40) + soliton.solve(speed=slow).on(chain, 40 + gap)
    return _meet(chain, pair, (grains - 80) / fast)


def _meet(chain: lmpchain.Chain, pair: lmpchain.Profile, steps: float) -> collision.Collision:
    duration = steps * chain.time_scale
    samples = 8 * chain.grains
    scene = lmpchain.Scene(chain=chain, excitation=pair, duration=duration, samples=samples)
    return collision.find(lmpchain.simulate(scene, "native", 1e-8))


def draw_shifts(ax: "Axes", quick: bool) -> None:
    """Draw phase shifts relative to integrable chains against the speed."""
    pairs = ((1.2, 300), (1.1, 400), (1.05, 800), (1.025, 1600), (1.0125, 3000))
    runs = [(speed - 1, head_on(speed, grains)) for speed, grains in pairs[: 3 if quick else 5]]
    _plot_ratio(ax, runs, 0, "toda", "head-on, equal", SHADES[0], "o")
    say("head-on at 1.05, shift", float(runs[2][1].shift[0]))
    triples = ((1.4, 1.1, 400, 17), (1.2, 1.05, 850, 23), (1.1, 1.025, 2100, 33))
    chosen = triples[: 2 if quick else 3]
    runs = [(fast - 1, overtake(fast, *others)) for fast, *others in chosen]
    _plot_ratio(ax, runs, 0, "toda", "overtaking", SHADES[5], "^")
    _plot_ratio(ax, runs, 1, "toda", "overtaken", SHADES[1], "s")
    _plot_ratio(ax, runs, 0, "kdv", "overtaking, KdV", SHADES[2], "^")
    ax.axhline(0, color="k", lw=0.8)
    ax.set(xscale="log", xlabel="speed over that of sound, less 1 (of the faster wave)")
    ax.set_xticks([0.0125, 0.025, 0.05, 0.1, 0.2, 0.4])
    ax.xaxis.set(major_formatter="{x:g}", minor_formatter="")
    ax.set(ylabel="shift over the law, less 1")
    ax.set_title("Shifts beside Toda's law and KdV")
    ax.legend()


def _plot_ratio(
    ax: "Axes",
    runs: list[tuple[float, collision.Collision]],
    wave: int,
    law: str,
    name: str,
    colour: str,
    marker: str,
) -> None:
    excess = [speed for speed, _ in runs]
    laws = np.array([getattr(met, law)[wave] for _, met in runs])
    ratio = np.array([met.shift[wave] for _, met in runs]) / laws
    error = np.array([met.shift_error[wave] for _, met in runs]) / np.abs(laws)
    ax.errorbar(excess, ratio - 1, error, color=colour, marker=marker, mfc="none", lw=1, label=name)
    say(f"{name}, weakest", float(ratio[-1] - 1))


def draw_power(ax: "Axes", quick: bool) -> None:
    """Draw the fraction of the input power behind an impurity against the force amplitude."""
    impurity = [{"grain": 30, "diameter": 1.6e-3}]
    chain = lmpchain.Chain(grains=60, bottom="wall", impurity=impurity, **LEVEL)
    endless = patterns.absorbing(chain, bottom=60, top=60)
    strengths = np.geomspace(1e-3, 0.5, 4 if quick else 9)
    for phase, colour in ((0.08, SHADES[0]), (0.15, SHADES[1]), (0.22, SHADES[5])):
        frequency = phase / chain.time_scale
        answers = []
        for strength in strengths:
            push = lmpchain.Force(grain=80, amplitude=strength, frequency=frequency)
            duration = 150 / frequency
            scene = lmpchain.Scene(
                chain=endless, excitation=push, duration=duration, samples=3001, grains="80:101"
            )
            answers.append(power.through(lmpchain.simulate(scene, "native", 1e-4), 100))
        shares = np.array([answer.share for answer in answers])
        errors = np.array([answer.share_error for answer in answers])
        label = f"{frequency / 1e3:.0f} kHz"
        ax.errorbar(
            strengths, 100 * shares, 100 * errors, marker="o", ms=3, lw=1, color=colour, label=label
        )
        ax.axhline(100 * answers[0].linear_share, color=colour, ls="--", lw=0.8)
        off = shares[0] / answers[0].linear_share - 1
        say(f"weakest force at {label} off linear theory", float(off))
        say(f"share at {label}, strongest over weakest", float(shares[-1] / shares[0]))
    ax.set(
        xscale="log", xlabel="amplitude of the force over the load", ylabel="% of the input power"
    )
    ax.set_title("Power behind an impurity, linear dashed")
    ax.legend()


def draw_bands(ax: "Axes", quick: bool) -> None:
    """Draw the mean energy by wavenumber against distance in chains of random masses."""
    grains = 600
    edges = np.pi * np.array([0, 0.1, 0.2, 0.4, 1])
    sums = []
    for seed in range(3 if quick else 12):
        masses = np.exp(np.random.default_rng(seed).normal(0, 0.5, grains)) * 1e-6
        constants = [1e9] * (grains - 1)
        chain = lmpchain.Chain(
            grains=grains, masses=masses, contact_constants=constants, bottom="wall", **LEVEL
        )
        strike = lmpchain.Impulse(velocity=1e-8)
        time = float(np.sqrt(np.mean(masses) / np.median(chain.linear_stiffness)))
        scene = lmpchain.Scene(chain=chain, excitation=strike, duration=500 * time, samples=3)
        split = wavenumbers.bands(lmpchain.simulate(scene, "modes"), edges, 40)
        sums.append(split.energy[-1] / scene.energy / (split.width / 2))
        drift = abs(float(split.total[-1] / scene.energy) - 1)
    say("bands, sum over the energy less 1", drift)
    mean = np.mean(sums, axis=0)
    error = np.std(sums, axis=0) / np.sqrt(len(sums))
    for band, colour in enumerate((SHADES[0], SHADES[2], SHADES[1], SHADES[5])):
        label = f"{edges[band] / np.pi:.1f} to {edges[band + 1] / np.pi:.1f} π"
        ax.plot(split.place, mean[:, band], color=colour, label=label)
        low, high = (np.maximum(mean[:, band] + s * error[:, band], 1e-9) for s in (-1, 1))
        ax.fill_between(split.place, low, high, color=colour, alpha=0.25, lw=0)
    first, last = mean[:4].sum(0), mean[(split.place > 300) & (split.place < 480)].sum(0)
    say("long waves, share of the energy at grains 300 to 480", float(last[0] / last.sum()))
    say("long waves, share of the energy next to the strike", float(first[0] / first.sum()))
    ax.set(yscale="log", ylim=(1e-7, 0.1), xlabel="grain", ylabel="share of the energy a grain")
    ax.set_title("Random masses, by wavenumber")
    ax.legend()


def main() -> None:
    """Draw all four panels."""
    given = arguments(__file__, __doc__)
    picture = figure(7.5, 7)
    axes = picture.subplots(2, 2)
    for draw, ax in zip((draw_shares, draw_shifts, draw_power, draw_bands), axes.flat, strict=True):
        draw(ax, given.quick)
    finish(picture, given.output)


if __name__ == "__main__":
    main()
