"""Fig. 3 of the paper: springs (delta = 1), top displaced (a) or struck (b); Eqs. (11), (13).

Squares are the native engine, circles LAMMPS with linear contacts; both solve Eq. (1), which is
linear here as long as nothing opens. The velocity in Eq. (13) is dphi/dT, not the dphi/dtau of the
text; at kappa = 1 they are the same.
"""

import numpy as np
from figures import THEORY, arguments, end_of_run, finish, legends, page, say, weak_scene

from lmpchain.theory import bessel

GRAINS = 60
TAU = 25


def main() -> None:
    """Run both scenes in both engines and draw them."""
    given = arguments(__file__, __doc__)
    grains, tau = (30, 10) if given.quick else (GRAINS, TAU)
    n = np.arange(1, grains)
    picture, pairs = page(2)
    cases = {
        "a: displaced, Eq. (11)": (1, bessel.free_end),
        "b: struck, Eq. (13)": (0, bessel.free_end_impulse),
    }
    for (name, (moved, theory)), (wave, below) in zip(cases.items(), pairs, strict=True):
        scene = weak_scene(grains, tau, 2, 1e-2, delta=1.0, moved=moved)
        unit = 1e-2 * scene.chain.length_scale
        exact = theory(n, float(tau))
        wave.plot(n, exact, **THEORY, label="theory")
        for engine in ("lammps", "native"):
            off = end_of_run((wave, below), scene, engine, unit, exact)
            wave.lines[-1].set_label(f"{engine}: {off:.0e} off")
            say(f"{name[0]}, {engine}", off)
        wave.set_title(f"{name[3].upper()}{name[4:]}, at τ = {tau}")
        below.set(xlabel="grain, from the top", xlim=(0, 1.4 * tau), ylim=(1e-17, 1e-5))
    pairs[0][0].set_ylabel("displacement / that of grain 1 at t = 0")
    pairs[1][0].set_ylabel("displacement / (speed of grain 1 at τ = 0)")
    pairs[0][1].set_ylabel("|run − theory| / max")
    legends(picture)
    finish(picture, given.output)


if __name__ == "__main__":
    main()
