"""Fig. 4 of the paper: Hertzian column, top displaced (a) or struck (b), against Eq. (19).

Squares are the native engine, circles LAMMPS, both struck so weakly that Eq. (1) is Eq. (3). The
series is exact once the cases of the brace in Eq. (20) are j = 1 and j > 1; with the printed i, the
dashed line, it is off at grain 1 above all. For a strike each Bessel function is to be integrated
over time, which the paper does not say.
"""

import numpy as np
from figures import (
    PRINTED,
    THEORY,
    apart,
    arguments,
    distance,
    end_of_run,
    finish,
    kappa,
    legends,
    page,
    say,
    weak_scene,
)
from scipy.special import jv

import lmpchain
from lmpchain.theory import bessel, modes

GRAINS = 40
TAU = 14


def as_printed(grains: int, tau: float) -> np.ndarray:
    """Return Eq. (19) with the A_j(n) of Eq. (20) as printed, (N-1,), for i = 1 and i > 1."""
    chain = lmpchain.Chain(grains=grains, diameter=1e-3)
    linear = modes.eigenmodes(chain)
    shape = linear.shape * np.sqrt(linear.mass[:, None])
    omega = linear.frequency * chain.time_scale
    root = grains ** (1 / 6)
    j = np.arange(1, int(root * tau) + 60)
    # The angle phi_i of Eq. (21).
    cases = 2 * np.cos(np.multiply.outer(np.arcsin(omega / (2 * root)), 2 * j - 2))
    cases[0] = 1
    return (shape * shape[0]) @ (cases @ jv(2 * j - 2, 2 * root * tau))


def main() -> None:
    """Run both scenes in both engines and draw them."""
    given = arguments(__file__, __doc__)
    grains, tau = (20, 7) if given.quick else (GRAINS, TAU)
    n = np.arange(1, grains)
    picture, pairs = page(2)
    cases = {
        "a: displaced, Eq. (19)": (1, bessel.finite),
        "b: struck, Eq. (19) integrated": (0, bessel.finite_impulse),
    }
    for (name, (moved, theory)), (wave, below) in zip(cases.items(), pairs, strict=True):
        exact = theory(kappa(grains), n, 1, float(tau))
        wave.plot(n, exact, **THEORY, label="Eq. (19), Eq. (20) corrected")
        if moved:
            printed = as_printed(grains, tau)
            off = distance(printed, exact)
            wave.plot(n, printed, **PRINTED, label=f"Eq. (20) as printed: {100 * off:.2g} % off")
            apart(below, n, printed, exact, np.abs(exact).max(), **PRINTED)
            say("Eq. (20) as printed", 100 * off, "% off")
            three = [
                as_printed(3, at) - bessel.finite(kappa(3), [1, 2], 1, at)
                for at in np.linspace(0, 20, 201)
            ]
            say("Eq. (20) as printed, N = 3, largest error", np.abs(three).max())
        for engine, strength in (("lammps", 1e-4), ("native", 1e-9)):
            scene = weak_scene(grains, tau, 2, strength, moved=moved)
            off = end_of_run(
                (wave, below), scene, engine, strength * scene.chain.length_scale, exact
            )
            wave.lines[-1].set_label(f"{engine}, strength {strength:.0e}: {off:.0e} off")
            say(f"{name[0]}, {engine}", off)
        wave.set_title(f"{name[3].upper()}{name[4:]}, at τ = {tau}")
        below.set(xlabel="grain, from the top", xlim=(0, grains), ylim=(1e-16, 1e1))
    pairs[0][0].set_ylabel("displacement / that of grain 1 at t = 0")
    pairs[1][0].set_ylabel("displacement / (speed of grain 1 at τ = 0)")
    pairs[0][1].set_ylabel("|difference| / max")
    for wave, _ in pairs:
        wave.margins(y=0.8)
    legends(picture, loc="upper left")
    finish(picture, given.output)


if __name__ == "__main__":
    main()
