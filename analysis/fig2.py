"""Fig. 2 of the paper: a grain in the middle of the column is displaced; Eq. (6) with one kappa.

Squares are Eq. (1) moved so weakly that it is Eq. (3) to 1e-6; the exact series of Eq. (19) goes
through them at any time. Eq. (6) is the infinite chain with the kappa of grain 50 everywhere: it is
good as long as the wave has gone a few grains, not in "a wide interval" of times, for what runs
down meets stiffer contacts than what runs up.
"""

import numpy as np
from figures import (
    NATIVE,
    PRINTED,
    THEORY,
    apart,
    arguments,
    distance,
    finish,
    kappa,
    legends,
    page,
    say,
    weak_scene,
)

import lmpchain
from lmpchain.theory import bessel

GRAINS = 100
MOVED = 50
TAU = (1, 5, 10, 12)


def main() -> None:
    """Run the scene, and draw it at four times."""
    given = arguments(__file__, __doc__)
    scene = weak_scene(GRAINS, 12, 13, 1e-7, moved=MOVED)
    run = lmpchain.simulate(scene, "native", tolerance=1e-9)
    phi = run.displacement / scene.excitation.displacement
    n = np.arange(1, GRAINS)

    picture, pairs = page(2, rows=2, height=8.5)
    for tau, (wave, below) in zip(TAU, pairs, strict=True):
        measured = phi[tau, :-1]
        uniform = bessel.infinite(n, MOVED, tau * np.sqrt(MOVED ** (1 / 3)))
        exact = bessel.finite(kappa(GRAINS), n, MOVED, tau)
        off = distance(uniform, measured)
        good = distance(exact, measured)
        wave.plot(n, uniform, **PRINTED, label=f"Eq. (6), κ of grain 50: {100 * off:.2g} % off")
        wave.plot(n, exact, **THEORY, label=f"Eq. (19): {good:.0e}")
        wave.plot(n, measured, **NATIVE, label="native, Eq. (1), weak")
        apart(below, n, uniform, measured, np.abs(measured).max(), **PRINTED)
        apart(below, n, exact, measured, np.abs(measured).max(), **THEORY)
        reach = 4 + 2.4 * tau
        time = f"{tau * scene.chain.time_scale * 1e6:.1f} µs"
        wave.set_title(f"τ = {tau}, {time}")
        wave.set(
            xlim=(MOVED - reach, MOVED + reach),
            ylim=(wave.get_ylim()[0], 1.75 * wave.get_ylim()[1]),
        )
        wave.set_ylabel("displacement / $φ_{50}(0)$")
        below.set(xlabel="grain, from the top", ylabel="off / max", ylim=(1e-11, 3))
        say(f"Eq. (6) at tau {tau}", 100 * off, "% off")
    say("Eq. (19), largest", good)
    legends(picture, loc="upper center")
    finish(picture, given.output)


if __name__ == "__main__":
    main()
