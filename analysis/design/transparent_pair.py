"""Two transparent impurities: their masses by optimisation, compared with scattering theory.

A packet of waves travels down a uniform chain under a load; of its energy least shall come back
from two grains side by side, whose masses may be 1.35 to 3 times those of the others, each on its
own: at 1 there is nothing to come back from. Two like masses M let the frequency with w^2 = 2 K / M
pass (Martinez, Yasuda, Kim, Kevrekidis, Porter and Yang, Phys. Rev. E 93, 052224 (2016)); a packet
has a band of frequencies.
"""

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
from figures import arguments, finish, say

from lmpchain import Chain, Packet, Profile, Scene
from lmpchain.design import KineticEnergy, optimise
from lmpchain.theory import scattering
from lmpchain.util.plotting import figure

GRAINS = 400
PAIR = [200, 201]
FACTOR = 1.5
START = 2.2


def main() -> None:
    """Find both masses, and draw the transmission."""
    given = arguments(__file__, __doc__)
    plain = Chain(grains=GRAINS, diameter=1e-3, gravity=0.0, top_load=1.0)
    m = float(plain.masses[0])
    k = float(plain.linear_stiffness[0])
    omega = np.sqrt(2 * k / (FACTOR * m))
    packet = Packet(
        frequency=omega / (2 * np.pi), width=20.0, grain=125, amplitude=1e-5 * plain.length_scale
    )
    u, v = packet.initial(plain)
    speed = np.sqrt(k / m) * np.cos(np.arcsin(omega / 2 * np.sqrt(m / k)))  # Grains per second.
    masses = np.full(GRAINS, m)
    masses[[n - 1 for n in PAIR]] *= START
    chain = plain.replace(masses=masses, contact_constants=plain.contact_constants)
    scene = Scene(
        chain=chain, excitation=Profile(displacement=u, velocity=v), duration=150 / speed, samples=2
    )
    low = masses.copy()
    high = masses.copy()
    for n in PAIR:
        low[n - 1] = 1.35 * m
        high[n - 1] = 3 * m
    back = KineticEnergy(list(range(1, PAIR[0])))
    runs = 8 if given.quick else 60
    found = optimise(
        scene, back, ["masses"], {"masses": (low, high)}, starts=1, runs=runs, tolerance=1e-4
    )
    whole = float((m * v**2).sum() / 2)
    pair = found.values["masses"][[n - 1 for n in PAIR]] / m
    by_formula = scattering.transparent(plain, omega, PAIR, "mass")
    say("of the energy comes back at first", 100 * found.history[0][0] / whole, "%")
    say("of the energy comes back in the end", 100 * found.value / whole, "%")
    say("mass of the upper one", pair[0])
    say("mass of the lower one", pair[1])
    say("mass by the formula", float(by_formula[0]))
    say("runs", found.runs)
    picture = figure(7.5, 3.8)
    left, right = picture.subplots(1, 2)
    near = omega * np.linspace(0.6, 1.2, 400)
    for name, one, style in (
        ("at first", chain, {"color": "0.6"}),
        (f"optimised, {found.runs} runs", found.scene.chain, {"color": "#0072B2"}),
        (
            "formula",
            chain.replace(masses=np.where(masses == m, m, by_formula[0] * m)),
            {"color": "#D55E00", "ls": "--"},
        ),
    ):
        left.plot(
            near / omega, 1 - scattering.transmission(one, near).transmitted, label=name, **style
        )
    left.set(
        title="Reflection of the two beads",
        xlabel="frequency over that of the packet",
        ylabel="reflected share of the energy",
        ylim=(1e-6, 1),
        yscale="log",
    )
    left.axvline(1, color="0.8", zorder=0)
    picture.legend(*left.get_legend_handles_labels(), loc="outside lower center", ncols=3)
    right.semilogy(np.arange(1, found.runs + 1), found.history[0] / whole, ".-", color="#0072B2")
    right.set(
        title="Search by gradients",
        xlabel="run",
        ylabel="share of the energy that comes back",
    )
    finish(picture, given.output)


if __name__ == "__main__":
    main()
