"""Transmission of one or two impurities: transfer matrices, and packets in Hertzian chains.

One sphere that differs reflects all the more the shorter the wave. Two of them side by side are
transparent at one frequency, as electrons pass atoms in the Ramsauer-Townsend effect.
"""

import numpy as np
from figures import LAMMPS, NATIVE, SHADES, arguments, finish, say
from scipy.optimize import minimize_scalar

import lmpchain
from lmpchain.measure.energy import shares
from lmpchain.theory.scattering import transmission
from lmpchain.util.plotting import figure

HOST = {"diameter": 1e-3, "material": "steel", "gravity": 0.0, "top_load": 10.0}
SINGLE = (0.5, 1.5, 2.0)
PAIRS = (0.9, 1.1, 1.5)
WIDTH = 16.0


def with_odd(ratio: float, grains: list[int], total: int = 15) -> lmpchain.Chain:
    """Return a chain of steel beads with some diameters multiplied by this factor."""
    return lmpchain.Chain(
        grains=total, **HOST, impurity=[{"grain": n, "diameter": ratio * 1e-3} for n in grains]
    )


def edge(chain: lmpchain.Chain) -> float:
    """Return the highest frequency of the beads, rad/s."""
    return 2 * float(np.sqrt(chain.linear_stiffness[0] / chain.masses[0]))


def passed(
    engine: str, ratio: float, count: int, share: float, tolerance: float
) -> tuple[float, float]:
    """Return the transmitted fraction of a packet's energy, and the mean of T over its spectrum."""
    odd = list(range(300, 300 + count))
    chain = with_odd(ratio, odd, 600)
    w = edge(chain)
    k = 2 * np.arcsin(share)
    packet = lmpchain.Packet(
        frequency=share * w / (2 * np.pi),
        width=WIDTH,
        grain=150,
        amplitude=1e-4 * chain.length_scale,
    )
    duration = 2 * 150 / (w / 2 * np.cos(k / 2))
    scene = lmpchain.Scene(chain=chain, excitation=packet, duration=duration, samples=2)
    energy = shares(lmpchain.simulate(scene, engine, tolerance))
    q = 2 * np.pi * np.fft.rfftfreq(600)[1:-1]
    weight = np.abs(np.fft.rfft(packet.initial(chain)[1])[1:-1]) ** 2
    expected = transmission(chain, w * np.sin(q / 2)).transmitted @ weight / weight.sum()
    return energy.part(odd[-1] + 1, 600)[-1] / energy.part(1, 600)[-1], expected


def reflected(chain: lmpchain.Chain, frequency: float) -> float:
    """Return the reflected fraction of the energy, at a frequency relative to the band edge."""
    return 1 - transmission(chain, edge(chain) * np.array([frequency])).transmitted[0]


def main() -> None:
    """Draw the transmission of single and double impurities, with packets in two engines."""
    given = arguments(__file__, __doc__)
    picture = figure(7.5, 4)
    axes = picture.subplots(1, 2, sharey=True)
    frequency = np.sin(np.linspace(0.02, np.pi - 0.004, 500) / 2)
    places = (0.35, 0.75) if given.quick else (0.25, 0.4, 0.55, 0.7, 0.82)
    far = {"native": 0.0, "lammps": 0.0}
    for panel, ratios, count in zip(axes, (SINGLE, PAIRS), (1, 2), strict=True):
        for ratio, colour in zip(ratios, (SHADES[0], SHADES[1], SHADES[2]), strict=True):
            chain = with_odd(ratio, list(range(7, 7 + count)))
            found = transmission(chain, edge(chain) * frequency)
            panel.plot(
                frequency, found.transmitted, color=colour, lw=1.5, label=f"diameter × {ratio:g}"
            )
            if count == 2:
                # The longest waves pass all impurities.
                at = 100 + found.transmitted[100:].argmax()
                peak = minimize_scalar(
                    lambda x, c=chain: reflected(c, x), frequency[[at - 1, at, at + 1]]
                )
                say(f"transparent at, diameter × {ratio:g}", peak.x)
            for engine, style, tolerance in (("native", NATIVE, 1e-7), ("lammps", LAMMPS, 1e-5)):
                for place in places if engine == "native" else places[1::2]:
                    share, expected = passed(engine, ratio, count, place, tolerance)
                    far[engine] = max(far[engine], abs(share - expected))
                    panel.plot(place, share, **style)
    for engine, value in far.items():
        say(f"packets in {engine}, largest distance from theory", value)
    axes[0].set_title("One bead differs")
    axes[1].set_title("Two neighbours differ")
    for engine, style in (("native", NATIVE), ("LAMMPS", LAMMPS)):
        axes[0].plot([], [], **style, label=f"packets, {engine}")
    for panel in axes:
        panel.set(xlabel="frequency / band edge of the chain", xlim=(0, 1), ylim=(-0.02, 1.04))
    axes[0].set_ylabel("transmitted share of the energy")
    axes[0].legend(loc="upper right")
    axes[1].legend(loc="lower left")
    finish(picture, given.output)


if __name__ == "__main__":
    main()
