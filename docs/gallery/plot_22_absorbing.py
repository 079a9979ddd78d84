"""
Ends that absorb, and the transmission of a dimer
=================================================

A sponge behind each end, whose drag grows gently, makes a chain endless for linear waves.
"""

import numpy as np

import lmpchain
from lmpchain import patterns
from lmpchain.theory import scattering
from lmpchain.util.plotting import COLOURS, figure

leads = ["steel"] * 20
chain = lmpchain.Chain(
    grains=100,
    material=[*leads, *["steel", "aluminium"] * 30, *leads],
    diameter=1e-2,
    gravity=0.0,
    top_load=20.0,
    bottom="wall",
)
SPONGE = 60
endless = patterns.absorbing(chain, bottom=SPONGE, top=SPONGE)

# %%
# What comes back from the end, in the middle 80 % of the band of the leads:
wave = scattering.reflection(endless, SPONGE)
print(f"amplitude {abs(wave.amplitude).max():.1e}, energy {wave.reflected.max():.1e} at most")
edge = wave.bands.max()
picture = scattering.reflection(
    endless, SPONGE, frequency=edge * np.linspace(0.02, 0.98, 300)
).plot()

# %%
# A force on a grain of the upper lead, until all is steady, against the theory of scattering.
# Only what has the frequency of the force is taken, of the last 50 periods.
frequencies = edge * np.array([0.15, 0.2, 0.25, 0.3, 0.33, 0.36, 0.5])
push = 1e-4
periods = 150
shares = []
for omega in frequencies:
    scene = lmpchain.Scene(
        chain=endless,
        excitation=lmpchain.Force(grain=SPONGE + 6, amplitude=push, frequency=omega / 2 / np.pi),
        duration=periods * 2 * np.pi / omega,
        samples=8 * periods + 1,
        grains=[SPONGE + 95],
    )
    t = lmpchain.simulate(scene, "native", 1e-4)
    late = slice(8 * (periods - 50), 8 * periods)
    window = np.hanning(401)[:-1]
    turned = window * np.exp(1j * omega * t.time[late]) * t.displacement[late, 0]
    # the force sends this down an endless lead
    incoming = push / (2 * chain.linear_stiffness[0] * np.sin(2 * np.arcsin(omega / edge)))
    shares.append((2 * abs(turned.sum()) / window.sum() / incoming) ** 2)
expected = scattering.transmission(chain, frequencies).transmitted
for omega, share, theory in zip(frequencies, shares, expected, strict=True):
    print(f"{omega / 2 / np.pi:6.0f} Hz: {share:.5f} of the energy passes, in theory {theory:.5f}")
picture_of_dimer = figure(6.5, 4)
axes = picture_of_dimer.subplots()
fine = edge * np.linspace(0.1, 0.9, 800)
theory = scattering.transmission(chain, fine).transmitted
axes.plot(fine / 2e3 / np.pi, theory, lw=1, color=COLOURS["blue"], label="theory of scattering")
axes.plot(frequencies / 2e3 / np.pi, shares, "o", color=COLOURS["vermilion"], label="driven chain")
axes.set(xlabel="frequency (kHz)", ylabel="share of the energy that passes")
axes.legend(frameon=False)
