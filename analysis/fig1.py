"""Fig. 1 of the paper: a strike of 8.57 mm/s on 120 glass beads, a pulse some two grains wide.

Left: velocities at three times; circles are LAMMPS, lines the native engine. The theory is that of
the pulse in an unloaded chain (Nesterenko), with the height of the run. Right: how far every
contact is squeezed or stretched, in units of its overlap at rest. "10 times" more than linear
theory allows holds near contact 4 only; and the contacts 1, 2 and 3 open, for which Eq. (1) needs a
bracket that forbids tension.
"""

import numpy as np
from figures import (
    HERE,
    LAMMPS,
    SHADES,
    THEORY,
    apart,
    arguments,
    finish,
    legends,
    page,
    say,
    shorter,
    summit,
)

import lmpchain

# Times, s: the ends of the paper's interval, and the highest peak between them.
MOMENTS = (
    88.4e-6,
    89.8e-6,
    91.8e-6,
)


def main() -> None:
    """Run the scene in both engines and draw it."""
    given = arguments(__file__, __doc__)
    scene = lmpchain.Scene.from_toml(HERE / "scenes" / "fig1.toml")
    if given.quick:
        scene = shorter(scene, 50)
    native = lmpchain.simulate(scene, "native", tolerance=1e-8)
    lammps = lmpchain.simulate(scene, "lammps", tolerance=1e-5 if given.quick else 1e-6)
    unit = 1e3
    strike = scene.excitation.velocity

    picture, ((wave, below), (ratio, opened)) = page(2)
    for moment, shade in zip(MOMENTS, SHADES, strict=False):
        row = int(np.abs(native.time - moment).argmin())
        v, label = native.velocity[row], f"{native.time[row] * 1e6:.1f} µs"
        wave.plot(
            native.grains,
            v * unit,
            color=shade,
            lw=1.2,
            label=f"native, {label}",
        )
        wave.plot(lammps.grains, lammps.velocity[row] * unit, **LAMMPS | {"color": shade})
        apart(
            below, lammps.grains, lammps.velocity[row], v, strike, color=shade, marker="o", lw=0.8
        )
        say(f"pulse at {label}", summit(v), f"grains, highest {v.max() * unit:.3g} mm/s")
        if moment == MOMENTS[1]:
            angle = np.linspace(-np.pi / 2, np.pi / 2, 101)
            x = angle / np.sqrt(0.4)
            shape = v.max() * np.cos(angle) ** 4
            wave.plot(summit(v) + x, shape * unit, ls=":", **THEORY, label="Nesterenko, 89.8 µs")
    wave.plot([], [], **LAMMPS | {"color": "0.4"}, label="LAMMPS")
    difference = np.abs(lammps.velocity - native.velocity).max() / strike
    expected = native.error_estimate.total + lammps.error_estimate.total
    below.axhline(
        expected,
        color="0.4",
        ls="--",
        lw=1,
        label=f"expected: {expected:.0e}; measured {difference:.0e}",
    )
    wave.set(ylabel="velocity downward (mm/s)", xlim=(20, 30), ylim=(-0.6, 8.5))
    below.set(xlabel="grain, from the top", ylabel="|LAMMPS − native| / $v_0$")

    squeezed = -np.diff(native.displacement, axis=1) / scene.chain.equilibrium_overlap
    contact = np.arange(1, scene.chain.grains)
    largest = np.abs(squeezed).max(0)
    least = squeezed.min(0)
    label = f"largest |Δφ| / ε: {largest[0]:.0f} at contact 1, {largest[24]:.1f} at 25"
    ratio.semilogy(contact, largest, color=SHADES[0], marker="s", ms=3, lw=1, label=label)
    ratio.axhline(10, color="0.5", ls="--", lw=1, label='the paper: "by 10 times"')
    ratio.axhline(1, color="0.5", ls=":", lw=1.3, label="1: its criterion")
    ratio.set(ylabel="|Δφ| / overlap at rest, over 100 µs", ylim=(0.05, 100))
    opened.set_yscale("symlog", linthresh=1)
    count = int((least < -1).sum())
    opened.plot(
        contact, least, color=SHADES[5], marker="o", ms=3, lw=1, label=f"contacts 1 to {count} open"
    )
    opened.axhline(-1, color="0.5", ls=":", lw=1.3)
    opened.set(
        xlabel="contact, from the top",
        ylabel="least Δφ / ε",
        xlim=(0, 40),
        ylim=(-60, 0.4),
    )
    say("largest ratio at contact 1", largest[0])
    say("largest ratio at contact 25", largest[24])
    say("contacts that open", count)
    say("LAMMPS and native differ by", difference, "of the strike")
    legends(picture)
    finish(picture, given.output)


if __name__ == "__main__":
    main()
