"""Time averages of beads between walls, compared with the microcanonical ensemble.

After Przedborski, Sen and Harroun, Phys. Rev. E 95, 032903 (2017), arXiv:1605.08970: the kinetic
energy of Hertzian beads that only just touch fluctuates as that of an ensemble of constant energy.
"""

import warnings
from typing import TYPE_CHECKING

import numpy as np
from figures import SHADES, arguments, finish, say
from scipy import stats

import lmpchain
from lmpchain.util.plotting import figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes

NAME = "kinetic_energy"


def beads(grains: int, seed: int) -> lmpchain.Scene:
    """Return steel beads between walls with a random strike of 1 m/s in total."""
    level = {"gravity": 0.0, "top": "wall", "bottom": "wall"}
    chain = lmpchain.Chain(grains=grains, material="steel", diameter=6e-3, **level)
    speeds = np.random.default_rng(seed).normal(size=grains)
    speeds[chain.movable :] = 0.0
    strike = lmpchain.Profile(
        displacement=np.zeros(grains), velocity=speeds / np.linalg.norm(speeds)
    )
    return lmpchain.Scene(chain=chain, excitation=strike, duration=0.1)


def ensemble(grains: int) -> stats.rv_continuous:
    """Return the microcanonical distribution of the kinetic energy over the total energy."""
    return stats.beta(grains / 2, grains / 2.5)


def average(scene: lmpchain.Scene, name: str, time: float) -> lmpchain.Averages:
    """Return the average over a time, s, without warnings about intervals."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return lmpchain.averages(scene, [name], time=time, tolerance=6e-4)


def draw_time(ax: "Axes", quick: bool) -> None:
    """Draw the convergence of the mean and variance of 38 beads to the ensemble values."""
    exact = ensemble(38)
    scene = beads(38, 1)
    times = np.array([0.1, 0.3, 1.0] if quick else [0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0])
    found = [average(scene, NAME, time) for time in times]
    rows = (
        ("mean", exact.mean(), scene.energy, SHADES[0], "o", 0.97),
        ("variance", exact.var(), scene.energy**2, SHADES[5], "s", 1.03),
    )
    for name, value, unit, colour, marker, aside in rows:
        prefix = "" if name == "mean" else "variance_"
        got = np.array([getattr(one, name)[NAME] for one in found]) / unit / value - 1
        ends = np.array([getattr(one, prefix + "interval")[NAME] for one in found]) / unit / value
        style = {"ls": "none", "marker": marker, "mfc": "none", "color": colour, "capsize": 3}
        half = (ends[:, 1] - ends[:, 0]) / 2
        known = np.isfinite(half)
        ax.errorbar((times * aside)[known], got[known], half[known], label=name, **style)
        say(f"{name} off the ensemble after the longest time", float(got[-1]))
        say(f"its interval, {name}, half", float(half[-1]))
    ax.axhline(0, color="k", lw=0.8, ls="--", label="microcanonical ensemble")
    ax.set(xscale="log", xlabel="time (s)", ylabel="over that of the ensemble, less 1")
    ax.set_yscale("symlog", linthresh=1e-3)
    ax.set_ylim(-0.1, 10)
    ax.set_title("Kinetic energy of 38 beads")
    ax.legend()


def draw_sizes(ax: "Axes", quick: bool) -> None:
    """Draw the variance against the number of beads with the law of the ensemble."""
    sizes = np.array([5, 10, 20] if quick else [3, 5, 8, 12, 20, 38, 80])
    got = []
    for size in sizes:
        scene = beads(size, 2)
        one = average(scene, NAME, 0.5 if quick else 5.0)
        low, high = one.variance_interval[NAME]
        got.append((one.variance[NAME] / scene.energy**2, (high - low) / 2 / scene.energy**2))
    value, half = np.transpose(got)
    line = np.geomspace(sizes[0], sizes[-1], 100)
    laws = [ensemble(size).var() for size in line]
    ax.plot(line, laws, "k--", lw=1.2, label="Beta's distribution")
    style = {"ls": "none", "marker": "o", "mfc": "none", "color": SHADES[0], "capsize": 3}
    ax.errorbar(sizes, value, half, label="chain", **style)
    exact = np.array([ensemble(size).var() for size in sizes])
    worst = float(np.max(np.abs(value - exact) / half))
    say("variance off the ensemble, largest in half intervals", worst)
    ax.set(xscale="log", yscale="log")
    ax.set_xticks(sizes, [f"{size}" for size in sizes])
    ax.xaxis.set_minor_formatter("")
    ax.set(xlabel="beads", ylabel="variance of K / E")
    ax.set_title("Fluctuations of the kinetic energy")
    ax.legend()


def draw_coverage(one: "Axes", all_of_them: "Axes", quick: bool) -> None:
    """Draw intervals of single beads in chains of 24, and the fraction with the exact value."""
    trials = 60 if quick else 1000
    ends = []
    for seed in range(trials):
        scene = beads(24, seed)
        known = 5 / 9 * scene.energy / 24
        ends.append(np.array(average(scene, f"{NAME}:3", 0.1).interval[f"{NAME}:3"]) / known)
    low, high = np.transpose(ends)
    covers = (low < 1) & (high > 1)
    for number in range(min(trials, 100)):
        colour = SHADES[0] if covers[number] else SHADES[5]
        one.plot([number + 1] * 2, (low[number], high[number]), color=colour, lw=1.4)
    one.plot([], [], color=SHADES[0], label="covers")
    one.plot([], [], color=SHADES[5], label="does not")
    one.axhline(1, color="k", lw=0.8, ls="--", label="exact mean")
    one.set(ylim=(0.85, 1.25), xlabel="trial", ylabel="energy of bead 3 over the exact mean")
    one.set_title("The first hundred intervals of 95 %")
    one.legend(ncols=2, loc="upper right")
    count = np.arange(1, trials + 1)
    share = 100 * np.cumsum(covers) / count
    least, most = (100 * stats.binom.ppf(p, count, 0.95) / count for p in (0.025, 0.975))
    all_of_them.fill_between(count, least, most, color="0.85", lw=0, label="chance, 95 %")
    all_of_them.plot(count, share, color=SHADES[0], lw=1.4, label="intervals that cover")
    all_of_them.axhline(95, color="k", lw=0.8, ls="--")
    all_of_them.set(xlim=(1, trials), ylim=(85, 100), xlabel="trials", ylabel="covering (%)")
    all_of_them.set_title("How many cover")
    all_of_them.legend(loc="lower right")
    say("intervals that cover", float(share[-1]), "%")


def main() -> None:
    """Draw the four panels."""
    given = arguments(__file__, __doc__)
    picture = figure(7.5, 6.5)
    axes = picture.subplots(2, 2)
    draw_time(axes[0, 0], given.quick)
    draw_sizes(axes[0, 1], given.quick)
    draw_coverage(*axes[1], given.quick)
    finish(picture, given.output)


if __name__ == "__main__":
    main()
