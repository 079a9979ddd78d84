"""Shocks: edges of dispersive shocks, steady shocks of damped chains, and rarefactions.

After Chong, Geisler, Kevrekidis and Biondini, arXiv:2402.08218 (leading amplitudes beside those of
Toda's chain and of Korteweg and de Vries), Yang, Biondini, Chong and Kevrekidis, arXiv:2411.17874,
and arXiv:2512.22913 (edges beside Whitham's equations, rarefactions).
"""

from typing import TYPE_CHECKING

import numpy as np
from figures import SHADES, arguments, finish, say

import lmpchain
from lmpchain.measure import shock
from lmpchain.theory.shock import Medium, State
from lmpchain.util.plotting import figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes

CHAIN = lmpchain.Chain(
    grains=300,
    material="steel",
    diameter=9.5e-3,
    gravity=0.0,
    top_load=10.0,
    top="wall",
    bottom="wall",
)
OVERLAP = float(CHAIN.contacts.overlap[1])
GAS = Medium(1.5, float(CHAIN.contacts.constant[1]), float(CHAIN.masses[1]))
SOUND = GAS.sound(OVERLAP)  # Grains/s.
REST = State(0.0, OVERLAP)


def push(chain: lmpchain.Chain, velocity: float, duration: float) -> shock.Shock:
    """Return the shock of a piston with this velocity, m/s."""
    piston = lmpchain.Drive(shape="piston", velocity=velocity, rise=10 / SOUND, grain=0)
    samples = 4 * chain.grains + 1
    scene = lmpchain.Scene(chain=chain, excitation=piston, duration=duration, samples=samples)
    return shock.find(lmpchain.simulate(scene, "native", 1e-6))


def draw_edges(ax: "Axes", quick: bool) -> None:
    """Draw the speeds of both edges against the jump of the overlap, with three theories."""
    chain = CHAIN.replace(grains=200 if quick else 600)
    waves = []
    for strength in (0.5, 1.0) if quick else (0.1, 0.2, 0.35, 0.5, 0.7, 1.0, 1.4):
        velocity = strength * OVERLAP * SOUND
        front = GAS.dispersive(REST, GAS.behind(REST, velocity).overlap).leading
        waves.append(push(chain, velocity, chain.grains / front))
    jumps = np.array([wave.behind.overlap / OVERLAP for wave in waves])
    for name, colour, marker in (("leading", SHADES[5], "o"), ("trailing", SHADES[0], "s")):
        edges = [getattr(wave, name) for wave in waves]
        speed = np.array([edge.speed for edge in edges]) / SOUND
        error = np.array([edge.error for edge in edges]) / SOUND
        style = {"ls": "none", "marker": marker, "mfc": "none", "color": colour}
        ax.errorbar(jumps, speed, error, label=f"{name} edge, measured", **style)
        curve = np.linspace(1.001, jumps.max() * 1.03, 20 if quick else 200)
        for law, style, theory in (
            (GAS.dispersive, "-", "Whitham"),
            (GAS.toda, "--", "Toda"),
            (GAS.kdv, ":", "Korteweg and de Vries"),
        ):
            line = [getattr(law(REST, jump * OVERLAP), name) / SOUND for jump in curve]
            label = theory if name == "leading" else None
            ax.plot(
                curve, line, style, color=colour if style == "-" else "0.4", lw=1.2, label=label
            )
        for wave, jump, value, spread in zip(waves, jumps, speed, error, strict=True):
            off = value - getattr(wave.predictions["whitham"], name) / SOUND
            say(f"{name} edge off Whitham's, in that of sound, jump {jump:.2f}", float(off))
            say(f"its error, {name} edge, jump {jump:.2f}", float(spread))
    ax.set(xlabel="overlap behind over that ahead", ylabel="speed over that of sound")
    ax.set_title("Edges of a dispersive shock")
    ax.legend()


def draw_train(ax: "Axes", quick: bool) -> None:
    """Draw a dispersive shock over place and time, with its edges."""
    chain = CHAIN.replace(grains=150 if quick else 400)
    velocity = OVERLAP * SOUND
    front = GAS.dispersive(REST, GAS.behind(REST, velocity).overlap).leading
    train = push(chain, velocity, chain.grains / front)
    say("leading wave over the piston, in velocity", train.leading.velocity / velocity)
    say("leading edge over a solitary wave as high", train.leading.speed / train.solitary)
    ratio = train.behind.overlap / train.simple.overlap
    say("plateau over that of a simple wave", ratio)
    train.plot_map(ax)
    ax.get_legend().remove()
    bar = ax.figure.axes[-1]
    bar.yaxis.set_major_formatter(lambda overlap, _: f"{1e6 * overlap:.2g}")
    bar.set_ylabel("overlap (µm)")
    ax.set_title("Dispersive shock before a piston")


