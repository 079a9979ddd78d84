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
t = lmpchain.simulate(scene, "chebyshev")

continuum = fit.fit_continuum(t)
picture = continuum.plot()

# %%
# When the front arrives, and the power of depth that it follows.
picture_of_front = continuum.front.plot()

# %%
# The exponents of amplitude, width and speed, beside those of theory.
picture_of_exponents = fit.fit_exponents(t).plot()

# %%
# All fits at once, as ``lmpchain fit`` prints them.
print(fit.summary(t).table())
