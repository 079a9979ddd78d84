"""Decay of a pulse's peak velocity with depth, from the sonic vacuum to the linear column.

A strong strike makes a solitary wave of the sonic vacuum, whose height stays until the column
presses its grains harder than the wave does; a weak one spreads linearly, and falls as h^(-4/15) at
great depth. What decides is the strength of the wave where it is: its velocity over what a contact
at rest there can hold, which falls as h^(-5/6) at least.
"""

import numpy as np
from figures import SHADES, arguments, finish, say, weak_scene

import lmpchain
from lmpchain.measure import front as measured
from lmpchain.theory import continuum, front
from lmpchain.util.plotting import figure

STRIKES = (1e-2, 1.0, 1e1, 1e2, 1e3, 1e4)
# Strike numbers.
PAPER = {
    "Fig. 5, 10 g": 1.24,
    "Fig. 5, g": 8.48,
    "Fig. 5, 0.1 g": 57.8,
    "Fig. 1": 84.8,
}
DEEPEST = 1000
PER_TAU = 40
WINDOW = 5


def strike(strength: float, depths: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return depths, local exponents of the peak velocity, and local strengths after a strike."""
    tau = 1.05 * float(front.peak_time(int(depths[-1]))) + 5
    # Strong pulses have not reached the floor.
    grains = int(continuum.depth(tau)) + int(depths[-1]) // 2
    scene = weak_scene(grains, tau, int(PER_TAU * tau) + 1, strength, recorded=depths.tolist())
    # Grains oscillate behind the front without changing it.
    engine = lmpchain.engines.Native(step=0.3 / scene.highest_frequency)
    passed = measured.track(lmpchain.simulate(scene, engine))
    fits = measured.exponent(passed, "amplitude", WINDOW)
    own = scene.chain.length_scale / scene.chain.time_scale * fits.depth ** (5 / 6)
    height = np.exp(
        np.interp(np.log(fits.depth), np.log(passed.grain - 0.5), np.log(np.abs(passed.amplitude)))
    )
    return fits.depth, fits.exponent, height / own


def main() -> None:
    """Strike a column from weakly to strongly; draw local exponents against depth and strength."""
    given = arguments(__file__, __doc__)
    deepest, strikes = (200, (1e-2, 1e2, 1e4)) if given.quick else (DEEPEST, STRIKES)
    depths = np.unique(np.geomspace(4, deepest, 48).astype(int))
    picture = figure(7.5, 4)
    over_depth, over_strength = picture.subplots(1, 2, sharey=True)
    every = [
        (f"$v_0^*$ = {x:g}", x, {"lw": 1.3, "color": SHADES[i]}) for i, x in enumerate(strikes)
    ]
    every += [
        (name, x, {"lw": 1.0, "color": "0.35", "ls": style})
        for (name, x), style in zip(PAPER.items(), (":", "-.", "--", (0, (6, 1))), strict=True)
    ]
    for label, strength, style in every:
        h, p, local = strike(strength, depths)
        over_depth.semilogx(h, p, **style)
        over_strength.semilogx(local, p, **style, label=label)
        say(f"local exponent at the deepest grains, {label.replace('$', '')}", p[-1])
        say(f"local strength there, {label.replace('$', '')}", local[-1])
    for axes in (over_depth, over_strength):
        axes.axhline(-4 / 15, color="k", lw=0.8, ls="--")
        axes.axhline(0, color="k", lw=0.8, ls=":")
    for text, level in (("solitary wave: 0", 0), ("−4/15, great depth", -4 / 15)):
        above = {"xytext": (0, 2), "textcoords": "offset points", "ha": "right", "va": "bottom"}
        over_strength.annotate(text, (0.98, level), xycoords=("axes fraction", "data"), **above)
    over_depth.set(
        xlabel="depth h = n − 1/2 (grains)",
        ylabel="exponent p of the peak velocity, $h^p$",
        ylim=(-0.285, 0.02),
    )
    over_strength.set(xlabel="local strength: peak velocity / $\\epsilon_n \\omega_n$")
    picture.legend(loc="outside lower center", ncols=5)
    finish(picture, given.output)


if __name__ == "__main__":
    main()