def draw_steady(ax: "Axes", quick: bool) -> None:
    """Draw steady shocks of chains with viscous contacts, relative to the middle of the jump."""
    chain = CHAIN.replace(grains=200 if quick else 600)
    velocity = 0.5 * OVERLAP * SOUND
    duration = chain.grains / GAS.rankine_hugoniot(REST, velocity)[1]
    worst = 0.0
    for viscosity, colour in ((0.15, SHADES[0]), (0.3, SHADES[2]), (0.6, SHADES[1])):
        damping = lmpchain.Damping(viscoelastic=viscosity / SOUND)
        wave = push(chain.replace(damping=damping), velocity, duration)
        state, speed = wave.rankine_hugoniot
        worst = max(worst, abs(wave.leading.speed / speed - 1))
        # The time is before the shock reaches the end of the chain.
        then = wave.overlap_then[int(0.8 * len(wave.moment))]
        share = (then - wave.ahead.overlap) / (state.overlap - wave.ahead.overlap)
        middle = _middle(wave, share)
        width = wave.predictions["burgers"].height
        say(f"thickness over Burgers's, A times sound {viscosity:g}", wave.thickness / width)
        label = f"A$c_0$ = {viscosity:g} grains"
        ax.plot(wave.contact - middle, share, color=colour, lw=1.4, label=label)
        place = np.linspace(-20, 20, 400)
        # A tanh profile with this steepest slope.
        ax.plot(place, (1 - np.tanh(2 * place / width)) / 2, ":", color=colour, lw=1.2)
    say("steady shocks, speed off Rankine and Hugoniot's", worst)
    ax.axhline(1, color="k", lw=0.8, ls="--", label="Rankine and Hugoniot")
    ax.plot([], [], ":", color="0.4", label="Burgers")
    ax.set(xlim=(-20, 20), xlabel="contacts ahead of half the jump", ylabel="share of the jump")
    ax.set_title("Steady shocks of viscous chains")
    ax.legend(loc="lower left", handlelength=1.2)


def _middle(wave: shock.Shock, share: np.ndarray) -> float:
    """Return the position of half of the jump, seen from the piston."""
    order = np.argsort(wave.contact)
    place = wave.contact[order].astype(float)
    size = share[order]
    last = int(np.flatnonzero(size > 0.5)[-1])
    before, after = size[last], size[last + 1]
    return float(place[last] + (before - 0.5) / (before - after))


def draw_rarefaction(ax: "Axes", quick: bool) -> None:
    """Draw a rarefaction from a step, and the exact wave by characteristics."""
    grains = 300 if quick else 600
    start = grains // 2
    chain = CHAIN.replace(grains=grains, top="free")
    less = -0.9 * OVERLAP / 9.5e-3
    step = lmpchain.Riemann(velocity=(0, 0), strain=(less, 0), grain=start)
    duration = 0.8 * (grains - start) / SOUND
    scene = lmpchain.Scene(chain=chain, excitation=step, duration=duration, samples=4 * grains + 1)
    wave = shock.find(lmpchain.simulate(scene, "native", 1e-6))
    theory = wave.predictions["continuum"]
    for name in ("leading", "trailing"):
        edge = getattr(wave, name)
        say(f"rarefaction, {name} edge off theory", edge.speed / getattr(theory, name) - 1)
        say(f"its error, rarefaction, {name} edge", edge.error / getattr(theory, name))
    ax.plot(wave.contact, wave.overlap * 1e6, color=SHADES[0], lw=1.4, label="chain")
    overlaps = np.linspace(wave.behind.overlap, wave.ahead.overlap, 100)
    place = start + np.array([GAS.sound(one) for one in overlaps]) * wave.time
    ax.plot(place, overlaps * 1e6, "k--", lw=1.2, label="characteristics")
    for state, name in ((wave.ahead, "ahead"), (wave.behind, "behind")):
        ax.axhline(state.overlap * 1e6, color="0.6", lw=0.8, ls=":")
        say(f"rarefaction, overlap {name}", state.overlap * 1e6, "µm")
    low = 0.9 * wave.behind.overlap * 1e6
    ax.set(ylim=(low, 1.05e6 * wave.ahead.overlap))
    ax.set(xlim=(start, grains), xlabel="contact, from the top", ylabel="overlap (µm)")
    ax.set_title("A rarefaction, from a step")
    ax.legend()


def main() -> None:
    """Draw all four panels."""
    given = arguments(__file__, __doc__)
    picture = figure(7.5, 7)
    axes = picture.subplots(2, 2)
    panels = (draw_train, draw_edges, draw_steady, draw_rarefaction)
    for draw, ax in zip(panels, axes.flat, strict=True):
        draw(ax, given.quick)
    finish(picture, given.output)


if __name__ == "__main__":
    main()
