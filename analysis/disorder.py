"""Random chains: spectrum, localisation, and spreading of the energy of a strike.

Dyson's chain has independent ratios of stiffness and mass, and an exact spectrum. Random springs
localise waves over a length that grows as the inverse square of the frequency, so that the energy
of a strike spreads faster than by diffusion while most of it stays where it was.
"""

import numpy as np
from figures import SHADES, arguments, finish, one_above_two, say
from scipy.stats import gamma

import lmpchain
from lmpchain.disorder import density_of_states, lyapunov, spreading
from lmpchain.theory import dyson

MARKS = {1: "o", 3: "s", 20: "^"}


def main() -> None:
    """Draw the spectra of three random chains, localisation, and the growth of second moments."""
    given = arguments(__file__, __doc__)
    grains, chains, length = (600, 60, 20_000) if given.quick else (2000, 200, 100_000)
    picture, states, localised, spread = one_above_two()

    fine = np.geomspace(0.02, 4.5, 150)
    points = np.geomspace(0.03, 4, 15)
    for (m, mark), colour in zip(MARKS.items(), SHADES, strict=False):
        found = density_of_states(
            points, ratios=gamma(m, scale=1 / m), grains=length, chains=8, seed=1
        )
        states.plot(fine, dyson.integrated(fine, m, m), color=colour, lw=1.2)
        states.plot(
            points, found.integrated, mark, ms=5, mfc="none", color=colour, label=f"m = {m}"
        )
        say(
            f"largest distance from Dyson's spectrum, m = {m}",
            np.abs(found.integrated - dyson.integrated(points, m, m)).max(),
        )
    states.set(xscale="log", yscale="log", xlabel=r"frequency $\omega / \langle k/m \rangle^{1/2}$")
    states.set(ylabel="share of the modes below", ylim=(2e-3, 1.5))
    states.set_title("Spectrum: exact (lines) and transfer matrices (points)")
    states.legend(title="Dyson's chain", fontsize="small")

    omega = np.geomspace(0.1, 2.0, 11)
    for (m, mark), colour in list(zip(MARKS.items(), SHADES, strict=False))[1:]:
        found = lyapunov(omega, gamma(m + 1, scale=1 / m), grains=length, chains=8, seed=2)
        law = omega**2 / 8 / (m - 1)
        localised.plot(omega, law, color=colour, lw=1.2)
        style = {"ms": 5, "mfc": "none", "capsize": 2, "color": colour}
        localised.errorbar(
            omega, found.exponent, 2 * found.error, fmt=mark, **style, label=f"m = {m}"
        )
        say(f"Lyapunov exponent over its law, m = {m}", found.exponent[3] / law[3])
    localised.set(
        xscale="log", yscale="log", xlabel=r"frequency $\omega \, (m \langle 1/k \rangle)^{1/2}$"
    )
    localised.set_ylabel("1 / localisation length (1/grains)")
    localised.set_title(r"Localisation of the amplitude")
    law = r"$m \omega^2 \mathrm{Var}(1/k) / (8 \langle 1/k \rangle)$"
    localised.plot([], [], color="0.4", lw=1.2, label=law)
    localised.legend(title="random springs", fontsize="small")

    line = {
        "grains": grains,
        "diameter": 1e-3,
        "gravity": 0.0,
        "top_load": 1.0,
        "top": "wall",
        "bottom": "wall",
    }
    chain = lmpchain.Chain(**line, exponent=1.0)
    middle = {"grain": grains // 2}
    ways = {
        "strike": (lmpchain.Impulse(velocity=1e-9, **middle), 1.5, SHADES[0]),
        "displacement": (lmpchain.Displacement(displacement=1e-12, **middle), 0.5, SHADES[5]),
    }
    for name, (excitation, power, colour) in ways.items():
        scene = lmpchain.Scene(
            chain=chain,
            excitation=excitation,
            duration=0.47 * grains * chain.time_scale,
            samples=91,
        )
        found = spreading(scene, 3, chains, seed=3, law="paper")
        tau = scene.time[1:] / chain.time_scale
        moment = found.second_moment[1:]
        growth, error = found.growth(scene.time[45])
        say(f"power of the second moment after a {name}", growth)
        say(f"participation after a {name}", found.participation[45:].mean(), "grains")
        band = 2 * found.second_moment_error[1:]
        spread.fill_between(tau, moment - band, moment + band, color=colour, alpha=0.25, lw=0)
        spread.plot(tau, moment, color=colour, lw=1.4, label=f"{name}: {growth:.2f} ± {error:.2f}")
        spread.plot(tau, found.participation[1:], ":", color=colour)
        late = tau > 0.1 * tau[-1]
        spread.plot(tau[late], 1.7 * moment[-1] * (tau[late] / tau[-1]) ** power, "k--", lw=0.9)
        end = 1.7 * moment[-1] * (tau[late][0] / tau[-1]) ** power
        spread.annotate(
            f"$\\tau^{{{power:g}}}$",
            (tau[late][0], end),
            (0, 5),
            textcoords="offset points",
            ha="center",
        )
    spread.plot([], [], ":", color="0.3", label="participation, grains")
    spread.set(xscale="log", yscale="log", xlabel=r"time $\tau$", ylabel="second moment (grains²)")
    spread.set_title("Energy spreads")
    spread.legend(loc="upper left", fontsize="small")
    finish(picture, given.output)


if __name__ == "__main__":
    main()
