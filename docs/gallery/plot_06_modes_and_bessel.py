"""
Fits of linear theory: modes, and the wave in a uniform chain
=============================================================

How the energy is shared among the modes, and how well linear motion describes the run.
"""

import lmpchain
from lmpchain.measure import fit

chain = lmpchain.Chain(grains=40, diameter=1e-3, gravity=0.0, top_load=0.1)
strike = lmpchain.Impulse(velocity=1e-7)
scene = lmpchain.Scene(chain=chain, excitation=strike, duration=30 * chain.time_scale, samples=121)
t = lmpchain.simulate(scene, "native", tolerance=1e-9)

modes = fit.fit_modes(t)
picture = modes.plot()

# %%
# What is left when the linear motion from t = 0 is taken away: the nonlinearity.
picture_of_residual = modes.plot(what="residual")

# %%
# Eq. (13), the wave of a semi-infinite uniform chain, with its amplitude and rate fitted.
bessel = fit.fit_bessel(t)
print(f"strike {bessel.amplitude:.4g} m/s, kappa {bessel.kappa:.4f}")
picture_of_bessel = bessel.plot()
