"""Fig. 5 of the paper: velocities 100 us after a strike of 0.857 mm/s at 10, 1 and 0.1 g.

Squares are the native engine, circles LAMMPS, both for Eq. (1); the line is the linear theory, Eq.
(19). The paper finds "a satisfactory correspondence"; but the strike is weak at none of the three.
Its strike number v0* must be below 0.037 for linear theory to be right to 1 %; at g it is 8.5, and
contact 1 all but opens.
"""

import numpy as np
from figures import (
    HERE,
    LAMMPS,
    NATIVE,
    THEORY,
    apart,
    arguments,
    distance,
    finish,
    kappa,
    legends,
    page,
    say,
    shorter,
    summit,
)

import lmpchain
from lmpchain.theory import bessel

SCENES = {"10 g": "fig5_10g.toml", "g": "fig5_1g.toml", "g / 10": "fig5_0.1g.toml"}


def main() -> None:
    """Run the three scenes in both engines and draw them."""
    given = arguments(__file__, __doc__)
    picture, pairs = page(1, rows=3, height=9)
    for (name, file), (wave, below) in zip(SCENES.items(), pairs, strict=True):
        scene = lmpchain.Scene.from_toml(HERE / "scenes" / file)
        if given.quick:
            scene = shorter(scene, 60)
        grains = scene.chain.grains
        strike = scene.excitation.velocity
        n = np.arange(1, grains)
        linear = bessel.finite(kappa(grains), n, 1, scene.duration / scene.chain.time_scale)
        native, lammps = (
            lmpchain.simulate(scene, engine, tolerance).velocity[-1, :-1] / strike
            for engine, tolerance in (("native", 1e-8), ("lammps", 1e-5 if given.quick else 1e-6))
        )
        off = distance(linear, native)
        wave.axhline(0, color="0.85", lw=0.8, zorder=0)
        wave.plot(
            n,
            linear,
            **THEORY,
            label="Eq. (19)",
        )
        wave.plot(n, lammps, **LAMMPS, label="LAMMPS")
        wave.plot(n, native, **NATIVE, label="native, Eq. (1)")
        apart(below, n, linear, native, np.abs(native).max(), **THEORY)
        apart(below, n, lammps, native, np.abs(native).max(), **LAMMPS)
        wave.set_title(f"{name}: strike number v0* = {scene.strike_number:.3g}")
        wave.set(xlim=(0, 45), ylim=(-0.32, 0.78), ylabel="velocity / $v_0$")
        below.set(ylim=(1e-10, 10), yticks=(1e-9, 1e-5, 1e-1), ylabel="|curve − native|\n/ max")
        say(f"linear theory at {name}", 100 * off, "% off")
        say(f"peak at {name}, Eq. (1)", summit(native))
        say(f"peak at {name}, linear", summit(linear))
    below.set_xlabel("grain, from the top")
    legends(picture, loc="upper right")
    finish(picture, given.output)


if __name__ == "__main__":
    main()
