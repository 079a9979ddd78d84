"""
Disorder: means over random chains, localisation, density of states
===================================================================

The mean velocity of 200 columns whose stiffness is drawn from Dyson's distribution of order 5.
"""

from scipy.stats import gamma

import lmpchain
from lmpchain import disorder
from lmpchain.measure import dyson

chain = lmpchain.Chain(grains=60, diameter=1e-3)
strike = lmpchain.Impulse(velocity=1e-9)
scene = lmpchain.Scene(chain=chain, excitation=strike, duration=15 * chain.time_scale, samples=31)
means = [disorder.ensemble(scene, m, realisations=200, seed=1) for m in (1, 5)]
picture = means[1].plot()

# %%
# The weighted sum of Eq. (22), which is no average, beside these means.
t = lmpchain.simulate(scene, "chebyshev", 1e-5)
picture_of_sums = dyson.sums(t, [1, 5]).plot(t.velocity[-1], means)

# %%
# The inverse localisation length of a chain with random springs, and its density of states.
law = gamma(6, scale=1 / 5)
frequency = [0.1, 0.2, 0.5, 1.0, 1.5, 2.0]
picture_of_localisation = disorder.lyapunov(frequency, law, grains=10_000, seed=1).plot()

# %%
picture_of_states = disorder.density_of_states(frequency, law, grains=10_000, seed=1).plot()

# %%
# How the energy of a strike in the middle spreads: second moment and participation.
line = lmpchain.Chain(grains=121, diameter=1e-3, gravity=0.0, top_load=1.0, bottom="wall")
struck = lmpchain.Impulse(velocity=1e-9, grain=61)
middle = lmpchain.Scene(chain=line, excitation=struck, duration=30 * line.time_scale, samples=31)
picture_of_spreading = disorder.spreading(middle, 5, realisations=50, seed=1).plot()
