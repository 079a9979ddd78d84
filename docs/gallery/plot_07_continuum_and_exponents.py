"""
Fits of the continuum: wave speed, front, exponents
===================================================

A weak strike on a column, deep enough for the laws of Eq. (27).
"""

import lmpchain
from lmpchain.measure import fit

chain = lmpchain.Chain(grains=300, diameter=1e-3)
strike = lmpchain.Impulse(velocity=1e-9)
scene = lmpchain.Scene(
    chain=chain, excitation=strike, duration=200 * chain.time_scale, samples=1601
)
t = lmpchain.simulate(scene, "chebyshev", 1e-5)

continuum = fit.fit_continuum(t)
picture = continuum.plot()

# %%
# When the front arrives, and the power of depth that it follows.
picture_of_front = continuum.front.plot()

# %%
# The exponents with which height, arrival, speed and width of the front change with depth, beside
# those of theory: local ones, d log / d log h over eleven grains, and at the right those of great
# depth. Grains next to the bottom, whose echo comes before the front has passed, are left out.
exponents = fit.fit_exponents(t)
picture_of_exponents = exponents.plot()
print(exponents)

# %%
# After a strong strike the wave is a solitary one at first, which keeps its height; where it is
# still strong no law of weak waves can be fitted, and the local exponents say how far it is.
strong = lmpchain.Impulse(velocity=100 * chain.length_scale / chain.time_scale)
struck = scene.replace(excitation=strong, duration=120 * chain.time_scale)
print(fit.fit_exponents(lmpchain.simulate(struck)))

# %%
# All fits at once, as ``lmpchain fit`` prints them.
print(fit.summary(t))
