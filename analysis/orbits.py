"""Breathers in the gap of a dimer: family, shape, and loss of stability.

The lowest optical mode of a dimer between walls softens with its energy, leaves its band and
becomes a breather, as narrow as it is strong. Floquet multipliers on the unit circle say that it is
stable.
"""

import numpy as np
from figures import SHADES, arguments, finish, one_above_two, say

import lmpchain
from lmpchain import orbits


def dimer(grains: int) -> lmpchain.Chain:
    """Return a chain of masses 3 : 1 between walls, with heavy grains at both ends."""
    masses = np.where(np.arange(grains) % 2 == 0, 3e-3, 1e-3)
    return lmpchain.Chain(
        grains=grains,
        diameter=1e-2,
        gravity=0.0,
        top_load=20.0,
        top="wall",
        bottom="wall",
        masses=masses,
    )


def main() -> None:
    """Continue the breather through the gap; draw its family, shapes and multipliers."""
    given = arguments(__file__, __doc__)
    grains = 43
    chain = dimer(grains)
    u, period = orbits.linear_mode(chain, (grains + 1) // 2 + 1, 0.7)
    local = u * np.exp(-(((np.arange(grains) - grains // 2) / 8) ** 2))
    breather = orbits.find(chain, (local, 0 * local), period, energy=2.4e-4)
    say("residual of the breather", breather.residual)
    most = 1.1 if given.quick else 1.35
    near = orbits.follow(breather, "period", (1.01 if given.quick else 1.0005) * period)
    far = []
    here = breather
    # Short pieces rarely have two events that cancel within one step.
    for longer in np.geomspace(breather.period, most * period, 2 if given.quick else 41)[1:]:
        far.append(orbits.follow(here, "period", longer))
        here = far[-1][-1]
    both = near.backwards().join(*far)
    say("events", len(both.events))
    say("orbits followed", len(both))
    inside = np.flatnonzero(both.period > breather.period)
    least = int(inside[both.energy[inside].argmin()])
    say("least energy of a narrow one", 1e6 * both.energy[least], "µJ")
    say("period there over that of the linear mode", both.period[least] / period)

    picture, family, shape, growth = one_above_two()
    frequency = 1 / both.period
    family.semilogy(frequency, both.energy, color=SHADES[0], lw=2, label="stable")
    unstable = np.where(both.stable, np.nan, both.energy)
    family.semilogy(frequency, unstable, "o-", ms=4, lw=4, color=SHADES[3], label="unstable")
    family.axvline(1 / period, color="0.75", label="linear mode")
    family.xaxis.set_major_formatter(lambda x, _: f"{1e-3 * x:g}")
    family.yaxis.set_major_formatter(lambda y, _: f"{1e6 * y:g}")
    family.set_yticks([5e-5, 1e-4, 2e-4, 5e-4])
    family.yaxis.set_minor_formatter("")
    family.set_xlabel("frequency (kHz)")
    family.set_ylabel("energy above rest (µJ)")
    family.legend(loc="lower left")
    family.set_title("Energy against frequency")
    chosen = [both[0], both[least], both[-1]]
    looks = ((SHADES[2], "^", 0.79), (SHADES[0], "o", 0.86), (SHADES[5], "s", 0.93))
    for orbit, (colour, mark, height) in zip(chosen, looks, strict=True):
        label = f"{1e6 * orbit.energy:.3g} µJ, {1e-3 / orbit.period:.2f} kHz"
        n = np.arange(1, grains + 1)
        shape.plot(
            n, orbit.displacement * 1e6, mark + "-", ms=3.5, lw=0.8, color=colour, label=label
        )
        shape.text(0.03, height, label, transform=shape.transAxes, color=colour)
        family.plot(1 / orbit.period, orbit.energy, mark, ms=8, mfc="none", mew=1.6, color=colour)
        share = chain.masses * orbit.motion()[2].std(0) ** 2
        say(
            f"participation at {1e6 * orbit.energy:.3g} µJ",
            share.sum() ** 2 / (share**2).sum(),
            "grains",
        )
        say(f"largest multiplier at {1e6 * orbit.energy:.3g} µJ", np.abs(orbit.multipliers).max())
    shape.set(xlabel="grain", ylabel="displacement (µm)")
    shape.set_title("The orbits marked, at rest at t = 0")
    largest = [np.abs(orbit.multipliers).max() - 1 for orbit in both.orbits]
    growth.plot(1e-3 * frequency, np.maximum(largest, 0.0), ".-", color=SHADES[3])
    growth.set(xlabel="frequency (kHz)", ylabel="growth in a period, less 1", ylim=(0, None))
    growth.set_title("Largest Floquet multiplier")
    finish(picture, given.output)


if __name__ == "__main__":
    main()
