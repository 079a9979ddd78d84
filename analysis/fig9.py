"""Fig. 9 of the paper: the "peaked mode" of Eq. (35), the wave behind a strike on the top.

Squares are Eq. (1) struck weakly, the thin line the continuum of Eq. (27) solved cell by cell. Eq.
(35) with |...| also says that grains move where no wave has been: made causal, and with its
amplitude C = 1.155137, it is the impulse response. Its peak is infinite; the grains disperse it
into the Airy function that `theory.front` gives.
"""

import numpy as np
from figures import (
    NATIVE,
    PRINTED,
    SHADES,
    THEORY,
    apart,
    arguments,
    finish,
    legends,
    page,
    say,
    weak_scene,
)

import lmpchain
from lmpchain.theory import continuum, front

TAU = 100
GRAINS = 280


def main() -> None:
    """Strike the chain and the continuum, and draw them."""
    given = arguments(__file__, __doc__)
    tau, grains = (60, 150) if given.quick else (TAU, GRAINS)
    scene = weak_scene(grains, tau, 2, 1e-8)
    run = lmpchain.simulate(scene, "native", tolerance=1e-9)
    chain = run.displacement[-1, :-1] / scene.excitation.velocity / scene.chain.time_scale
    field = continuum.solve([float(tau)], grains, velocity=lambda h: h < 1, cells=3).displacement[
        0, :-1
    ]
    n = np.arange(1, grains)
    chi = continuum.chi(np.arange(1, grains) - 0.5)
    causal = continuum.impulse_response(n - 0.5, float(tau))
    printed = continuum.peaked(n - 0.5, float(tau), 0.0, continuum.impulse_amplitude(), 0.0)
    close = chi > tau - 20
    airy = front.displacement(n[close], float(tau))

    picture, pairs = page(2)
    inside = chi < 0.5 * tau
    ahead = chi > 1.1 * tau
    off = np.abs(chain[inside] / causal[inside] - 1).max()
    wrong = printed[ahead].min()
    fine = np.linspace(0.01, grains, 4000)  # Depths h = n - 1/2.
    # The left panel shows the whole chain, the right panel the front.
    for (wave, below), limits in zip(pairs, ((0, grains), (0.82, 1.18)), strict=True):
        whole = limits[0] == 0
        wave.plot(
            fine + 0.5,
            continuum.peaked(fine, float(tau), 0.0, continuum.impulse_amplitude(), 0.0),
            **PRINTED,
            label=f"Eq. (35) as printed, |...|: {wrong:.2f} ahead",
        )
        wave.plot(
            fine + 0.5,
            continuum.impulse_response(fine, float(tau)),
            **THEORY,
            label=f"causal: {off:.0e} off, χ < τ/2",
        )
        wave.plot(n, field, color=SHADES[1], lw=1, label="Eq. (27), solved")
        wave.plot(n, chain, **NATIVE, label="chain, Eq. (1), weak")
        cone = float(continuum.depth(float(tau)))
        wave.axvline(
            cone + 0.5, color="0.6", ls=":", lw=1.2, label=f"light cone, grain {cone + 0.5:.0f}"
        )
        if not whole:
            wave.plot(n[close], airy, color=SHADES[3], lw=1.4, label="front of Airy type")
            apart(below, n[close], airy, chain[close], 1.0, color=SHADES[3], lw=1.4)
        apart(below, n, printed, chain, 1.0, **PRINTED)
        apart(below, n, causal, chain, 1.0, **THEORY)
        apart(below, n, field, chain, 1.0, color=SHADES[1], lw=1)
        wave.set(xlim=limits if whole else (limits[0] * cone, limits[1] * cone), ylim=(-0.05, 2.0))
        below.set(xlabel="grain, from the top", ylim=(1e-7, 5))
    pairs[0][0].set_ylabel("displacement / (speed of grain 1 at τ = 0)")
    pairs[0][1].set_ylabel("|difference|")
    pairs[0][0].set_title(
        f"τ = {tau}, {tau * scene.chain.time_scale * 1e6:.0f} µs", fontsize="medium"
    )
    pairs[1][0].set_title("The front")
    say("causal Eq. (35), largest relative error behind half the light cone", off)
    say("Eq. (27) solved, the same", np.abs(field[inside] / causal[inside] - 1).max())
    say("Eq. (35) as printed, ahead of the light cone", wrong)
    say("chain ahead of 1.1 of the light cone", np.abs(chain[ahead]).max())
    say("grain at the largest displacement", int(n[chain.argmax()]))
    say("grain at the largest displacement, Airy", int(n[close][airy.argmax()]))
    legends(picture, loc="upper left", frameon=True, framealpha=1, edgecolor="none")
    finish(picture, given.output)


if __name__ == "__main__":
    main()
