"""
Any measured quantity of many chains, and within tolerances
===========================================================

A measure is a function of a trajectory. Its mean, its scatter and its quantiles follow from many
random chains, or from the tolerances of diameters, moduli and loads.
"""

import numpy as np

import lmpchain
from lmpchain.disorder import measured_over, within
from lmpchain.measure import flight, spectrum

chain = lmpchain.Chain(grains=40, material="steel", diameter=5e-3, gravity=0.0, top_load=10.0)
scene = lmpchain.Scene(
    chain=chain, excitation=lmpchain.Impulse(velocity=1e-3), duration=3e-4, samples=401
)

# %%
# The spectrum behind 24 random contacts, of 60 chains.
frequency = spectrum.spectrum(lmpchain.simulate(scene)).frequency
low = frequency < 4e4


def behind(t: lmpchain.Trajectory) -> np.ndarray:
    """Return the spectrum of grain 25."""
    return 1e6 * spectrum.spectrum(t).amplitude[low, 24]


amplitudes = measured_over(scene, behind, m=10, realisations=60, seed=1, x=frequency[low] / 1e3)
picture_of_spectra = amplitudes.plot(label="amplitude (µm/s per Hz)", x_label="frequency (kHz)")

# %%
# The speed between two sensors, for a load known to 3 %, moduli to 2 % and diameters to 10 µm.
tolerances = {"top_load": 0.3, "youngs_modulus": 4e9, "diameter": 1e-5}
speed = within(scene, tolerances, lambda t: flight.time_of_flight(t, 5, 30).speed, 200, seed=1)
print(f"{speed.mean:.2f} ± {speed.error:.2f} m/s; of one chain ± {speed.deviation:.2f} m/s")
picture_of_speeds = speed.plot(label="speed (m/s)")
