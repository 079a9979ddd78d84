"""
Spectra and the dispersion diagram of a run
===========================================

A light strike on a chain under load, and the frequencies and wavenumbers in its motion.
"""

import lmpchain
from lmpchain.measure import spectrum

chain = lmpchain.Chain(grains=64, diameter=1e-3, gravity=0.0, top_load=1.0)
strike = lmpchain.Impulse(velocity=1e-6, grain=32)
scene = lmpchain.Scene(
    chain=chain, excitation=strike, duration=150 * chain.time_scale, samples=1024
)
t = lmpchain.simulate(scene, tolerance=1e-3)

picture = spectrum.dispersion(t, 1, 63).plot()  # the line: theory

# %%
# The spectrum of every grain; the line is the local cut-off frequency.
picture_of_spectrum = spectrum.spectrum(t).plot()

# %%
# A dimer has two bands and a gap between them.
dimer = lmpchain.patterns.periodic(64, 1e-2, ["steel", "ptfe"], gravity=0, top_load=20.0)
ringing = lmpchain.Scene(chain=dimer, excitation=strike, duration=8e-3, samples=4096)
picture_of_dimer = spectrum.dispersion(lmpchain.simulate(ringing, tolerance=1e-3), 1, 62).plot()
