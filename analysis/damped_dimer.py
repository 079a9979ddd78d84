"""A damped dimer driven in its gap: a fold, two stable responses, tori and period doublings.

After Pozharskiy, I. Kevrekidis and P. Kevrekidis, arXiv:2407.19347, and Hoogeboom et al., EPL 101,
44003 (2013): aluminium and steel in turn, the first one of aluminium. Beyond the fold at which
driven and surface mode meet, runs leave the periodic answers. Only the abstracts were read, which
state no numbers: kinds of bifurcations are compared, and every number here is ours alone.
"""

import numpy as np
from figures import SHADES, arguments, finish, say

import lmpchain
from lmpchain import orbits
from lmpchain.util.plotting import figure

ALUMINIUM = lmpchain.Material(
    "aluminium", density=2700.0, youngs_modulus=73.5e9, poissons_ratio=0.33
)
STEEL = lmpchain.Material("steel 440C", density=7800.0, youngs_modulus=200e9, poissons_ratio=0.3)
FREQUENCIES = 6.7e3, 7.0e3  # Hz, in the gap.
STRONGEST = 1.5e-6  # Amplitude of the drive, m.
MARKS = {"fold": "o", "Neimark-Sacker": "^", "period doubling": "s"}


def chain() -> lmpchain.Chain:
    """Return 20 alternating spheres below a driven one, first of aluminium; 20 N, drag 400/s."""
    return lmpchain.Chain(
        grains=21,
        material=[STEEL, ALUMINIUM] * 10 + [STEEL],
        diameter=19.05e-3,
        gravity=0.0,
        top_load=20.0,
        bottom="wall",
        damping={"drag": 400.0},
    )


def main() -> None:
    """Continue the responses in the amplitude of the drive, and print the bifurcations."""
    given = arguments(__file__, __doc__)
    dimer = chain()
    modes = lmpchain.theory.modes.eigenmodes(dimer).frequency / (2 * np.pi)
    gap = int(np.diff(modes).argmax())
    say("gap from", modes[gap] / 1e3, "kHz")
    say("gap to", modes[gap + 1] / 1e3, "kHz")
    picture = figure(7.5, 4)
    for ax, frequency in zip(picture.subplots(1, 2), FREQUENCIES, strict=True):
        drive = lmpchain.Drive(amplitude=1e-8, frequency=frequency)
        first = orbits.find(dimer, drive=drive)
        family = orbits.follow(first, "drive.amplitude", STRONGEST)
        size = np.array([orbit.response("force:1") for orbit in family])
        # Curves interpolate between members of either branch.
        ax.plot(1e6 * family.value, size, color=SHADES[5], lw=0.5)
        for chosen, style, words in (
            (family.stable, "-", "stable"),
            (~family.stable, ":", "unstable"),
        ):
            drawn = np.where(chosen, size, np.nan)
            ax.plot(1e6 * family.value, drawn, style, color=SHADES[5], lw=1.6, label=words)
        for number, event in enumerate(family.events, 1):
            say(f"{frequency / 1e3:g} kHz, {number}, {event.kind}", 1e6 * event.value, "µm")
            force = event.orbit.response("force:1")
            mark = {"ms": 7, "mfc": "w", "color": "k", "ls": "none"}
            ax.plot(1e6 * event.value, force, MARKS[event.kind], label=event.kind, **mark)
        handles = dict(zip(*reversed(ax.get_legend_handles_labels()), strict=True))
        ax.legend(
            handles.values(),
            handles.keys(),
        )
        ax.set(xlabel="amplitude of the drive (µm)", ylabel="force below the driven sphere (N)")
        ax.set(xlim=(0, 1e6 * STRONGEST), ylim=(0, None))
        title = f"Driven at {frequency / 1e3:g} kHz, in the gap"
        ax.set_title(title)
    finish(picture, given.output)


if __name__ == "__main__":
    main()
