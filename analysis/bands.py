"""Bands of a precompressed dimer: branches, response to a strike, and the mode at its end.

Heavy and light beads in turn have an acoustic and an optical branch with a gap between. A strike
fills both branches; a chain that ends with a light bead has a mode in the gap, which lives at that
end.
"""

import numpy as np
from figures import SHADES, arguments, finish, one_above_two, say

import lmpchain
from lmpchain.chain.patterns import periodic
from lmpchain.measure.spectrum import dispersion
from lmpchain.theory.bands import Cell, branches, gap_modes

KILO = 1e3 * 2 * np.pi


def dimer(grains: int, **rest: str) -> lmpchain.Chain:
    """Return a chain of steel beads, every second one hollow with a third of the mass."""
    heavy = lmpchain.Chain(
        grains=2, diameter=1e-2, material="steel", gravity=0.0, top_load=20.0
    ).masses[0]
    masses = np.resize([heavy / 3, heavy], grains)
    return periodic(grains, 1e-2, "steel", gravity=0.0, top_load=20.0, masses=masses, **rest)


def main() -> None:
    """Draw branches over a measured spectrum, the density of states, and the mode in the gap."""
    given = arguments(__file__, __doc__)
    grains, tau = (120, 100) if given.quick else (320, 300)
    chain = dimer(grains)
    unit = chain.time_scale
    picture, waves, states, surface = one_above_two()
    cell = Cell(chain.masses[:2], chain.linear_stiffness[:2])
    q = np.linspace(0, np.pi, 400)
    bands = branches(cell, q)

    strike = lmpchain.Impulse(velocity=5e-7 * chain.length_scale / unit, grain=grains // 2 + 1)
    scene = lmpchain.Scene(chain=chain, excitation=strike, duration=tau * unit, samples=4 * tau + 1)
    found = dispersion(lmpchain.simulate(scene, "modes"), 1, grains)
    level = 20 * np.log10(np.maximum(found.amplitude / found.amplitude.max(), 1e-4))
    image = waves.pcolormesh(
        found.wavenumber / np.pi, found.frequency / 1e3, level, cmap="Greys", vmin=-50, vmax=0
    )
    image.set_rasterized(True)
    picture.colorbar(image, ax=waves, label="velocity (dB)")
    for number, (name, colour) in enumerate((("acoustic", SHADES[0]), ("optical", SHADES[5]))):
        waves.plot(
            found.wavenumber / np.pi,
            found.relation[1, number] / 1e3,
            "--",
            lw=1.2,
            color=colour,
            label=name,
        )
        side = (found.frequency > found.relation[1, 0].max() * 1.05) == bool(number)
        ridge = found.frequency[side][found.amplitude[side].argmax(0)]
        near = (np.abs(found.wavenumber) > 0.3) & (np.abs(found.wavenumber) < 1.3)
        off = np.abs(ridge - found.relation[1, number])[near].max() / found.frequency[1]
        say(f"ridge off the {name} branch", off, "lines of frequency")
    waves.set(xlabel="wavenumber × grain spacing / π", ylabel="frequency (kHz)", xlim=(-1, 1))
    waves.set_ylim(0, 1.15 * bands.frequency.max() / KILO)
    waves.legend(
        frameon=True,
        loc="upper center",
        ncols=2,
        fontsize="small",
    )

    waves.set_title("A strike excites both branches")

    frequency = np.linspace(1e-3, 1.15, 1500) * bands.frequency.max()
    states.plot(
        bands.density_of_states(frequency) * 1e3 * 2 * np.pi / 2,
        frequency / KILO,
        color="0.2",
        lw=1.2,
    )
    states.set(
        xlabel="modes per grain and kHz",
        ylabel="frequency (kHz)",
        xlim=(0, None),
        ylim=waves.get_ylim(),
    )
    states.set_xlim(0, 8 * 1e3 * 2 * np.pi / bands.frequency.max())
    states.set_title("Density of states")
    low, high = bands.gaps[0] / KILO
    for axes in (waves, states):
        axes.axhspan(low, high, color=SHADES[1], alpha=0.15, lw=0)
    states.annotate(
        "gap", (0.9, (low + high) / 2), xycoords=("axes fraction", "data"), ha="right", va="center"
    )
    say("gap from", low, "kHz")
    say("gap to", high, "kHz")

    end = dimer(41)
    modes = gap_modes(end, cell)
    place = int(modes.participation.argmin())
    w = modes.frequency[place]
    n = np.arange(1, end.movable + 1)
    shape = modes.shape[place] / np.abs(modes.shape[place]).max()
    exact = np.sqrt(end.linear_stiffness[0] * (1 / end.masses[0] + 1 / end.masses[1]))
    say("surface mode, frequency over exact", w / exact)
    say("participation of the surface mode", modes.participation[place], "grains")
    envelope = (end.masses[0] / end.masses[1]) ** ((n - 1) // 2)
    surface.semilogy(
        n, np.abs(shape), "o", ms=4, mfc="none", color=SHADES[0], label="mode of 41 beads"
    )
    surface.semilogy(n[::2], envelope[::2], "--", lw=1, color="0.3", label="m / M per cell, exact")
    surface.set(
        xlim=(0, 24),
        ylim=(1e-6, 2),
        xlabel="grain from the light end",
        ylabel="|displacement| / largest",
    )
    surface.set_title(f"Surface mode in the gap, {w / KILO:.1f} kHz")
    surface.legend()
    finish(picture, given.output)


if __name__ == "__main__":
    main()
