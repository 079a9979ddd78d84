"""Fig. 8 of the paper: harmonically driven top; Eq. (27), its mode, and the chain.

Squares are Eq. (1) with grain 1 driven weakly, circles the continuum of Eq. (27) solved cell by
cell, lines the mode of Eq. (30). With exp(i lambda tau) the printed H^(1) is a wave that comes in
from below; the top sends down H^(2), its conjugate. The amplitude falls all the way, as h^(-1/12)
deep down.
"""

import numpy as np
from figures import (
    NATIVE,
    PRINTED,
    SHADES,
    THEORY,
    apart,
    arguments,
    distance,
    finish,
    legends,
    page,
    say,
)

import lmpchain
from lmpchain.theory import continuum

LAMBDA = 0.5
TAU = 200.0
GRAINS = 450
RAMP = 60.0
# Fraction of a period after the largest drive, when upward and downward waves differ.
OUT_OF_STEP = 0.2


def main() -> None:
    """Drive the continuum and the chain, and draw displacement and amplitude."""
    given = arguments(__file__, __doc__)
    tau, grains, cells = (125.0, 250, 3) if given.quick else (TAU, GRAINS, 5)
    period = 2 * np.pi / LAMBDA
    tau = period * (round(tau / period) + OUT_OF_STEP)
    top = complex(continuum.mode(0.5, LAMBDA).conjugate())

    def drive(t: float) -> tuple[float, float]:
        angle = np.pi * min(t / RAMP, 1.0)
        share = top * np.exp(1j * LAMBDA * t)
        slowly = (1 - np.cos(angle)) / 2
        faster = np.pi / RAMP * np.sin(angle) / 2
        return float(slowly * share.real), float(
            faster * share.real + slowly * (1j * LAMBDA * share).real
        )

    times = np.linspace(tau - period, tau, 41)
    field = continuum.solve(times, grains, drive=drive, cells=cells)
    chain = lmpchain.Chain(grains=grains, diameter=1e-3)
    knots = np.linspace(0, tau, round(40 * tau / period) + 1)
    unit = 1e-6 * chain.length_scale
    motion = unit * np.array([drive(t)[0] for t in knots])
    piston = lmpchain.Drive(times=knots * chain.time_scale, displacement=motion)
    scene = lmpchain.Scene(
        chain=chain, excitation=piston, duration=tau * chain.time_scale, samples=knots.size
    )
    run = lmpchain.simulate(scene, "native", tolerance=1e-6)

    h = field.h
    n = np.arange(1, grains + 1)
    mode = continuum.mode(h, LAMBDA)
    wave_in, wave_out = ((u * np.exp(1j * LAMBDA * tau)).real for u in (mode, mode.conjugate()))
    # Further away, the drive had not reached its amplitude.
    near = continuum.chi(h) < tau - RAMP - 30
    cells_ = field.displacement[-1]
    grains_ = run.displacement[-1] / unit
    picture, ((wave, below), (height, relative)) = page(2)
    good, bad, discrete = (distance(x[near], cells_[near]) for x in (wave_out, wave_in, grains_))
    wave.plot(
        n, wave_out, **THEORY, label=f"Eq. (30), $H^{{(2)}}$: {100 * good:.2g} % from Eq. (27)"
    )
    wave.plot(n, wave_in, **PRINTED, label=f"$H^{{(1)}}$ as printed: {100 * bad:.0f} %")
    wave.plot(
        n, cells_, "o", ms=5, mfc="none", color=SHADES[1], markevery=5, label="Eq. (27), solved"
    )
    wave.plot(
        n, grains_, **NATIVE, markevery=5, label=f"chain, Eq. (1), weak: {100 * discrete:.2g} %"
    )
    apart(below, n, wave_out, cells_, 1.0, **THEORY)
    apart(below, n, wave_in, cells_, 1.0, **PRINTED)
    apart(below, n, grains_, cells_, 1.0, **NATIVE)
    last = int(n[near][-1])
    wave.set(xlim=(0, last), ylim=(-0.9, 1.4), ylabel="displacement φ")
    below.set(xlabel="grain, from the top", ylabel="|difference|", ylim=(1e-6, 5))

    turn = np.exp(-1j * LAMBDA * times[1:, None])
    amplitudes = [
        2 * np.abs((x * turn).mean(0))
        for x in (field.displacement[1:], run.displacement[-40:] / unit)
    ]
    power = h ** (-1 / 12) * np.sqrt(2 / (np.pi * LAMBDA) / 1.2)
    height.loglog(h, np.abs(mode), **THEORY, label=r"$|u_λ|$, Eq. (30)")
    height.loglog(h, power, color=SHADES[3], ls=":", label="its limit, $h^{-1/12}$")
    height.loglog(
        h[near],
        amplitudes[0][near],
        "o",
        ms=5,
        mfc="none",
        color=SHADES[1],
        markevery=5,
        label="Eq. (27), solved",
    )
    height.loglog(h[near], amplitudes[1][near], **NATIVE, markevery=5, label="chain, Eq. (1), weak")
    apart(relative, h, power, np.abs(mode), np.abs(mode), color=SHADES[3], ls=":")
    for amplitude, style in zip(
        amplitudes, ({"color": SHADES[1], "marker": "o"}, NATIVE), strict=True
    ):
        apart(relative, h[near], amplitude[near], np.abs(mode)[near], np.abs(mode)[near], **style)
    height.set(xlim=(0.4, last), ylim=(0.55, 1.2), ylabel="amplitude of φ")
    height.yaxis.set(minor_formatter="{x:g}")
    relative.set(
        xlabel="depth h = n − 1/2 (grains)",
        ylabel=r"relative to $|u_λ|$",
        ylim=(1e-6, 1),
    )
    say("outgoing mode", 100 * good, "% off")
    say("mode as printed", 100 * bad, "% off")
    say("chain and Eq. (27) differ by", 100 * discrete, "%")
    deep = near & (h > 20)
    exponent = np.polyfit(np.log(h[deep]), np.log(amplitudes[1][deep]), 1)[0]
    say("exponent of the amplitude of the chain", exponent)
    microseconds = tau * chain.time_scale * 1e6
    wave.set_title(f"At τ = {tau:.1f}, {microseconds:.0f} µs")
    height.set_title(f"Chain: $h^{{{exponent:.4f}}}$")
    legends(picture, loc="upper right")
    finish(picture, given.output)


if __name__ == "__main__":
    main()
