"""Solitary waves of the lattice: shape, tails and speed, exact, by engines, and for long waves.

A strike sends one through an unloaded chain; under a load they are faster than sound, and the
faster the higher. The exact ones solve the advance-delay equation of the lattice. Nesterenko's and
Coste's long waves are wider and slower.
"""

import numpy as np
from figures import LAMMPS, NATIVE, SHADES, arguments, finish, one_above_two, say

import lmpchain
from lmpchain.theory import soliton

EXACT = {"color": "0.2", "lw": 1.4}
BEADS = {"diameter": 1e-3, "material": "steel", "gravity": 0.0}


def behind_a_strike(engine: str, tolerance: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the relative velocity of grain 60 after a strike of 1 m/s, against V t in grains."""
    chain = lmpchain.Chain(grains=90, bottom="free", **BEADS)
    unit = (chain.masses[0] / chain.contact_constants[0]) ** 0.4
    strike = lmpchain.Impulse(velocity=1.0)
    scene = lmpchain.Scene(
        chain=chain, excitation=strike, duration=80 * unit, samples=801, grains=[60]
    )
    run = lmpchain.simulate(scene, engine, tolerance)
    v = run.velocity[:, 0]
    top = int(run.velocity[:, 0].argmax())
    a, b, c = v[top - 1 : top + 2]
    peak = top + 0.5 * (a - c) / (a - 2 * b + c)
    wave = soliton.solve(velocity=float(b - (a - c) ** 2 / 8 / (a - 2 * b + c)))
    x = (np.arange(v.size) - peak) * (run.time[1] / unit) * wave.speed
    near = np.abs(x) < 3
    return x[near], v[near] / float(wave.velocity(0.0))


def main() -> None:
    """Draw the shape, the tails, and the speed against the force of solitary waves."""
    given = arguments(__file__, __doc__)
    picture, shape, tails, speeds = one_above_two()
    vacuum = soliton.solve(velocity=1.0)
    x = np.linspace(-3, 3, 601)
    shape.plot(x, vacuum.velocity(x), **EXACT, label="exact")
    long = soliton.nesterenko_overlap(x, float(soliton.nesterenko_speed(1.0)))
    shape.plot(x, long / long.max(), "--", color=SHADES[1], lw=1.4, label="Nesterenko, cos$^4$")
    for engine, style, tolerance in (("native", NATIVE, 1e-9), ("lammps", LAMMPS, 1e-5)):
        place, height = behind_a_strike(engine, tolerance)
        every = slice(None, None, 3 if engine == "native" else 6)
        shape.plot(
            place[every],
            height[every],
            **style,
            label={"native": "native", "lammps": "LAMMPS"}[engine],
        )
        say(
            f"struck chain in {engine} off the exact wave",
            np.abs(height - vacuum.velocity(place)).max(),
        )
    say("width of the exact wave", vacuum.width, "grains")
    say("speed over that of Nesterenko", vacuum.speed / float(soliton.nesterenko_speed(1.0)))
    shape.set(
        xlabel="x − Vt (grains)", ylabel="velocity / largest", ylim=(-0.03, 1.35), xlim=(-3, 3)
    )
    shape.set_title("Sonic vacuum")
    shape.legend(ncols=2, loc="upper center")

    waves = [(vacuum, "sonic vacuum")] + [
        (soliton.solve(speed=c), f"loaded, {c:g} c$_0$") for c in (3.0, 1.5, 1.1)
    ]
    x = np.linspace(0, 12, 600)
    for (wave, label), colour in zip(waves, SHADES, strict=False):
        ratio = wave.overlap(x) / wave.overlap(0.0)
        tails.semilogy(x, np.where(ratio > 1e-15, ratio, np.nan), color=colour, lw=1.4, label=label)
    tails.set(
        xlabel="x − Vt (grains)",
        ylabel="overlap beyond rest / largest",
        xlim=(0, 12),
        ylim=(1e-15, 1e5),
    )
    tails.set_title("Tails: double exponential, exponential")
    tails.legend(loc="upper right")

    c = (
        np.array([1.01, 1.1, 1.5, 3.0])
        if given.quick
        else np.array([1.002, 1.01, 1.05, 1.1, 1.2, 1.5, 2.0, 3.0, 5.0])
    )
    force = np.array([(1 + float(soliton.solve(speed=each).overlap(0.0))) ** 1.5 for each in c])
    f = np.geomspace(1.02, 1.2 * force[-1], 300)
    speeds.plot(
        f, soliton.coste_speed(f), "--", color=SHADES[1], lw=1.4, label="Coste, Falcon and Fauve"
    )
    weak = 1 + (f ** (2 / 3) - 1) / 12
    speeds.plot(f[f < 8], weak[f < 8], ":", color=SHADES[2], lw=1.6, label="Korteweg and de Vries")
    strong = f > 8
    limit = 0.9055157764 / np.sqrt(1.5) * f[strong] ** (1 / 6)
    speeds.plot(f[strong], limit, "-.", color=SHADES[3], lw=1.4, label="sonic vacuum, $F^{1/6}$")
    speeds.plot(force, c, "o", ms=5, mfc="none", color="0.1", label="exact")
    for speed, far in zip(c, c / soliton.coste_speed(force) - 1, strict=True):
        if speed in (1.1, 1.5):
            say(f"faster than Coste's by, at {speed:g} of the speed of sound", 100 * far, "%")
    speeds.set(
        xscale="log", yscale="log", xlabel="largest force / load", ylabel="speed / speed of sound"
    )
    speeds.set_yticks([1, 2, 3, 4, 5], labels=["1", "2", "3", "4", "5"])
    speeds.minorticks_off()
    speeds.set_title("Under a load")
    speeds.legend(loc="upper left")
    finish(picture, given.output)


if __name__ == "__main__":
    main()
