"""A damped dimer driven in its gap: a fold, two stable responses, tori and period doublings.

After Pozharskiy, I. Kevrekidis and P. Kevrekidis, arXiv:2407.19347, and Hoogeboom et al., EPL 101,
44003 (2013): aluminium and steel in turn, the first one of aluminium. Beyond the fold at which
driven and surface mode meet, runs leave the periodic answers. Only the abstracts were read, which
state no numbers: kinds of bifurcations are compared, and every number here is ours alone.
"""

import numpy as np
from figures import SHADES, arguments, finish, say
from scipy.interpolate import CubicSpline

import lmpchain
from lmpchain import orbits
from lmpchain.util.plotting import figure

ALUMINIUM = lmpchain.Material(density=2700.0, youngs_modulus=73.5e9, poissons_ratio=0.33)
STEEL = lmpchain.Material(density=7800.0, youngs_modulus=200e9, poissons_ratio=0.3)
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


def smooth(family: orbits.Family) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return parameter, force and stability on a spline through the members of a family.

    The spline is a function of the length of the chords between members, and its stability changes
    at events.
    """
    curve = np.transpose([family.value, [orbit.response("force:1") for orbit in family]])
    unit = np.ptp(curve, axis=0)
    chords = np.linalg.norm(np.diff(curve / unit, axis=0), axis=1)
    kept = np.append(True, chords > 1e-6)
    along = np.append(0.0, chords).cumsum()[kept]
    fine = np.linspace(0.0, along[-1], 1000)
    drawn = CubicSpline(along, curve[kept])(fine)

    def place(point: tuple[float, float]) -> int:
        return int(np.linalg.norm((drawn - point) / unit, axis=1).argmin())

    ends = {place((event.value, event.orbit.response("force:1"))) for event in family.events}
    stable = np.empty(fine.size, dtype=bool)
    for piece in np.split(np.arange(fine.size), sorted(ends)):
        middle = fine[piece[len(piece) // 2]]
        stable[piece] = family.stable[kept][np.abs(along - middle).argmin()]
    return *drawn.T, stable


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
        value, size, stable = smooth(family)
        for chosen, style, words in ((stable, "-", "stable"), (~stable, ":", "unstable")):
            drawn = np.where(chosen, size, np.nan)
            ax.plot(1e6 * value, drawn, style, color=SHADES[5], lw=1.6, label=words)
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
